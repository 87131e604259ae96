"""A terminal multiplexer under a real command."""

import contextlib
import os
import signal
import subprocess
import termios
import time
import tty
from pathlib import Path


class Tmux:
    """The console in a tmux server of its own: what an operator's terminal multiplexer does to it."""

    def __init__(self, folder: Path, *command: str, size: tuple[int, int] = (120, 36)) -> None:
        self._socket = str(folder / "tmux")
        columns, lines = (str(each) for each in size)
        self("new-session", "-d", "-x", columns, "-y", lines, *command)
        self("set-option", "-g", "mouse", "on")

    def __call__(self, *words: str) -> str:
        environ = os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONFAULTHANDLER": "1"}
        command = ["tmux", "-S", self._socket, "-f", "/dev/null", *words]
        return subprocess.run(command, env=environ, text=True, capture_output=True, check=True, timeout=180).stdout

    @property
    def picture(self) -> str:
        """Return the text of the screen."""
        return self("capture-pane", "-p")

    @property
    def title(self) -> str:
        return self("display-message", "-p", "#{pane_title}").rstrip()

    @property
    def makes_signals(self) -> bool:
        """Whether Ctrl+C is a signal, and not a key of a program in raw mode."""
        terminal = os.open(self("display-message", "-p", "#{pane_tty}").rstrip(), os.O_RDONLY | os.O_NOCTTY)
        try:
            return bool(termios.tcgetattr(terminal)[tty.LFLAG] & termios.ISIG)
        finally:
            os.close(terminal)

    def wait_for(self, words: str, seconds: float = 120.0, *, there: bool = True) -> str:
        """Wait until `words` are there, or no more."""
        deadline, pause = time.monotonic() + seconds, 0.05
        while (words in (picture := self.picture)) is not there:
            assert time.monotonic() < deadline, (
                f"{words!r} not {there} within {seconds} s:\n{picture}\n{self._what_it_does()}"
            )
            time.sleep(pause)
            pause = min(1.3 * pause, 0.2)  # each look starts a process
        return picture

    def agree(self, question: str) -> None:
        """Answer a question with Yes once its keys count; a key that comes late on a busy machine is ignored."""
        self.wait_for(question)
        deadline = time.monotonic() + 120
        with contextlib.suppress(subprocess.CalledProcessError):  # tmux ends with the program that it runs
            while question in (picture := self.picture):
                assert time.monotonic() < deadline, f"{question!r} stays:\n{picture}"
                if "y yes" in picture:
                    self("send-keys", "y")
                time.sleep(0.5)

    def _what_it_does(self) -> str:
        """Return the state of the program's processes, and end them with their threads' stacks, if they are Python's.

        An app has them in the log that takes its errors.
        """
        shell = self("display-message", "-p", "#{pane_pid}").strip()
        listed = ["ps", "-o", "pid,stat,wchan,etime,time,args", "--sid", shell]
        states = subprocess.run(listed, text=True, capture_output=True, check=False).stdout
        for pid in (line.split()[0] for line in states.splitlines()[1:] if "python" in line and "sh -c" not in line):
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(pid), signal.SIGABRT)
        time.sleep(1)  # it has to write them
        logs = [path.read_text() for path in Path(os.environ["XDG_STATE_HOME"]).rglob("output.txt")]
        with contextlib.suppress(subprocess.CalledProcessError):  # tmux ends with the program that it runs
            logs.insert(0, self.picture)
        return "\n".join((states, *logs))

    def __enter__(self) -> "Tmux":
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(subprocess.CalledProcessError):  # it has ended with its last command
            self("kill-server")

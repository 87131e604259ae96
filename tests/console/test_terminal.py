"""In a real terminal, the console starts at once, always ends cleanly, and never holds up the bridge."""

import contextlib
import json
import os
import pty
import re
import shutil
import signal
import stat
import sys
import termios
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from tests.console.live import Pair, end, talker
from tests.console.terminal import COMMAND, Terminal
from tests.console.tmux import Tmux
from tests.support.commands import rsb_console
from tests.support.forker import Forked
from tests.support.long import long
from tests.support.waiting import eventually
from textual.drivers import linux_driver

from rsb_bridge.config.session_file import load
from rsb_bridge.model.session import Topic
from rsb_console.notation.ascii_signs import prefers_ascii
from rsb_console.terminal.driver import ConsoleDriver  # noqa: F401 — it gives Textual the decoder

pytest.importorskip("rclpy", reason="needs ROS 2")
CHATTER = f"/console_{os.getpid()}/terminal"
LEFT, OWN_COLOURS = b"\x1b[?1049l", b"\x1b[m"
"""The alternate screen is left (xterm's control sequences, DECRST 1049), and colours are the terminal's (ECMA-48)."""
CRASHING = """
import sys
from pathlib import Path
from rsb_console import app
from rsb_console.command.console_command import run_console
app.ConsoleApp.action_theme = lambda self: 1 / 0
path, *on_hangup = sys.argv[1:]
sys.exit(run_console(Path(path), on_hangup=(on_hangup or ["stop"])[0]))
"""

SIGNALLED = """
import os
from rsb_console.terminal_app import TerminalApp
has_ended = TerminalApp.has_ended
TerminalApp.has_ended = lambda self: [has_ended(self), os.kill(os.getpid(), {number})]
"""
"""The process gets a signal whenever its console has ended."""
WATCHED = """
import threading
from rsb_console.command import headless

def bridge_on(*_, **__):
    timers = [each for each in threading.enumerate() if isinstance(each, threading.Timer)]
    print(sum(not each.finished.is_set() for each in timers), "would end it")
    return 7

headless.bridge_on = bridge_on
"""

NOISY = """
import os, sys
from pathlib import Path
from rsb_console import app
from rsb_console.command.console_command import run_console
ready = app.ConsoleApp.on_ready
app.ConsoleApp.on_ready = lambda self: [ready(self)] + [os.write(fd, b"[RTPS Error] no port") for fd in (1, 2)]
code = run_console(None)
[os.write(fd, b"itself again %d" % fd) for fd in (1, 2)]
sys.exit(code)
"""


PATIENT = """
import sys, time
from pathlib import Path

class Later:
    def find_spec(self, name, path=None, target=None):
        while name == "rsb_bridge.engine" and not Path(sys.argv[1]).exists():
            time.sleep(0.01)

sys.meta_path.insert(0, Later())
from rsb_console.cli import main
sys.exit(main(["run", sys.argv[2]]))
"""


LATE = """
import os, signal, sys, time
signal.signal(signal.SIGHUP, signal.SIG_IGN)
try:
    while True:
        os.write(1, b"ready ")
        time.sleep(0.01)
except OSError:
    pass
if len(sys.argv) > 1:
    os.dup2(os.open(sys.argv[1], os.O_WRONLY | os.O_CREAT, 0o600), 2)
from rsb_console.cli import main
sys.exit(main(["run"]))
"""


@pytest.mark.parametrize("heard", [True, False])
def test_terminal_lost_during_start_is_no_crash(heard: bool, tmp_path: Path) -> None:
    """It reports that where somebody may still read it."""
    errors = tmp_path / "errors"
    command = (sys.executable, "-c", LATE, *([str(errors)] if heard else []))
    with Terminal(*command, environ={"XDG_STATE_HOME": str(tmp_path / "state")}) as terminal:
        terminal.wait_for("ready")
        terminal.hang_up()
        assert terminal.exit_code() == 2
    assert not list(tmp_path.rglob("crash*"))
    if heard:
        assert errors.read_text().startswith("rsb-console: the console needs a terminal")


@pytest.fixture
def pair(tmp_path: Path) -> Pair:
    return Pair(tmp_path, Topic(CHATTER, "transmit"))


def console(pair: Pair, *options: str, **environ: str) -> Terminal:
    return Terminal("rsb_console", "run", str(pair.client_path), *options, environ=environ, forked=True)


class FarSide:
    """The other side's own figures: its status lines, five seconds apart."""

    def __init__(self, pair: Pair, log: Path) -> None:
        self.log = log
        self._command = ["rsb_console", "run", "--no-ui", "--log-format", "json", str(pair.server_path)]

    def __enter__(self) -> "FarSide":
        with self.log.open("w") as log:
            self.process = Forked(*self._command, stdout=log)
        return self

    def __exit__(self, *_: object) -> None:
        end(self.process)

    def lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.log.read_text().splitlines(keepends=True) if line.endswith("}\n")]

    def assert_flowing(self, seconds: float = 120.0) -> None:
        """The topic flows on: between two statuses from now, something has been delivered."""
        begin, deadline = time.time(), time.monotonic() + seconds
        delivered: list[int] = []
        # Its talker may only just come up, and a link that a busy machine loses meanwhile begins to count anew.
        while all(after <= before for before, after in pairwise(delivered)):
            assert time.monotonic() < deadline, f"the other side delivers nothing more: {delivered}"
            time.sleep(0.1)
            statuses = [line["status"] for line in self.lines() if "status" in line and line["time"] > begin]
            delivered = [route["delivered"] for status in statuses for route in status["routes"]]


def test_first_picture_does_not_wait_for_engine(pair: Pair, tmp_path: Path) -> None:
    """Its imports alone take a while; `bench/console.py` prints how soon the picture comes."""
    script, may_import = tmp_path / "patient.py", tmp_path / "may_import"
    script.write_text(PATIENT)
    with Terminal(sys.executable, str(script), str(may_import), str(pair.client_path)) as terminal:
        terminal.wait_for("Topics")
        may_import.touch()
        terminal.wait_for("retry")


@pytest.mark.parametrize("number", [signal.SIGTERM, *long(signal.SIGINT)], ids=["SIGTERM", "SIGINT"])
def test_signal_ends_it_cleanly_and_restores_terminal(pair: Pair, tmp_path: Path, number: signal.Signals) -> None:
    with FarSide(pair, tmp_path / "far") as far, console(pair) as terminal:
        terminal.wait_for("LINKED")
        terminal.kill(number)
        assert terminal.exit_code() == 0
        assert_left(terminal)
        assert b"Traceback" not in terminal.output
        assert_told(far)


def assert_left(terminal: Terminal) -> None:
    assert OWN_COLOURS in terminal.output.partition(LEFT)[2]


def assert_told(far: FarSide) -> None:
    """Check that the other side got the goodbye, instead of finding out."""
    deadline = time.monotonic() + 180
    while not any(line.get("source") == "link" and "linked with" not in line["text"] for line in far.lines()):
        assert time.monotonic() < deadline, far.log.read_text()
        time.sleep(0.05)


def new_modes() -> list[Any]:
    """Return the modes of a new terminal: one with a console in it may have the console's already."""
    here, there = pty.openpty()
    try:
        return termios.tcgetattr(here)
    finally:
        os.close(here)
        os.close(there)


def test_stopped_and_continued_console_draws_again(pair: Pair, tmp_path: Path) -> None:
    """SIGSTOP tells it nothing; a shell's own terminal modes may be set when it goes on."""
    state = tmp_path / "state"
    with console(pair, XDG_STATE_HOME=str(state)) as terminal:
        terminal.wait_for("retry")
        deadline = time.monotonic() + 180
        while not [*state.rglob("*.jsonl")]:  # the engine's last thread opens it
            assert time.monotonic() < deadline, "no file of events"
            terminal.read(0.05)
        threads = terminal.threads
        for _ in range(3):
            terminal.kill(signal.SIGSTOP)
            shown = len(terminal.output)
            terminal.kill(signal.SIGCONT)
            terminal.wait_for("Topics", after=shown)
        for _ in range(6):  # faster than it takes the terminal
            terminal.kill(signal.SIGCONT)
            time.sleep(0.02)
        deadline = time.monotonic() + 180
        while terminal.threads > threads + 2:  # the engine's pool may have grown meanwhile, but not by nine
            assert time.monotonic() < deadline, f"{terminal.threads} threads, {threads} before"
            terminal.read(0.05)
        while terminal.alive:  # what is typed while it takes the terminal is lost
            assert time.monotonic() < deadline + 10, "q is not heard"
            with contextlib.suppress(OSError):  # it has just gone
                terminal.type("qy")
            terminal.read(0.5)
        assert terminal.exit_code() == 0
        assert termios.tcgetattr(terminal.fd) == new_modes()


def test_who_terminal_is_is_asked_again(pair: Pair) -> None:
    """It tells no kind, so it is asked for it only where it may be another terminal."""
    question = re.compile(rb"(\x1b\[>c)?\x1b7\x1b\[(\d+);(\d+)H\x1b\[6n")
    with console(pair) as terminal:

        def answer_until(asks_kind: bool) -> None:
            deadline, done = time.monotonic() + 120, len(terminal.output)
            while True:
                assert time.monotonic() < deadline, terminal.output[-400:]
                for each in question.finditer(terminal.output, done):
                    done = each.end()
                    terminal.type(b"\x1b[%s;%sR" % each.group(2, 3))
                    if bool(each[1]) is asks_kind:
                        return
                terminal.read(0.05)

        terminal.wait_for(CHATTER)
        terminal.type("q")
        terminal.wait_for("Quit")  # a question that is guarded, so the terminal is asked
        answer_until(asks_kind=False)
        terminal.resize(100, 30)
        answer_until(asks_kind=True)
        answer_until(asks_kind=False)
        terminal.kill(signal.SIGCONT)
        answer_until(asks_kind=True)


def test_dropped_line_ends_it_and_peer_is_told(pair: Pair, tmp_path: Path) -> None:
    with FarSide(pair, tmp_path / "far") as far, console(pair) as terminal:
        terminal.wait_for("LINKED")
        terminal.hang_up()
        assert terminal.exit_code() == 129
        assert_told(far)


def test_a_dropped_line_ends_a_headless_bridge(pair: Pair) -> None:
    with console(pair, "--no-ui") as terminal:
        terminal.wait_for("status")
        terminal.hang_up()
        assert terminal.exit_code() == 129


def test_dropped_line_leaves_bridge_running_if_wanted(pair: Pair, tmp_path: Path) -> None:
    going_on = console(pair, "--on-hangup", "continue")
    with FarSide(pair, tmp_path / "far") as far, talker(CHATTER), going_on as terminal:
        terminal.wait_for("LINKED")
        terminal.hang_up()
        far.assert_flowing()
        assert terminal.alive
        terminal.kill(signal.SIGTERM)
        assert terminal.exit_code() == 0


def test_stuck_terminal_stalls_neither_bridge_nor_end(pair: Pair, tmp_path: Path) -> None:
    with FarSide(pair, tmp_path / "far") as far, talker(CHATTER), console(pair) as terminal:
        terminal.wait_for("LINKED")
        for step in range(60):  # each redraws the whole screen: far more than the line holds
            terminal.resize(100 + step % 2, 30)
            time.sleep(0.02)
        far.assert_flowing()
        mark = len(terminal.output)
        terminal.resize(120, 36)
        terminal.wait_for("Topics", after=mark)  # it reads again: a whole picture comes
        for step in range(60):
            terminal.resize(100 + step % 2, 30)
            time.sleep(0.02)
        terminal.kill(signal.SIGTERM)
        assert terminal.exit_code(read=False) == 0


def test_key_has_its_effect_on_slow_line_before_all_that_would_wait(pair: Pair) -> None:
    """Counted in bytes, as a machine may be slow, too: with all frames in a queue, 200,000 come first."""
    with console(pair) as terminal:
        terminal.wait_for(" quit")

        def read_slowly(seconds: float) -> None:
            until = time.monotonic() + seconds
            while time.monotonic() < until:
                terminal.read(0.0, most=100)
                time.sleep(0.05)

        for step in range(20):  # each draws the whole screen
            terminal.resize(100 + step % 2, 30)
            read_slowly(0.1)
        read_slowly(3.0)
        mark = len(terminal.output)
        terminal.type("?")
        while b"Next line" not in terminal.output[mark:]:
            read_slowly(0.5)
            assert len(terminal.output) - mark < 40_000


def test_last_frame_comes_once_terminal_reads() -> None:
    """Nothing on the screen changes by itself, so no other frame brings what this one had."""
    with Terminal("tests.console.scripted_console", "--empty", size=(100, 30), forked=True) as terminal:
        terminal.wait_for("\x1b[30H")
        for step in range(60):  # more than the line holds
            terminal.resize(100 + step % 2, 30)
            time.sleep(0.02)
        terminal.resize(100, 36)
        eventually(lambda: rests(terminal.pid), what="all is drawn")
        terminal.wait_for("\x1b[36H")


def rests(pid: int) -> bool:
    """Whether a process has nothing to do for a while."""

    def ticks() -> int:
        return sum(map(int, Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]))

    before = ticks()
    time.sleep(0.5)
    return ticks() - before <= 2


def test_crash_of_console_leaves_bridge_running(pair: Pair, tmp_path: Path) -> None:
    script = tmp_path / "crashing.py"
    script.write_text(CRASHING)
    with FarSide(pair, tmp_path / "far") as far, talker(CHATTER):
        command = (sys.executable, str(script), str(pair.client_path))
        with Terminal(*command, environ={"XDG_STATE_HOME": str(tmp_path / "state")}) as terminal:
            terminal.wait_for("LINKED")
            terminal.type("t")
            terminal.wait_for("the console has crashed")
            assert_left(terminal)
            assert b"Traceback" not in terminal.output
            far.assert_flowing()
            terminal.kill(signal.SIGTERM)
            assert terminal.exit_code() == 1
    (crash,) = (tmp_path / "state").rglob("crash.txt")
    assert "ZeroDivisionError" in crash.read_text()
    assert stat.S_IMODE(crash.stat().st_mode) == 0o600


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP], ids=["SIGTERM", "SIGHUP"])
def test_signal_after_crash_and_before_bridge_goes_on_ends_it(
    pair: Pair, tmp_path: Path, number: signal.Signals
) -> None:
    script = tmp_path / "crashing.py"
    script.write_text(SIGNALLED.format(number=int(number)) + CRASHING)
    with FarSide(pair, tmp_path / "far") as far:
        command = (sys.executable, str(script), str(pair.client_path))
        with Terminal(*command, environ={"XDG_STATE_HOME": str(tmp_path / "state")}) as terminal:
            terminal.wait_for("LINKED")
            terminal.type("t")
            assert terminal.exit_code() == 1
            assert b"goes on without it" not in terminal.output
        assert_told(far)


def test_hangup_after_crash_leaves_bridge_that_survives_it(pair: Pair, tmp_path: Path) -> None:
    script = tmp_path / "crashing.py"
    script.write_text(SIGNALLED.format(number=int(signal.SIGHUP)) + WATCHED + CRASHING)
    command = (sys.executable, str(script), str(pair.client_path), "continue")
    with Terminal(*command, environ={"XDG_STATE_HOME": str(tmp_path / "state")}) as terminal:
        terminal.wait_for("/console_")
        terminal.type("t")
        terminal.wait_for("0 would end it")
        assert terminal.exit_code() == 7


def test_actions_in_own_console_are_of_its_user(pair: Pair, tmp_path: Path) -> None:
    control = str(tmp_path / "console.sock")
    with console(pair, "--control", control) as terminal:
        terminal.wait_for("/console_")
        terminal.type("r")
        deadline = time.monotonic() + 180.0
        did: list[dict[str, Any]] = []
        while not did:
            assert time.monotonic() < deadline
            told = rsb_console("events", "--control", control, "--json").stdout.splitlines()
            did = [event for event in map(json.loads, told) if event.get("code") == "operator.retried"]
        name = str(Path(f"/proc/{terminal.pid}/fd/0").readlink()).removeprefix("/dev/")
        assert f" on {name}" in did[0]["who"]


def test_what_libraries_print_is_kept_off_the_picture(tmp_path: Path) -> None:
    script, state = tmp_path / "noisy.py", tmp_path / "state"
    script.write_text(NOISY)
    with Terminal(sys.executable, str(script), size=(100, 30), environ={"XDG_STATE_HOME": str(state)}) as terminal:
        terminal.wait_for("Open a session")
        terminal.wait_for("\x1b[30H")  # it is as high as the terminal
        terminal.type("q")
        terminal.wait_for("itself again 1")
        terminal.wait_for("itself again 2")
        assert terminal.exit_code() == 0
    (log,) = state.rglob("output.txt")
    assert log.read_text() == 2 * "[RTPS Error] no port"
    assert b"RTPS" not in terminal.output


def test_bytes_that_are_no_utf8_are_left_out() -> None:
    read = vars(linux_driver)["getincrementaldecoder"]("utf-8")()
    assert read.decode(b"a\xffb") == "a\N{REPLACEMENT CHARACTER}b"


def test_the_mouse_can_be_left_to_the_terminal(pair: Pair) -> None:
    with console(pair, "--no-mouse") as terminal:
        terminal.wait_for(" quit")
        assert b"\x1b[?1003h" not in terminal.output  # all motion tracking (xterm's control sequences, DECSET 1003)
        terminal.type("m")
        terminal.wait_for("\x1b[?1003h")
        terminal.type("m")
        terminal.wait_for("\x1b[?1003l")


def test_terminals_title_names_bridge_and_its_faults(pair: Pair) -> None:
    with console(pair) as terminal:
        terminal.wait_for("\x1b[22;0t")
        terminal.wait_for(f"\x1b]0;{load(pair.client_path).name} ✗1\x07")  # nobody answers
        terminal.kill(signal.SIGTERM)
        terminal.exit_code()
        assert b"\x1b[23;0t" in terminal.output


def _wait_for_colour(terminal: Terminal, number: int, after: int = 0) -> None:
    """Wait for a colour, alone or with other looks: which of them change with it depends on what was drawn before."""

    def is_there() -> bool:
        terminal.read(0.05)
        return re.search(rb"\x1b\[(?:\d+;)*%dm" % number, terminal.output[after:]) is not None

    eventually(is_there, what=f"colour {number}")


def test_a_light_background_changes_the_terminals_theme(tmp_path: Path) -> None:
    environ = {"TERM": "xterm", "COLORTERM": "", "XDG_STATE_HOME": str(tmp_path)}
    with Terminal("rsb_console", environ=environ, forked=True) as terminal:
        terminal.wait_for("Open a session")
        terminal.wait_for("\x1b]11;?")
        _wait_for_colour(terminal, 36)  # cyan
        mark = len(terminal.output)
        terminal.type("\x1b]11;rgb:ffff/ffff/ffff\x1b\\")
        _wait_for_colour(terminal, 34, after=mark)  # blue
        terminal.type("q")
        assert terminal.exit_code() == 0


@pytest.mark.parametrize(
    ("environ", "expected"),
    [
        ({"LANG": "en_US.UTF-8", "TERM": "xterm"}, False),
        ({"LC_ALL": "C.utf8"}, False),
        ({}, False),
        ({"LANG": "de_DE.ISO-8859-1"}, True),
        ({"LANG": "en_US.UTF-8", "LC_ALL": "POSIX"}, True),
        ({"LANG": "en_US.UTF-8", "TERM": "linux"}, True),
        ({"LANG": "en_US.UTF-8", "TERM": "vt100"}, True),
        ({"LANG": "C", "LC_CTYPE": "C.UTF-8"}, True),
        ({"LANG": "C", "LC_CTYPE": "C.UTF-8", "LC_ALL": "C.UTF-8"}, False),
        ({"LANG": "C", "LC_CTYPE": "en_US.UTF-8"}, False),
        ({"LANG": "en_US.UTF-8", "TERM": "vt220"}, True),
        ({"LC_ALL": "C.UTF-8", "TERM": "vt220"}, False),
        ({"LC_ALL": "C.UTF-8", "TERM": "linux"}, False),
        ({"LC_ALL": "", "LANG": "C.UTF-8", "TERM": "linux"}, True),
        ({"LANG": "en_US.UTF-8", "TERM": "linux-16color"}, True),
        ({"LANG": "en_US.UTF-8", "TERM": "screen.linux"}, True),
        ({"LANG": "en_US.UTF-8", "TERM": "screen.vte"}, False),
        ({"LANG": "en_US.UTF-8", "TERM": "vte"}, False),
        ({"LANG": "en_US.UTF-8", "TERM": "vte-256color"}, False),
        ({"LC_CTYPE": "C.UTF-8"}, False),
    ],
)
def test_ascii_is_chosen_where_terminal_has_no_more(environ: dict[str, str], expected: bool) -> None:
    assert prefers_ascii(environ) is expected


def test_commands_draw_ascii_where_terminal_has_no_more(tmp_path: Path) -> None:
    pair = Pair(tmp_path, Topic(CHATTER, "transmit", arm=True))
    there = ["--control", str(tmp_path / "own.sock")]
    commands = (
        ["status", *there], ["look", *there, "--once", "--timeout", "1", CHATTER], ["check", "größe — 1.yaml"],
    )  # fmt: skip
    with FarSide(pair, tmp_path / "far"), console(pair, *there) as bridge:
        bridge.wait_for("LINKED")
        bridge.wait_for("DISARMED")
        for environ in ({"LANG": "C", "TERM": "vt100"}, {"LANG": "en_US.UTF-8", "TERM": "linux"}):
            settings = {"LC_ALL": "", "LC_CTYPE": "", **environ}
            for command in commands:
                with Terminal("rsb_console", *command, environ=settings, forked=True) as terminal:
                    terminal.exit_code()
                    assert terminal.output
                    assert terminal.output.isascii()
            with Terminal("rsb_console", "arm", *there, CHATTER, environ=settings, forked=True) as terminal:
                terminal.wait_for("ARMED")
                terminal.type("\x03")
                terminal.exit_code()
                assert terminal.output.isascii()


def test_a_terminal_without_unicode_gets_ascii_only(pair: Pair) -> None:
    with console(pair, LC_ALL="C", TERM="linux", COLORTERM="") as terminal:
        terminal.wait_for(" quit")
        assert terminal.output.isascii()
        assert b"38;5;" not in terminal.output  # sixteen colours
        assert b"38;2;" not in terminal.output


@pytest.mark.skipif(shutil.which("tmux") is None, reason="needs tmux")
def test_keys_resizing_detaching_and_attaching_in_tmux(pair: Pair, tmp_path: Path) -> None:
    command = f"{COMMAND} run {pair.client_path}; echo exit code $?; cat"
    with FarSide(pair, tmp_path / "far"), talker(CHATTER), Tmux(tmp_path, command) as tmux:
        picture = tmux.wait_for("● LINKED")
        assert len(picture.rstrip("\n").splitlines()) == 36
        assert "┌─ /console_" in tmux.wait_for("◇ UNHEARD")

        tmux("send-keys", "y")
        # A toast of 3 s may be missed. Without `tmux load-buffer` there would be no buffer.
        eventually(lambda: CHATTER in tmux("list-buffers", "-F", "#{buffer_sample}").splitlines(), what="tmux's buffer")
        assert tmux("show-buffer") == CHATTER

        tmux("send-keys", "/", "nothing")
        tmux.wait_for("0 of 1")
        tmux("send-keys", "Escape")
        tmux.wait_for("▌◇ UNHEARD")

        tmux("resize-window", "-x", "80", "-y", "24")
        tmux.wait_for("┌─ /console_", there=False)
        tmux.wait_for("LIVE 4 Hz")
        tmux("resize-window", "-x", "120", "-y", "36")
        tmux.wait_for("┌─ /console_")

        for _ in range(2):
            with Terminal(str(shutil.which("tmux")), "-S", str(tmp_path / "tmux"), "attach", size=(100, 30)) as client:
                client.wait_for("Topics")
                tmux("detach-client")
                assert client.exit_code() == 0
        tmux("resize-window", "-x", "120", "-y", "36")
        tmux.wait_for("● LINKED")

        tmux("send-keys", "q")
        tmux.agree("Quit?")
        picture = tmux.wait_for("exit code 0")
        assert "Topics" not in picture  # the shell's own screen is back

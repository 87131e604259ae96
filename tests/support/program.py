"""The real program in a process of its own: `rsb-console run SESSION --no-ui`."""

from __future__ import annotations

import contextlib
import fcntl
import json
import subprocess
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.support.forker import Forked
from tests.support.handles import Handle
from tests.support.waiting import eventually

from rsb_bridge.config.session_file import save

if TYPE_CHECKING:
    import signal
    from collections.abc import Callable

    from rsb_bridge.model.session import Session


_LOCKED_WITHIN = 5.0  # s


class Programs:
    """Starts programs, and ends them all at the end."""

    def __init__(self, folder: Path, start: Callable[..., Any] = Forked) -> None:
        self._folder = folder
        self._programs: list[Program] = []
        self._start = start

    def start(self, session: Session, *arguments: str, **how: Any) -> Program:
        """Run a session with further arguments; its key files are relative to the folder.

        Args:
            how: as `Forked` takes it.
        """
        number = len(self._programs)
        path, log = self._folder / f"{session.role}{number}.yaml", self._folder / f"{session.role}{number}.log"
        save(session, path)
        # A socket of its own: some tests run one session twice, as two machines may.
        options = ("--no-ui", "--log-format", "json", "--control", f"{path}.sock")
        with log.open("a") as output:
            process = self._start(
                "rsb_console", "run", str(path), *options, *arguments,
                stdin=subprocess.DEVNULL, stdout=output, stderr=output, **how,
            )  # fmt: skip
        program = Program(process.pid, log, process.wait)
        self._programs.append(program)
        return program

    def close(self) -> None:
        """Kill them all; none may have written a traceback."""
        for program in self._programs:
            program.kill()
        free_shared_memory()
        for program in self._programs:
            assert "Traceback" not in program.output, program.output


class Program:
    """One of them.

    Args:
        reap: called once it has been killed, where this process has to see to that.
    """

    def __init__(self, pid: int, log: Path, reap: Callable[[], object] | None = None) -> None:
        self._reap = reap
        self.pid = pid
        self._handle = Handle(pid)
        self._log = log

    @property
    def output(self) -> str:
        """All that it has written so far."""
        return self._log.read_text(errors="replace") if self._log.exists() else ""  # it may be in the middle of a sign

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self._handle.running

    @property
    def said(self) -> list[str]:
        return [line["text"] for line in self._lines() if "text" in line]

    def wait_for(self, words: str) -> None:
        """Until an event has these words."""
        eventually(lambda: any(words in text for text in self.said), what=f"{words!r} in {self.output}")

    def signal(self, number: signal.Signals) -> None:
        self._handle.signal(number)

    def kill(self) -> None:
        """kill -9, and wait until it is gone."""
        self._handle.kill()
        if self._reap is not None:
            self._reap()

    def _lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.output.splitlines(keepends=True) if line[0] + line[-1] == "{\n"]


def free_shared_memory() -> None:
    """Remove what DDS participants that were killed left: half a megabyte each, which nothing else ever frees.

    Fast DDS holds a lock on one file for each segment as long as its process lives. It makes the file first, so a new
    one may be that of another run which is about to lock it.
    """
    for path in Path("/dev/shm").glob("fast*_el"):
        if "port" in path.name:
            continue  # shared by those who send there
        with contextlib.suppress(FileNotFoundError), path.open() as lock, contextlib.suppress(BlockingIOError):
            if time.time() - path.stat().st_ctime < _LOCKED_WITHIN:
                continue
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.with_name(path.name.removesuffix("_el")).unlink(missing_ok=True)
            path.unlink()

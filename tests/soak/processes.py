"""The processes of a soak: `rsb-console run --no-ui`, and talkers. They end with this process, however it ends."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.soak.ledgers import Book
from tests.soak.measures import Life

ROOT = Path(__file__).parents[2]
STOPS_WITHIN = 6.0
_STATUS_EVERY = 1.0
_KEPT_LINES = 400


def spawn(command: tuple[str, ...], output: int = subprocess.STDOUT) -> subprocess.Popen[str]:
    """Start a Python program of this project with its standard input and output here."""
    setpriv = shutil.which("setpriv")
    dies_with_us = (setpriv, "--pdeathsig", "KILL") if setpriv else ()
    return subprocess.Popen(
        (*dies_with_us, sys.executable, *command),
        cwd=ROOT,
        env=os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=output,
        text=True,
    )


class Process:
    """A program that is started again and again.

    Attributes:
        ready: whether the present process has printed something.
    """

    def __init__(self, name: str, *command: str) -> None:
        self.name = name
        self.ready = False
        self.frozen = False
        self._command = command
        self._child: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None

    @property
    def pid(self) -> int:
        assert self._child is not None
        return self._child.pid

    @property
    def running(self) -> bool:
        return self._child is not None and self._child.poll() is None

    def start(self) -> None:
        assert not self.running
        self.ready = False
        self._child = spawn(self._command)
        self._reader = threading.Thread(target=self._read, args=(self._child,), name=self.name, daemon=True)
        self._reader.start()

    def kill(self) -> None:
        assert self._child is not None
        self._child.kill()
        self._wait(10)

    def freeze(self) -> None:
        self.frozen = True
        os.kill(self.pid, signal.SIGSTOP)

    def thaw(self) -> None:
        os.kill(self.pid, signal.SIGCONT)
        self.frozen = False

    def close(self) -> None:
        if self.running:
            self.kill()

    def tell(self, words: str) -> None:
        assert self._child is not None
        assert self._child.stdin is not None
        self._child.stdin.write(f"{words}\n")
        self._child.stdin.flush()

    def take(self, line: str) -> None:
        """Take a line of its output, on a thread of its own."""
        raise NotImplementedError

    def _wait(self, within: float) -> int:
        assert self._child is not None
        assert self._reader is not None
        code = self._child.wait(within)
        self._reader.join(within)
        for stream in (self._child.stdin, self._child.stdout):
            assert stream is not None
            stream.close()
        return code

    def _read(self, child: subprocess.Popen[str]) -> None:
        assert child.stdout is not None
        for line in child.stdout:
            if child is self._child:
                self.take(line)
                self.ready = True


class Program(Process):
    """`rsb-console run SESSION --no-ui`.

    Attributes:
        lines: the last lines of its output, without status lines.
    """

    def __init__(self, name: str, session: Path, clock: Callable[[], float] = time.time) -> None:
        control = session.with_suffix(".sock")  # none of this user's other bridges is meant
        options = ("--no-ui", "--log-format", "json", "--status-every", str(_STATUS_EVERY), "--control", str(control))
        super().__init__(name, "-m", "rsb_console", "run", str(session), *options)
        self.lives: list[Life] = []
        self.books: list[Book] = []
        self.wrong: list[str] = []
        self.lines: deque[str] = deque(maxlen=_KEPT_LINES)
        self._log = session.with_suffix(".log")
        self._clock = clock
        self._status: dict[str, Any] = {"time": 0.0, "status": {"links": {}, "routes": []}}

    def start(self) -> None:
        self._note(f'{{"time": {self._clock():.3f}, "soak": "{self.name} is started"}}\n')
        self.books.append(Book(f"{self.name}, process {len(self.books) + 1}"))
        super().start()
        self.lives.append(Life(self.name, self.pid))

    @property
    def routes(self) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = self._status["status"]["routes"]
        return rows

    @property
    def told_at(self) -> float:
        told: float = self._status["time"]
        return told

    def measure(self, *, calm: bool = False) -> None:
        """Take a sample of what it holds; `calm`: all is well."""
        if self.running and self.ready and not self.frozen:
            self.lives[-1].measure(self._clock(), calm=calm)

    def stop(self) -> None:
        """End it by SIGTERM, and note if that fails."""
        if not self.running:
            self.wrong.append(f"{self.name} has ended by itself")
            return
        os.kill(self.pid, signal.SIGTERM)
        try:
            code = self._wait(STOPS_WITHIN)
        except subprocess.TimeoutExpired:
            self.wrong.append(f"{self.name} had not ended {STOPS_WITHIN:g} s after SIGTERM")
            self.kill()
        else:
            if code:
                self.wrong.append(f"{self.name} ended with {code} after SIGTERM")

    def take(self, line: str) -> None:
        if not line.endswith("\n"):
            return  # it was killed while it wrote
        if "RTPS_TRANSPORT_SHM" in line:
            return  # Fast DDS's, about a port that a killed process left; the bridge has it on standard error
        if not line.startswith("{"):
            self._note(line)
            self.wrong.append(f"{self.name} printed {line.rstrip()!r}")
            return
        said = json.loads(line)
        if "status" in said:
            self._status = said
            self.books[-1].take(said["status"]["routes"])
            return
        self._note(line)
        if said.get("code") in ("engine.error", "engine.ros_failed", "route.implausible_report"):
            self.wrong.append(f"{self.name}: {said['code']}: {said['text']}")

    def _note(self, line: str) -> None:
        self.lines.append(line.rstrip())
        with self._log.open("a") as log:
            log.write(line)


class Talkers(Process):
    def __init__(self, name: str, domain_id: int, topics: list[tuple[str, str]]) -> None:
        """Prepare.

        Args:
            topics: the prefix of each in this domain, and the name of its kind.
        """
        named = (word for pair in topics for word in pair)
        super().__init__(name, "-m", "tests.soak.talker", str(domain_id), *named)
        self.said: dict[str, int] | None = None

    def ask(self, words: str) -> None:
        """``hush`` or ``talk``: `said` is None until it has answered with how many messages each topic has had."""
        self.said = None
        self.tell(words)

    def take(self, line: str) -> None:
        if line.startswith("{"):
            self.said = json.loads(line).get("said")

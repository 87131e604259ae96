"""Processes of this machine that are commanded and measured: bridges, simulated robots, routers."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import time
from pathlib import Path
from typing import TYPE_CHECKING, Self

from rsb_console.child import ChildProcess

if TYPE_CHECKING:
    from collections.abc import Mapping

READY_WITHIN = 60.0  # s for a start and for DDS to find its nodes: 20 were too few on one core with other programs
_CPUCLOCK_SCHED = 2  # clock_getcpuclockid(3), as Linux makes the id of a process's clock
_STOPS_WITHIN = 6.0  # s; a bridge ends within 5 s (docs/headless.md)


class ProcessError(Exception):
    """A process does not start, ends by itself, or does not do its work in time; the message has the reason."""


class Process:
    """A Python process that is measured, or that answers lines of commands with lines of JSON.

    It has a process group of its own: a Ctrl-C reaches only this process, which then ends the other one. It also ends
    if this process is killed.
    """

    def __init__(
        self,
        *command: str,
        log: Path | None = None,
        environ: Mapping[str, str] | None = None,
    ) -> None:
        """Start the process.

        Args:
            command: arguments of Python: ``-m``, a module and its arguments.
            log: file for all its output, or None to read its answers.
            environ: changes to this process's environment.
        """
        environment = os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"} | dict(environ or {})
        self._name = " ".join(command[:3])
        with contextlib.ExitStack() as files:
            output = files.enter_context(log.open("wb")) if log else None
            self._child = ChildProcess(
                *command[1:],
                stdin=subprocess.PIPE,
                stdout=output or subprocess.PIPE,
                stderr=output or subprocess.DEVNULL,
                env=environment,
                start_new_session=True,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def ask(self, line: str) -> dict[str, float]:
        """Send a command and return the answer.

        Raises:
            ProcessError: it has ended.
        """
        self.tell(line)
        answered = self.line()
        if not answered:
            raise ProcessError(f"{self._name} has ended by itself")
        answer: dict[str, float] = json.loads(answered)
        return answer

    def tell(self, line: str) -> None:
        """Send a command without waiting for an answer.

        Raises:
            ProcessError: it has ended.
        """
        assert self._child.stdin is not None
        try:
            self._child.stdin.write(line + "\n")
            self._child.stdin.flush()
        except BrokenPipeError:
            raise ProcessError(f"{self._name} has ended by itself") from None

    def signal(self, number: int) -> None:
        self._child.send_signal(number)

    def line(self) -> str:
        assert self._child.stdout is not None
        return self._child.stdout.readline()

    @property
    def pid(self) -> int:
        return self._child.pid

    def cpu(self) -> float:
        """Processor time so far, s, all threads."""
        # This clock counts ns, /proc/PID/stat only ticks of 10 ms, which is much of a short run.
        return time.clock_gettime((~self.pid << 3) | _CPUCLOCK_SCHED)

    def memory(self) -> float:
        """Resident memory, MB."""
        status = Path(f"/proc/{self.pid}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0]) / 1000

    @property
    def running(self) -> bool:
        return self._child.poll() is None

    def stop(self) -> None:
        """End the process, by force if it takes long."""
        self._child.terminate()
        try:
            self._child.wait(_STOPS_WITHIN)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        finally:
            for pipe in (self._child.stdin, self._child.stdout):
                with contextlib.suppress(BrokenPipeError):
                    if pipe is not None:
                        pipe.close()


def router(endpoint: str) -> Process:
    """Start a Zenoh router, and return it once it listens."""
    process = Process("-m", "rsb_extras.demo.router", endpoint)
    if not process.line():
        raise ProcessError("the Zenoh router does not start: pip install 'rsb-console[zenoh]'")
    return process


def listening(server: Process, port: int) -> float:
    """Wait until a port is listened on, and return when it was last seen closed.

    It asks the kernel, since a connection would disturb the server.
    """
    before, wanted = time.monotonic(), f":{port:04X}"
    deadline = before + READY_WITHIN
    while (now := time.monotonic()) < deadline and server.running:
        rows = [row.split() for row in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        if any(row[1].endswith(wanted) and row[3] == "0A" for row in rows):  # TCP_LISTEN
            # A later time could be after the first connection, which would seem to take less than nothing.
            return before
        before = now
        time.sleep(0.01)
    raise ProcessError("the server does not start")

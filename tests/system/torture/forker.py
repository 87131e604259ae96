"""Forks `rsb-console` with any arguments, from an interpreter that has imported everything.

A line of standard input is ``[arguments, output file]``, and its answer the process id. The exit code is written to a
file next to the output. Threads have their Python names for the kernel, too, so that one of them can be stopped from
outside.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from tests.support.handles import Handle

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_PR_SET_NAME = 15
_ROOT = Path(__file__).parents[3]


class Command:
    """A command that runs in a process of its own."""

    def __init__(self, pid: int, output: Path) -> None:
        self.pid = pid
        self._handle = Handle(pid)
        self._output = output

    @property
    def output(self) -> str:
        """Return its output so far."""
        return self._output.read_text(errors="replace") if self._output.exists() else ""

    @property
    def code(self) -> int | None:
        """Its exit code, or None while it runs; -9 if it was killed."""
        if self._handle.running:
            return None
        written = self._output.with_suffix(".code")
        return int(written.read_text()) if written.exists() else -signal.SIGKILL

    def wait(self, within: float = 180.0) -> int:
        """Wait until it has ended; return its exit code."""
        deadline = time.monotonic() + within
        while (code := self.code) is None:
            assert time.monotonic() < deadline, f"it has not ended within {within:g} s: {self.output[-2000:]}"
            time.sleep(0.003)
        return code

    def signal(self, number: signal.Signals) -> None:
        self._handle.signal(number)

    def kill(self) -> None:
        """kill -9, and wait until it is gone."""
        self._handle.kill()


class Forker:
    """Starts commands.

    Args:
        environ: of the commands, in addition to this process's.
    """

    def __init__(self, folder: Path, environ: Mapping[str, str] | None = None) -> None:
        self._folder = folder
        self._commands: list[Command] = []
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.system.torture.forker"],
            cwd=_ROOT,
            env=os.environ | (environ or {}),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def start(self, *arguments: str) -> Command:
        """Run ``rsb-console ARGUMENTS``."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with self._lock:
            output = self._folder / f"command{len(self._commands)}.log"
            self._process.stdin.write(json.dumps([arguments, str(output)]) + "\n")
            self._process.stdin.flush()
            command = Command(int(self._process.stdout.readline()), output)
            self._commands.append(command)
        return command

    def close(self) -> None:
        """Kill them all."""
        for command in self._commands:
            command.kill()
        self._process.communicate()


def _run(arguments: Sequence[str], output: str) -> int:
    from rsb_console.cli import main as rsb_console

    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    _name_threads()
    descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for stream in (1, 2):
        os.dup2(descriptor, stream)
    try:
        code = rsb_console([*arguments])
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    sys.stdout.flush()
    Path(output).with_suffix(".code").write_text(str(code))
    return code


def _name_threads() -> None:
    run = threading.Thread.run

    def run_named(thread: threading.Thread) -> None:
        ctypes.CDLL(None).prctl(_PR_SET_NAME, thread.name.encode()[:15], 0, 0, 0)
        run(thread)

    threading.Thread.run = run_named  # type: ignore[assignment]


def main() -> int:
    """Fork until the input ends."""
    for module in ("cli", "command.headless", "command.remote"):
        importlib.import_module(f"rsb_console.{module}")
    for module in ("rsb_bridge.ros.participant", "std_msgs.msg", "geometry_msgs.msg"):
        importlib.import_module(module)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # no zombies
    print("ready", flush=True)  # noqa: T201
    for line in sys.stdin:
        arguments, output = json.loads(line)
        pid = os.fork()
        if not pid:
            os._exit(_run(arguments, output))
        print(pid, flush=True)  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""`rsb-console` in processes whose threads have their Python names for the kernel, too, so that one can be stopped."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.support.forker import Forked
from tests.support.program import Program

_PR_SET_NAME = 15
_ROOT = Path(__file__).parents[3]


def started(module: str, *arguments: str, environ: Mapping[str, str] | None = None, **streams: Any) -> Any:
    """Run a module in a process of its own. A variable of `environ` may name a library to load before all others."""
    if environ is None:
        return Forked(module, *arguments, **streams)
    command = [sys.executable, "-m", module, *arguments]
    return subprocess.Popen(command, cwd=_ROOT, env=os.environ | environ, text=True, **streams)


class Command(Program):
    """A command that runs.

    Attributes:
        wait: until it has ended, for so many seconds at most.
    """

    def __init__(self, process: Any, log: Path) -> None:
        super().__init__(process.pid, log, process.wait)
        self.wait = process.wait


class Commands:
    """Starts commands.

    Args:
        environ: of their processes, in addition to this one's, or None.
    """

    def __init__(self, folder: Path, environ: Mapping[str, str] | None = None) -> None:
        self._folder, self._environ = folder, environ
        self._commands: list[Command] = []

    def start(self, *arguments: str) -> Command:
        """Run ``rsb-console ARGUMENTS``."""
        log = self._folder / f"command{len(self._commands)}.log"
        with log.open("w") as output:
            streams = {"stdin": subprocess.DEVNULL, "stdout": output, "stderr": output}
            process = started("tests.system.torture.program", *arguments, environ=self._environ, **streams)
        self._commands.append(Command(process, log))
        return self._commands[-1]

    def close(self) -> None:
        """Kill them all."""
        for command in self._commands:
            command.kill()


def _name_threads() -> None:
    run = threading.Thread.run

    def run_named(thread: threading.Thread) -> None:
        ctypes.CDLL(None).prctl(_PR_SET_NAME, thread.name.encode()[:15], 0, 0, 0)
        run(thread)

    threading.Thread.run = run_named  # type: ignore[assignment]


if __name__ == "__main__":
    from rsb_console.cli import main

    _name_threads()
    sys.exit(main())

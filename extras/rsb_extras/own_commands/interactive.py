"""A command that gets the terminal, such as ssh or an editor, until it ends."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_console.feature_console import Console


async def run_in_terminal(console: Console, line: str) -> int:
    """Run a line of ``/bin/sh`` in the console's terminal, and return its exit code.

    Raises:
        OSError: it cannot be started.
    """
    with _interrupts() as interrupts, console.suspend():
        # In a group of its own: Ctrl+C there is not for the console.
        process = subprocess.Popen(  # noqa: ASYNC220, S603 -- the operator's own line; the console shows nothing meanwhile
            ["/bin/sh", "-c", line], stdin=0, stdout=console.terminal, stderr=console.terminal, process_group=0
        )
        interrupts.go_to(process.pid)
        try:
            return await asyncio.to_thread(_wait, process, console.terminal)
        except asyncio.CancelledError:  # the console ends
            os.killpg(process.pid, signal.SIGHUP)
            raise


class _Interrupts:
    """SIGINTs of this process: Ctrl+C is one until a command has the terminal's keys, and after its end."""

    def __init__(self) -> None:
        self._group = 0
        self._came = False

    def go_to(self, group: int) -> None:
        """Pass them on to a process group, also one that has come before."""
        self._group = group
        if self._came:
            self.interrupt()

    def interrupt(self, *_: object) -> None:
        self._came = True
        if self._group:
            with contextlib.suppress(OSError):  # it has ended, or is root's by now, as with sudo
                os.killpg(self._group, signal.SIGINT)


@contextlib.contextmanager
def _interrupts() -> Iterator[_Interrupts]:
    """Pass SIGINT on instead of ending the console."""
    made = _Interrupts()
    before = signal.signal(signal.SIGINT, made.interrupt)  # not SIG_IGN, which the command would inherit
    try:
        yield made
    finally:
        signal.signal(signal.SIGINT, before)


def _wait(process: subprocess.Popen[bytes], terminal: int) -> int:
    with _in_foreground(terminal, process.pid):
        while True:
            # It was stopped if it asked for a key before it had the terminal. After Ctrl+Z nothing else continues it.
            os.killpg(process.pid, signal.SIGCONT)
            ended = os.waitid(os.P_PID, process.pid, os.WEXITED | os.WSTOPPED | os.WNOWAIT)
            if ended is None or ended.si_code != os.CLD_STOPPED:
                return process.wait()
            os.waitid(os.P_PID, process.pid, os.WSTOPPED)


@contextlib.contextmanager
def _in_foreground(terminal: int, group: int) -> Iterator[None]:
    """Give a process group the keys of the terminal meanwhile."""
    # The kernel would stop this process if it changed that from the background.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTTOU})
    own = os.getpgrp()
    try:
        with contextlib.suppress(OSError):  # no terminal, as in tests
            os.tcsetpgrp(terminal, group)
        yield
    finally:
        with contextlib.suppress(OSError):
            os.tcsetpgrp(terminal, own)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

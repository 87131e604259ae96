"""Stops one thread of another process, as a lock or a driver that never returns does."""

from __future__ import annotations

import contextlib
import ctypes
import os
import time
from collections.abc import Iterator
from pathlib import Path

_PTRACE_CONT, _PTRACE_DETACH, _PTRACE_SEIZE, _PTRACE_INTERRUPT = 7, 17, 0x4206, 0x4207
_WALL = 0x40000000
_WAITS_IN = {"232", "281", "7", "271", "202", "230", "35", "270", "23", "449"}
"""System calls of x86-64 in which a thread of Python waits without the interpreter's lock."""


def thread_of(pid: int, name: str) -> int:
    """The id of a process's thread by its name."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        if (task / "comm").read_text().strip() == name:
            return int(task.name)
    raise LookupError(f"process {pid} has no thread called {name}")


@contextlib.contextmanager
def stopped(pid: int, name: str) -> Iterator[None]:
    """Stop a thread for the length of the block, while it waits for something and holds no lock of the interpreter."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    libc.ptrace.restype = ctypes.c_long
    thread = thread_of(pid, name)

    def ptrace(request: int) -> None:
        if libc.ptrace(request, thread, None, None) < 0:
            raise OSError(ctypes.get_errno(), f"ptrace: {os.strerror(ctypes.get_errno())}")

    ptrace(_PTRACE_SEIZE)
    deadline = time.monotonic() + 5
    while True:
        ptrace(_PTRACE_INTERRUPT)
        os.waitpid(thread, _WALL)
        if Path(f"/proc/{pid}/task/{thread}/syscall").read_text().split()[0] in _WAITS_IN:
            break
        ptrace(_PTRACE_CONT)
        assert time.monotonic() < deadline, "it never waits"
        time.sleep(0.002)
    try:
        yield
    finally:
        ptrace(_PTRACE_DETACH)

"""Sends SIGSTOP, and waits until it has arrived."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from tests.support.waiting import eventually


def stop(pid: int) -> None:
    """Stop a process, and wait for all its threads, which SIGSTOP reaches one after another."""
    os.kill(pid, signal.SIGSTOP)
    threads = Path(f"/proc/{pid}/task")
    eventually(lambda: all(_state(each) == "T" for each in threads.iterdir()), what="all threads stop")


def _state(thread: Path) -> str:
    return (thread / "stat").read_text().rpartition(")")[2].split()[0]

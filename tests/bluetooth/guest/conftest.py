"""The machine's two adapters, in each other's reach, and other processes that hold channels."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from rsb_bridge import hci

Wait = Callable[[Callable[[], object], str], None]

_HOLDER = """
import socket, sys
held = []
for what in sys.argv[1:]:
    address, channel, listen = what.split(",")
    sock = socket.socket(socket.AF_BLUETOOTH, socket.SOCK_STREAM, socket.BTPROTO_RFCOMM)
    sock.bind((address, int(channel)))
    if listen == "listen":
        sock.listen(1)
    held.append(sock)
print("holding", flush=True)
sys.stdin.read()
"""


@pytest.fixture(scope="session")
def addresses() -> tuple[str, str]:
    """Those of hci0 and hci1."""
    first, second = hci.adapters()
    return first.address, second.address


@contextmanager
def holding(*channels: tuple[str, int, str]) -> Iterator[None]:
    """Another process binds these (address, channel), and listens where the third is ``listen``."""
    arguments = [f"{address},{channel},{how}" for address, channel, how in channels]
    with subprocess.Popen(
        [sys.executable, "-c", _HOLDER, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "holding\n"
        yield
        holder.communicate()


def wait_until(condition: Callable[[], object], what: str, seconds: float = 10.0) -> None:
    """Wait for a condition, with a deadline."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"not within {seconds} s: {what}"
        time.sleep(0.05)

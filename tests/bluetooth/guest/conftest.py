"""The machine's two adapters, in each other's reach, and other processes that hold channels."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from tests.support.coroutines import pytest_pyfunc_call

from rsb_bridge.bluetooth import hci

__all__ = ["addresses", "pytest_pyfunc_call"]
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


def wait_until(condition: Callable[..., object], what: str, seconds: float = 180.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"not within {seconds} s: {what}"
        time.sleep(0.05)


def bare_rate(address: str, size: int = 500_000) -> float:
    """Bytes/s that blocking sockets with a thread each carry to an adapter, when they do nothing else."""
    with hci.rfcomm_socket() as listener, hci.rfcomm_socket() as client:
        listener.bind((address, 29))
        listener.listen(1)
        client.connect((address, 29))
        server, _ = listener.accept()
        with server:
            writing = threading.Thread(target=_write, args=(client, size))
            started = time.monotonic()
            writing.start()
            left = size
            while left:
                left -= len(server.recv(left))
            seconds = time.monotonic() - started
            writing.join()
    return size / seconds


def _write(sock: socket.socket, size: int) -> None:
    while size:
        size -= sock.send(bytes(min(size, 2048)))

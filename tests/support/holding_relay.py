"""A network that holds everything for a while before it passes it on, in order: TCP and UDP, each way."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

_TICK = 0.005
_CHUNK = 65_536


class HoldingRelay:
    """Relays one port. A context manager; it runs on a thread of its own.

    Args:
        target_port: where everything goes, on `HOST`.
        host: to listen on.
        port: likewise, or 0 for a free one.

    Attributes:
        port: to connect to.
        held: s that everything waits; may be set at any time.
    """

    HOST = "127.0.0.1"

    def __init__(self, target_port: int, *, host: str = HOST, port: int = 0) -> None:
        self.held = 0.0
        self._target = self.HOST, target_port
        self._listener = socket.create_server((host, port))
        self.port: int = self._listener.getsockname()[1]
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind((host, self.port))
        self._far: dict[tuple[str, int], socket.socket] = {}
        self._sockets = [self._listener, self._near]
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(self._near, selectors.EVENT_READ, self._from_client)
        self._waiting: deque[tuple[float, Callable[[], object]]] = deque()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="holding relay", daemon=True)

    def __enter__(self) -> HoldingRelay:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._over.is_set():
                for key, _ in self._selector.select(_TICK):
                    key.data()
                now = time.monotonic()
                while self._waiting and self._waiting[0][0] <= now:
                    with contextlib.suppress(OSError):
                        self._waiting.popleft()[1]()
        finally:
            for sock in self._sockets:
                sock.close()
            self._selector.close()

    def _later(self, act: Callable[[], object]) -> None:
        before = self._waiting[-1][0] if self._waiting else 0.0
        self._waiting.append((max(before, time.monotonic() + self.held), act))

    def _accept(self) -> None:
        near, _ = self._listener.accept()
        try:
            far = socket.create_connection(self._target)
        except OSError:
            near.close()
            return
        for source, sink in ((near, far), (far, near)):
            source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._sockets.append(source)
            self._selector.register(source, selectors.EVENT_READ, lambda a=source, b=sink: self._pass(a, b))

    def _pass(self, source: socket.socket, sink: socket.socket) -> None:
        try:
            data = source.recv(_CHUNK)
        except OSError:
            data = b""
        if data:
            self._later(lambda: sink.sendall(data))
        else:
            self._selector.unregister(source)
            self._later(lambda: sink.shutdown(socket.SHUT_WR))

    def _from_client(self) -> None:
        data, address = self._near.recvfrom(_CHUNK)
        if address not in self._far:
            far = self._far[address] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            far.connect(self._target)
            self._sockets.append(far)
            self._selector.register(far, selectors.EVENT_READ, lambda: self._from_server(far, address))
        far = self._far[address]
        self._later(lambda: far.send(data))

    def _from_server(self, far: socket.socket, address: tuple[str, int]) -> None:
        with contextlib.suppress(OSError):
            data = far.recv(_CHUNK)
            self._later(lambda: self._near.sendto(data, address))

"""A network whose control connection, data connections and datagrams can be held and released one by one."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Literal, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

Stream: TypeAlias = Literal["control", "data", "datagrams"]
STREAMS: tuple[Stream, ...] = ("control", "data", "datagrams")

_TICK = 0.005
_CHUNK = 65_536


class GateRelay:
    """Relays one port over TCP and UDP. A context manager; it runs on a thread of its own.

    Args:
        target_port: where everything goes, on `HOST`.

    Attributes:
        port: to connect to.
        delay: gives the seconds that the next piece waits; pieces of one connection keep their order.
    """

    HOST = "127.0.0.1"

    def __init__(self, target_port: int) -> None:
        self.delay: Callable[[], float] = lambda: 0.0
        self._target = self.HOST, target_port
        self._held: frozenset[Stream] = frozenset()
        self._pipes: list[_Pipe] = []
        self._far: dict[tuple[str, int], socket.socket] = {}
        self._listener = socket.create_server((self.HOST, 0))
        self.port: int = self._listener.getsockname()[1]
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind((self.HOST, self.port))
        self._there, self._back = _Datagrams(), _Datagrams()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(self._near, selectors.EVENT_READ, self._from_client)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="gate relay", daemon=True)

    def __enter__(self) -> GateRelay:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()

    def hold(self, streams: Iterable[Stream] = STREAMS) -> None:
        """Pass on nothing of these streams, either way; the relay keeps what comes."""
        self._held = self._held | {*streams}

    def release(self, streams: Iterable[Stream] = STREAMS) -> None:
        """Pass on what was kept of these streams, and what comes from now on."""
        self._held = self._held - {*streams}

    def _run(self) -> None:
        try:
            while not self._over.is_set():
                for key, _ in self._selector.select(_TICK):
                    key.data()
                self._pour()
        finally:
            for pipe in self._pipes:
                pipe.close()
            for sock in (*self._far.values(), self._near, self._listener):
                sock.close()
            self._selector.close()

    def _pour(self) -> None:
        held, now = self._held, time.monotonic()
        for pipe in self._pipes:
            if pipe.stream not in held:
                pipe.pour(now)
        if "datagrams" not in held:
            self._there.pour(now)
            self._back.pour(now)
        for pipe in [each for each in self._pipes if each.done]:
            for each in [each for each in self._pipes if each.source in {pipe.source, pipe.sink}]:
                if each.reading:
                    self._selector.unregister(each.source)
                each.close()
                self._pipes.remove(each)

    def _accept(self) -> None:
        near, _ = self._listener.accept()
        try:
            far = socket.create_connection(self._target)
        except OSError:
            near.close()
            return
        stream: Stream = "data" if self._pipes else "control"  # a link opens its control connection first
        for sock in (near, far):
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for source, sink in ((near, far), (far, near)):
            pipe = _Pipe(source, sink, stream)
            self._pipes.append(pipe)
            self._selector.register(source, selectors.EVENT_READ, lambda pipe=pipe: self._read(pipe))

    def _read(self, pipe: _Pipe) -> None:
        if not pipe.reading:
            return
        pipe.read(time.monotonic() + self.delay())
        if pipe.ended:
            self._selector.unregister(pipe.source)
            pipe.reading = False

    def _from_client(self) -> None:
        data, address = self._near.recvfrom(_CHUNK)
        if address not in self._far:
            far = self._far[address] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            far.connect(self._target)
            self._selector.register(far, selectors.EVENT_READ, lambda: self._from_server(far, address))
        far = self._far[address]
        self._there.put(time.monotonic() + self.delay(), lambda: far.send(data))

    def _from_server(self, far: socket.socket, address: tuple[str, int]) -> None:
        with contextlib.suppress(OSError):
            data = far.recv(_CHUNK)
            self._back.put(time.monotonic() + self.delay(), lambda: self._near.sendto(data, address))


class _Pipe:
    """One way of a connection."""

    def __init__(self, source: socket.socket, sink: socket.socket, stream: Stream) -> None:
        self.source = source
        self.sink = sink
        self.stream = stream
        self.reading = True
        self.ended = False
        self._waiting: deque[tuple[float, bytes]] = deque()

    @property
    def done(self) -> bool:
        """Whether the end has come and everything before it is passed on."""
        return self.ended and not self._waiting

    def read(self, due: float) -> None:
        try:
            data = self.source.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self.ended = not data
        if data:
            before = self._waiting[-1][0] if self._waiting else 0.0
            self._waiting.append((max(before, due), data))

    def pour(self, now: float) -> None:
        while self._waiting and self._waiting[0][0] <= now:
            due, data = self._waiting.popleft()
            try:
                sent = self.sink.send(data)
            except BlockingIOError:
                sent = 0
            except OSError:
                self._waiting.clear()
                self.ended = True
                return
            if sent < len(data):
                self._waiting.appendleft((due, data[sent:]))
                return

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self.source.close()


class _Datagrams:
    """The datagrams of one way."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[float, Callable[[], object]]] = deque()

    def put(self, due: float, send: Callable[[], object]) -> None:
        before = self._waiting[-1][0] if self._waiting else 0.0
        self._waiting.append((max(before, due), send))

    def pour(self, now: float) -> None:
        while self._waiting and self._waiting[0][0] <= now:
            with contextlib.suppress(OSError):
                self._waiting.popleft()[1]()

"""A TCP tunnel that carries little, as ``ssh -L`` over a poor uplink does, or a router that carries UDP as well.

It accepts whatever the kernel and its own buffers hold, and lets it out at its rate: a sender that watches only its own
socket sees nothing of what waits. Of datagrams it keeps a few, and drops those that find no room. A tunnel saves
nothing up: while nothing waits in it, or this process gets no processor, no bytes are earned that would cross faster
later.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType
    from typing import TypeAlias

    _Sender: TypeAlias = "_Pipe | _Datagrams"

HELD = 256 * 1024
"""Bytes of one connection and way that the relay itself holds, beside what the kernel keeps for it."""

QUEUE = 16 * 1024
"""Bytes of datagrams that it holds, each way."""

_TURN = 512
"""Bytes of one connection that go out before another one's turn."""
_TICK = 0.01
_LONGEST_TURN = 0.1
"""s from one turn of the relay's thread to the next; the rest of a longer one is a pause, in which nothing crosses."""
_CHUNK = 16 * 1024


class SlowRelay:
    """Relays one port. A context manager; it runs on a thread of its own.

    All connections share the rate, each way on its own. They take turns, so that a quiet connection does not wait for
    the buffers of a busy one; with `fifo` whatever comes first goes first, as in the one queue of an uplink.

    Args:
        target_port: where connections are passed on to.
        bytes_per_second: that cross, each way.
        target_host: of the port.
        held: bytes that the relay keeps of a connection, each way.
        fifo: whether all connections share one queue.

    Attributes:
        port: to connect to, on `HOST`.
        bytes_per_second: may be set at any time; 0 stalls it.
    """

    HOST = "127.0.0.1"

    def __init__(
        self,
        target_port: int,
        bytes_per_second: float,
        *,
        target_host: str = "127.0.0.1",
        held: int = HELD,
        fifo: bool = False,
    ) -> None:
        self.bytes_per_second = bytes_per_second
        self._target = target_host, target_port
        self._held = held
        self._listener = socket.create_server((self.HOST, 0))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind((self.HOST, self.port))
        self._near.setblocking(False)
        self._selector.register(self._near, selectors.EVENT_READ, self._from_client)
        self._flows: dict[tuple[str, int], _Flow] = {}
        self._ways = {"there": _Way(fifo=fifo), "back": _Way(fifo=fifo)}
        self._pipes: list[_Pipe] = []
        self._pauses: list[tuple[int, int]] = []  # ns since the epoch
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="slow relay", daemon=True)

    def __enter__(self) -> SlowRelay:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()

    @property
    def carried(self) -> int:
        """Bytes that it has passed on to the target so far."""
        return self._ways["there"].carried

    @property
    def waiting(self) -> int:
        """Bytes that it holds on their way to the target; the kernel may hold more."""
        return sum(pipe.waiting for pipe in tuple(self._pipes) if pipe.way is self._ways["there"])

    def paused(self, begin: int, end: int) -> float:
        """How long (s) the relay stood still between two times (ns since the epoch), for want of a processor."""
        return sum(max(0, min(end, until) - max(begin, since)) for since, until in tuple(self._pauses)) / 1e9

    def _run(self) -> None:
        before = time.monotonic()
        try:
            while not self._over.is_set():
                for key, _ in self._selector.select(_TICK):
                    if key.data is None:
                        self._accept()
                    elif isinstance(key.data, _Pipe):
                        self._read(key.data)
                    else:
                        key.data()
                now = time.monotonic()
                turn = min(now - before, _LONGEST_TURN)
                if turn < now - before:
                    self._pauses.append((time.time_ns() - int((now - before - turn) * 1e9), time.time_ns()))
                for way in self._ways.values():
                    way.earn(self.bytes_per_second * turn)
                    way.pour()
                before = now
                self._tidy()
                if not self._busy():
                    time.sleep(_TICK)
        finally:
            for pipe in self._pipes:
                pipe.close()
            for flow in self._flows.values():
                flow.far.close()
            self._near.close()
            self._listener.close()
            self._selector.close()

    def _busy(self) -> bool:
        return any(way.queued and way.budget >= 1 for way in self._ways.values())

    def _accept(self) -> None:
        near, _ = self._listener.accept()
        try:
            far = socket.create_connection(self._target)
        except OSError:
            near.close()
            return
        for sock in (near, far):
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for source, sink, name in ((near, far, "there"), (far, near, "back")):
            pipe = _Pipe(source, sink, self._ways[name])
            self._pipes.append(pipe)
            self._selector.register(source, selectors.EVENT_READ, pipe)

    def _read(self, pipe: _Pipe) -> None:
        pipe.read(self._held - pipe.waiting)
        if pipe.ended or pipe.waiting >= self._held:
            self._selector.unregister(pipe.source)
            pipe.reading = False

    def _from_client(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                data, address = self._near.recvfrom(_CHUNK)
                (self._flows.get(address) or self._connect(address)).there.put(data)

    def _connect(self, address: tuple[str, int]) -> _Flow:
        far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        far.connect(self._target)
        far.setblocking(False)
        there = _Datagrams(self._ways["there"], far.send)
        back = _Datagrams(self._ways["back"], lambda data: self._near.sendto(data, address))
        flow = self._flows[address] = _Flow(far, there, back)
        self._selector.register(far, selectors.EVENT_READ, flow.from_server)
        return flow

    def _tidy(self) -> None:
        """Read again where there is room, and end connections of which one way has ended and is empty."""
        for pipe in tuple(self._pipes):
            if pipe.ended and not pipe.waiting:
                for each in [each for each in self._pipes if each.source in {pipe.source, pipe.sink}]:
                    if each.reading:
                        self._selector.unregister(each.source)
                    each.close()
                    each.way.forget(each)
                    self._pipes.remove(each)
            elif not pipe.ended and not pipe.reading and pipe.waiting < self._held:
                self._selector.register(pipe.source, selectors.EVENT_READ, pipe)
                pipe.reading = True


class _Pipe:
    """One way of a connection."""

    def __init__(self, source: socket.socket, sink: socket.socket, way: _Way) -> None:
        self.source = source
        self.sink = sink
        self.way = way
        self.waiting = 0
        self.reading = True
        self.ended = False

    def read(self, most: int) -> None:
        try:
            data = self.source.recv(min(most, _CHUNK))
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.ended = True
            return
        self.waiting += len(data)
        self.way.put(self, data)

    def send(self, data: bytes, most: int) -> int:
        try:
            return self.sink.send(data[:most])
        except BlockingIOError:
            return 0
        except OSError:
            self.ended = True
            return len(data)  # it leads nowhere any more

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self.source.close()


class _Datagrams:
    """One way of a client's datagrams, which go whole."""

    def __init__(self, way: _Way, send: Callable[[bytes], int]) -> None:
        self.way = way
        self.waiting = 0
        self._send = send

    def put(self, data: bytes) -> None:
        if self.waiting + len(data) <= QUEUE:
            self.waiting += len(data)
            self.way.put(self, data)

    def send(self, data: bytes, most: int) -> int:
        with contextlib.suppress(OSError):
            self._send(data)
        return len(data)


class _Flow(NamedTuple):
    """The datagrams of one client, both ways."""

    far: socket.socket
    there: _Datagrams
    back: _Datagrams

    def from_server(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                self.back.put(self.far.recv(_CHUNK))


class _Way:
    """What waits to go one way, of all connections and datagrams."""

    def __init__(self, *, fifo: bool) -> None:
        self.carried = 0
        self.budget = 0.0
        self._fifo = fifo
        self._lines: dict[_Sender | None, deque[tuple[_Sender, bytes]]] = {}
        self._turns: deque[_Sender | None] = deque()

    @property
    def queued(self) -> bool:
        return bool(self._turns)

    def put(self, pipe: _Sender, data: bytes) -> None:
        line = None if self._fifo else pipe
        if line not in self._lines:
            self._lines[line] = deque()
            self._turns.append(line)
        self._lines[line].append((pipe, data))

    def earn(self, size: float) -> None:
        self.budget += size

    def forget(self, pipe: _Sender) -> None:
        for line, waiting in tuple(self._lines.items()):
            kept = deque(each for each in waiting if each[0] is not pipe)
            self._lines[line] = kept
            if not kept:
                del self._lines[line]
                self._turns.remove(line)

    def pour(self) -> None:
        """Let out what the budget allows, the connections in turn; a datagram may go in advance of it."""
        blocked = 0
        while self.budget >= 1 and self._turns and blocked < len(self._turns):
            line = self._turns.popleft()
            waiting = self._lines[line]
            pipe, data = waiting.popleft()
            sent = pipe.send(data, _TURN)
            self.budget -= sent
            pipe.waiting -= sent
            self.carried += sent
            if sent < len(data):
                waiting.appendleft((pipe, data[sent:]))
            blocked = 0 if sent else blocked + 1
            if waiting:
                self._turns.append(line)
            else:
                del self._lines[line]
        if not self._turns:
            self.budget = min(self.budget, 0.0)  # what a datagram took in advance is still owed


def stamped(index: int, size: int) -> str:
    """The content of a message, of `size` characters, that says which one it is and when it was made."""
    head = f"{index} {time.time_ns()} "
    return head + os.urandom((size - len(head) + 1) // 2).hex()[: size - len(head)]


def read_stamp(content: str) -> tuple[int, int]:
    """Return which message it is, and when it was made (ns since the epoch)."""
    index, made = content.split(" ", 2)[:2]
    return int(index), int(made)

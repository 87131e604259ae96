"""A network between two programs: passes one TCP and one UDP port on, by rules that a test may change at any time.

Without rules everything passes at once. A rule may delay, hold, drop, alter or refuse, or limit the rate.

Like a poor uplink or an ``ssh -L``, a relay with a rate takes as much as its buffers and the kernel's hold, so a sender
that watches only its own socket does not see that queue. It saves no bytes for later while its queue is empty, or while
this process gets no processor.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Literal, NamedTuple, TypeAlias

from tests.support.ports import free_port

Stream: TypeAlias = Literal["control", "data", "datagrams"]
Fate: TypeAlias = Callable[[bytes], list[bytes]]
"""Returns what to pass on in place of a datagram: nothing, itself, itself twice, another."""

TCP: tuple[Stream, ...] = ("control", "data")
STREAMS: tuple[Stream, ...] = (*TCP, "datagrams")
CLIENTS_ADDRESS, SERVERS_ADDRESS = "127.0.0.3", "127.0.0.2"
HELD = 256 * 1024
"""Bytes of one connection and direction that a relay with a rate holds, in addition to the kernel's buffers."""
QUEUE = 16 * 1024
"""Bytes of one client's datagrams and direction that a relay with a rate holds by default."""

_U32 = struct.Struct(">I")
_TURN = 512
"""Bytes of one connection that a relay with a rate passes on before another connection's turn."""
_TICK = 0.005
_RATE_TICK = 0.01
_IDLE = 0.05
_LONGEST_TURN = 0.1
"""s from one turn of the thread to the next; the rest of a longer one is a pause, in which nothing crosses."""
_CHUNK = 65_536
_RATE_CHUNK = 16 * 1024
_RECORDED = 65_536
_MOST_CONNECTIONS, _MOST_SOURCES = 64, 64
"""Ended connections and client addresses that are remembered: a run of hours has thousands of them."""
_SO_RCVBUFFORCE = 33
_UDP_BUFFER = 8 << 20


def message_number(datagram: bytes) -> int | None:
    """Return the number of a datagram's message in its route (PROTOCOL.md, section 2), or None for a probe."""
    route, number = _U32.unpack_from(datagram, 6)[0], _U32.unpack_from(datagram, 26)[0]
    return number if route else None


def same_port(port: int) -> Relay:
    """Return a relay between one port of two addresses, so that the ports in a session are the same without it.

    It holds little, so that an end notices soon when the other one stalls.
    """
    return Relay((SERVERS_ADDRESS, port), CLIENTS_ADDRESS, port, room=65_536)


class Relay:
    """Relays one port, on a thread of its own. A context manager.

    All connections share the rate, each direction on its own. They take turns, so a quiet connection does not wait for
    the queue of a busy one; with `fifo` they share one queue, as in an uplink.

    Args:
        target: the address and port that everything is passed on to.
        host: the address to listen on.
        port: the port to listen on, or 0 for a free one.
        rate: bytes/s in each direction, or None for no limit.
        room: bytes of a connection and direction to hold, or None for `HELD` with a rate, and no limit without.
        queue: bytes of one client's datagrams and direction to hold with a rate; it drops the others.
        fifo: whether all connections share one queue.

    Attributes:
        rate: may be set at any time; 0 stalls it.
        delay: returns the seconds that the next piece waits; pieces of one connection keep their order.
        to_server: the fate of datagrams to the server.
        to_client: the fate of datagrams to the client.
        connections: the last TCP connections, oldest first.
    """

    def __init__(
        self,
        target: tuple[str, int],
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        rate: float | None = None,
        room: int | None = None,
        queue: int = QUEUE,
        fifo: bool = False,
    ) -> None:
        self.target, self.host = target, host
        self.rate = rate
        self.delay: Callable[[], float] = lambda: 0.0
        self.to_server: Fate = lambda datagram: [datagram]
        self.to_client: Fate = lambda datagram: [datagram]
        self.connections: list[Connection] = []
        self.room = HELD if rate is not None and room is None else room
        self._window = None if room is None else room // 2
        self.held: frozenset[Stream] = frozenset()
        self.queue = queue
        self._stalls_new = False
        self.ways = (_Way(self, fifo=fifo), _Way(self, fifo=fifo))
        self._pauses: deque[tuple[int, int]] = deque(maxlen=10_000)  # ns since the epoch
        self._sources: dict[tuple[str, int], _Source] = {}
        self.selector = selectors.DefaultSelector()
        self.port = port or free_port(host)  # the kernel's choice for TCP may be in use for UDP
        self._listener: socket.socket | None = None
        self._listen()
        self._near = _udp_socket()
        self._near.bind((host, self.port))
        self.selector.register(self._near, selectors.EVENT_READ, self._from_client)
        self._work: SimpleQueue[tuple[Callable[[], None], Future[None]]] = SimpleQueue()
        self._wake, wakes = socket.socketpair()
        self.selector.register(wakes, selectors.EVENT_READ, lambda: wakes.recv(_CHUNK))
        self._wakes = wakes
        self._over = False
        self._thread = threading.Thread(target=self._run, name="relay", daemon=True)
        self._thread.start()

    def __enter__(self) -> Relay:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # --- rules

    def hold(self, streams: Iterable[Stream] = STREAMS) -> None:
        """Keep everything of these streams, in both directions."""
        self.held = self.held | {*streams}

    def release(self, streams: Iterable[Stream] = STREAMS) -> None:
        """Pass these streams on again, the kept pieces first."""
        self.held = self.held - {*streams}

    def stall(self, stalled: bool = True, *, new: bool = False) -> None:
        """Hold all present TCP connections, with `new` also later ones, or let them go on."""
        self._stalls_new = stalled and new
        for connection in tuple(self.connections):
            connection.stall(stalled)

    def cut(self) -> None:
        """End every TCP connection."""
        self._call(self._cut)

    def refuse(self, refuses: bool = True) -> None:
        """End every TCP connection and refuse new ones, or accept them again."""
        self._call(self._refuse if refuses else self._listen)

    def close(self) -> None:
        self._call(self._end)
        self._thread.join()
        for sock in (self._wake, self._wakes):  # the thread may end before it is woken
            sock.close()

    # --- figures

    @property
    def carried(self) -> int:
        """Bytes that it has passed on to the target."""
        return self.ways[0].carried

    @property
    def waiting(self) -> int:
        """Bytes of connections to the target that it holds; the kernel may hold more."""
        return sum(each.there.waiting for each in tuple(self.connections) if not each.closed)

    def paused(self, begin: int, end: int) -> float:
        """Return how long (s) its thread got no processor between two times (ns since the epoch)."""
        return sum(max(0, min(end, until) - max(begin, since)) for since, until in tuple(self._pauses)) / 1e9

    # --- on its thread

    def _call(self, work: Callable[[], None]) -> None:
        done: Future[None] = Future()
        self._work.put((work, done))
        self._wake.send(b"\0")
        done.result(60)

    def _run(self) -> None:
        before = time.monotonic()
        try:
            while not self._over:
                waits = any(way.queued for way in self.ways)
                for key, _ in self.selector.select(_IDLE if not waits else _TICK if self.rate is None else _RATE_TICK):
                    key.data()
                while not self._work.empty():
                    work, done = self._work.get()
                    work()
                    done.set_result(None)
                now = time.monotonic()
                self._turn(now, now - before)
                before = now
        finally:
            for connection in self.connections:
                connection.abort()
            for source in self._sources.values():
                source.far.close()
            self._near.close()
            if self._listener is not None:
                self._listener.close()
            self.selector.close()

    def _turn(self, now: float, seconds: float) -> None:
        turn = min(seconds, _LONGEST_TURN)
        if turn < seconds:
            self._pauses.append((time.time_ns() - int((seconds - turn) * 1e9), time.time_ns()))
        for connection in [each for each in self.connections if each.far is None and not each.closed]:
            if not connection.held:
                connection.connect()
        for way in self.ways:
            way.pour(now, float("inf") if self.rate is None else self.rate * turn)
        for connection in self.connections:
            connection.read_again()
        if self.rate is not None and not any(way.queued and way.budget >= 1 for way in self.ways):
            time.sleep(_RATE_TICK)

    def _end(self) -> None:
        self._over = True

    def _cut(self) -> None:
        for connection in self.connections:
            connection.abort()

    def _refuse(self) -> None:
        if self._listener is not None:
            self.selector.unregister(self._listener)
            self._listener.close()
            self._listener = None
        self._cut()

    def _listen(self) -> None:
        if self._listener is not None:
            return
        listener = self._listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if self._window is not None:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self._window)
        listener.bind((self.host, self.port))
        listener.listen(128)
        listener.setblocking(False)
        self.selector.register(listener, selectors.EVENT_READ, self._accept)

    def _accept(self) -> None:
        assert self._listener is not None
        try:
            near, _ = self._listener.accept()
        except OSError:
            return  # the client has gone meanwhile
        present = [each for each in self.connections if not each.closed]
        kind: Stream = "data" if present else "control"  # a link opens its control connection first
        connection = Connection(self, near, kind)
        connection.stall(self._stalls_new)
        while len(self.connections) >= _MOST_CONNECTIONS and self.connections[0].closed:
            del self.connections[0]
        self.connections.append(connection)
        if not connection.held:
            connection.connect()

    def _from_client(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                data, address = self._near.recvfrom(_CHUNK)
                source = self._sources.get(address) or self._connect(address)
                for datagram in self.to_server(data):
                    source.there.put(datagram)

    def _from_server(self, source: _Source) -> None:
        with contextlib.suppress(OSError):
            while True:
                for datagram in self.to_client(source.far.recv(_CHUNK)):
                    source.back.put(datagram)

    def _connect(self, address: tuple[str, int]) -> _Source:
        while len(self._sources) >= _MOST_SOURCES:
            oldest = self._sources.pop(next(iter(self._sources)))
            self.selector.unregister(oldest.far)
            oldest.far.close()
        far = _udp_socket()
        far.connect(self.target)
        there, back = self.ways
        source = self._sources[address] = _Source(
            far,
            _Datagrams(self, there, far.send),
            _Datagrams(self, back, lambda data: self._near.sendto(data, address)),
        )
        self.selector.register(far, selectors.EVENT_READ, lambda: self._from_server(source))
        return source


class Connection:
    """One TCP connection through the relay.

    Attributes:
        sent: the first bytes that were passed on to the server, at most 64 KiB.
        sent_bytes: how many were passed on.
        closed: whether it has ended.
    """

    def __init__(self, relay: Relay, near: socket.socket, kind: Stream) -> None:
        self.sent = bytearray()
        self.sent_bytes = 0
        self.closed = False
        self.near = near
        self.far: socket.socket | None = None
        self.kind = kind
        self.relay = relay
        self.damages = False
        self._stalled = False
        self.there, self.back = (_Pipe(self, way) for way in relay.ways)

    @property
    def held(self) -> bool:
        """Whether nothing passes at the moment."""
        return self._stalled or self.kind in self.relay.held

    def stall(self, stalled: bool = True) -> None:
        """Hold both directions, or go on."""
        self._stalled = stalled

    def damage(self, damages: bool = True) -> None:
        """Change the last byte of each piece from now on."""
        self.damages = damages

    # --- on the relay's thread

    def connect(self) -> None:
        """Connect to the target; the client has been connected before."""
        try:
            self.far = socket.create_connection(self.relay.target)
        except OSError:
            self.abort()
            return
        for sock in (self.near, self.far):
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.there.open(self.near, self.far)
        self.back.open(self.far, self.near)

    def read_again(self) -> None:
        """Read from both ends, where there is room again."""
        for pipe in (self.there, self.back):
            pipe.read_again()

    def abort(self) -> None:
        """End it, with everything that waits."""
        if self.closed:
            return
        self.closed = True
        for pipe in (self.there, self.back):
            pipe.close()
        for sock in (self.near, self.far):
            if sock is not None:
                sock.close()

    def record(self, data: bytes) -> None:
        """Note bytes that were passed on to the server."""
        self.sent_bytes += len(data)
        self.sent += data[: _RECORDED - len(self.sent)]


class _Pipe:
    """One direction of a connection. An empty piece is its end."""

    def __init__(self, connection: Connection, way: _Way) -> None:
        self.way = way
        self.waiting = 0
        self._connection = connection
        self._relay = connection.relay
        self._source: socket.socket | None = None
        self._sink: socket.socket | None = None
        self._reading = False
        self._ended = False

    @property
    def held(self) -> bool:
        return self._connection.held

    def open(self, source: socket.socket, sink: socket.socket) -> None:
        self._source, self._sink = source, sink
        self.read_again()

    def read_again(self) -> None:
        if self._source is not None and not self._reading and not self._ended and self._room() > 0:
            self._relay.selector.register(self._source, selectors.EVENT_READ, self._read)
            self._reading = True

    def _room(self) -> int:
        most = _CHUNK if self._relay.rate is None else _RATE_CHUNK
        return most if self._relay.room is None else min(most, self._relay.room - self.waiting)

    def _read(self) -> None:
        if self._ended or self._source is None:
            return  # it was closed in the same turn
        room = self._room()
        if room <= 0:
            self._stop_reading()
            return
        try:
            data = self._source.recv(room)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if self._connection.damages and data:
            data = data[:-1] + bytes((data[-1] ^ 1,))
        if not data:
            self._ended = True
            self._stop_reading()
        self.waiting += len(data)
        self.way.put(self, data)

    def send(self, data: bytes) -> int | None:
        assert self._sink is not None
        if not data:
            self._connection.abort()
            return None
        try:
            sent = self._sink.send(data)
        except BlockingIOError:
            return None
        except OSError:
            self._connection.abort()
            return None
        self.waiting -= sent
        if self is self._connection.there:
            self._connection.record(data[:sent])
        return sent

    def _stop_reading(self) -> None:
        if self._reading and self._source is not None:
            self._relay.selector.unregister(self._source)
        self._reading = False

    def close(self) -> None:
        self._stop_reading()
        self._ended = True
        self.waiting = 0
        self.way.forget(self)


class _Datagrams:
    """One direction of a client's datagrams, which go whole."""

    def __init__(self, relay: Relay, way: _Way, send: Callable[[bytes], int]) -> None:
        self.way = way
        self._waiting = 0
        self._relay = relay
        self._send = send

    @property
    def held(self) -> bool:
        return "datagrams" in self._relay.held

    def put(self, data: bytes) -> None:
        if self._relay.rate is None or self._waiting + len(data) <= self._relay.queue:
            self._waiting += len(data)
            self.way.put(self, data)

    def send(self, data: bytes) -> int:
        self._waiting -= len(data)
        with contextlib.suppress(OSError):
            self._send(data)
        return len(data)


class _Source(NamedTuple):
    """The datagrams of one client's socket."""

    far: socket.socket
    there: _Datagrams
    back: _Datagrams


_Sender: TypeAlias = "_Pipe | _Datagrams"


class _Way:
    """One direction, with the pieces of all connections and datagrams that wait in it."""

    def __init__(self, relay: Relay, *, fifo: bool) -> None:
        self.carried = 0
        self.budget = 0.0
        self._relay = relay
        self._fifo = fifo
        self._lines: dict[_Sender | None, deque[tuple[_Sender, float, bytes]]] = {}
        self._turns: deque[_Sender | None] = deque()

    @property
    def queued(self) -> bool:
        return bool(self._turns)

    def put(self, sender: _Sender, data: bytes) -> None:
        line = None if self._fifo else sender
        if line not in self._lines:
            self._lines[line] = deque()
            self._turns.append(line)
        waiting = self._lines[line]
        due = time.monotonic() + self._relay.delay()
        waiting.append((sender, max(due, waiting[-1][1]) if waiting else due, data))

    def forget(self, sender: _Sender) -> None:
        for line, waiting in tuple(self._lines.items()):
            kept = self._lines[line] = deque(each for each in waiting if each[0] is not sender)
            if not kept:
                del self._lines[line]
                if line in self._turns:
                    self._turns.remove(line)

    def pour(self, now: float, earned: float) -> None:
        """Pass on what the rules allow, the connections in turn; a datagram may exceed the budget."""
        self.budget = min(self.budget, 1e12) + earned
        blocked = 0
        while self.budget >= 1 and self._turns and blocked < len(self._turns):
            line = self._turns[0]
            self._turns.rotate(-1)
            sender, due, data = self._lines[line][0]
            sent = None if due > now or sender.held else self._pass(sender, data)
            waiting = self._lines.get(line)
            if sent is None:
                blocked += 1
                continue
            blocked = 0
            self.budget -= sent
            self.carried += sent
            if waiting is None:
                continue
            if sent < len(data):
                waiting[0] = (sender, due, data[sent:])
            else:
                waiting.popleft()
            if not waiting:
                del self._lines[line]
                self._turns.remove(line)
        if not self._turns or self._relay.rate is None:
            self.budget = min(self.budget, 0.0)  # a datagram may have exceeded it

    def _pass(self, sender: _Sender, data: bytes) -> int | None:
        if isinstance(sender, _Pipe) and self._relay.rate is not None:
            return sender.send(data[:_TURN])
        return sender.send(data)


def _udp_socket() -> socket.socket:
    made = socket.socket(type=socket.SOCK_DGRAM)
    made.setblocking(False)
    with contextlib.suppress(PermissionError):  # only root may exceed the kernel's limit
        made.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _UDP_BUFFER)
    return made


def stamped(index: int, size: int) -> str:
    """Return a message of `size` characters with its index and the time when it was made."""
    head = f"{index} {time.time_ns()} "
    return head + os.urandom((size - len(head) + 1) // 2).hex()[: size - len(head)]


def read_stamp(content: str) -> tuple[int, int]:
    """Return a message's index, and when it was made (ns since the epoch)."""
    index, made = content.split(" ", 2)[:2]
    return int(index), int(made)

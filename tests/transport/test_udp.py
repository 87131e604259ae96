"""UDP sockets."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from typing import Any, cast

import pytest
from tests.support import replaced
from tests.support.acceptors import Accepting
from tests.support.coroutines import until
from tests.support.held import held_by

from rsb_bridge.transport.transport import RECEIVE_BUFFER
from rsb_bridge.transport.udp import Udp, UdpSocket, can_segment, coalesce, end_of_run, split_run

HOSTS = pytest.mark.parametrize("host", ["127.0.0.1", "::1"])


def has_segments() -> bool:
    with socket.socket(type=socket.SOCK_DGRAM) as probe:
        return can_segment(probe) and coalesce(probe)


async def test_the_kernel_says_when_a_datagram_came() -> None:
    """A process that comes late to read knows it: only the path's time counts for its rate."""
    async with pair("127.0.0.1") as (server, client, came, _):
        loop = asyncio.get_running_loop()
        waited = [1.0]
        while abs(waited[-1]) > 0.1:  # the kernel begins to stamp late, or this process stood still between two clocks
            assert len(waited) < 50, waited
            came.clear()
            client.send([b"x"], None)
            sent_at = loop.time()
            time.sleep(0.2)  # noqa: ASYNC251 - a busy process
            await until(lambda: came)
            waited.append(server.arrived_at() - sent_at)


def address_of(host: str, port: int) -> Any:
    return (host, port, 0, 0) if ":" in host else (host, port)


@asynccontextmanager
async def server_on(host: str) -> AsyncIterator[tuple[UdpSocket, list[bytes]]]:
    came: list[bytes] = []
    acceptor = Accepting(datagrams=lambda _, datagrams: came.extend(bytes(each) for each, _ in datagrams))
    bound = await Udp().listen(host, 0, acceptor)
    try:
        yield bound.sockets[0], came
    finally:
        bound.close()


@asynccontextmanager
async def pair(host: str) -> AsyncIterator[tuple[UdpSocket, UdpSocket, list[bytes], list[bytes]]]:
    """Return a bound socket, one that is connected to it, and the datagrams of the bound one and of the other."""
    back: list[bytes] = []
    async with server_on(host) as (server, came):
        client = Udp().connect(
            address_of(host, server.port), lambda _, datagrams: back.extend(bytes(each) for each, _ in datagrams)
        )
        try:
            yield server, client, came, back
        finally:
            client.close()


class Watched:
    """A socket whose calls are counted, and fail as told."""

    def __init__(self, sock: Any) -> None:
        self._sock = sock
        self.failures: list[OSError | None] = []
        self.refuses = False
        self.sent: list[int] = []
        self.reads = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sock, name)

    def send(self, data: bytes) -> int:
        self._check(1)
        return int(self._sock.send(data))

    def sendmsg(self, buffers: list[bytes], *further: Any) -> int:
        self._check(len(buffers))
        return int(self._sock.sendmsg(buffers, *further))

    def recvmsg(self, *sizes: int) -> tuple[bytes, list[Any], int, Any]:
        self.reads += 1
        return self._sock.recvmsg(*sizes)  # type: ignore[no-any-return]

    def _check(self, count: int) -> None:
        if self.refuses:
            raise BlockingIOError
        if self.failures and (error := self.failures.pop(0)) is not None:
            raise error
        self.sent.append(count)


@asynccontextmanager
async def watched(host: str = "127.0.0.1") -> AsyncIterator[tuple[Any, UdpSocket, list[bytes]]]:
    """Return a watched socket connected to a server, the transport's socket on it, and the received datagrams."""
    async with server_on(host) as (server, came):
        calls: Any = Watched(socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM))
        calls.connect(address_of(host, server.port))
        client = UdpSocket(calls, lambda *_: None)
        try:
            yield calls, client, came
        finally:
            if calls.fileno() >= 0:  # the test has not closed it
                client.close()


class Skipping(asyncio.SelectorEventLoop):
    """A loop whose time the test moves on, or holds.

    Attributes:
        skipped: s that the time is ahead.
        held_at: the time, or None if it goes on.
        readers: functions that the test calls in place of the loop while the time is held.
    """

    skipped = 0.0
    held_at: float | None = None

    def __init__(self) -> None:
        self.readers: list[Callable[[], object]] = []
        super().__init__()

    def time(self) -> float:
        return super().time() + self.skipped if self.held_at is None else self.held_at

    def add_reader(self, fd: Any, callback: Any, *args: Any) -> None:  # type: ignore[override]  # asyncio's ties them
        if self.held_at is None:
            super().add_reader(fd, callback, *args)
        else:
            self.readers.append(callback)


@pytest.fixture
def loop() -> Iterator[Skipping]:
    with asyncio.Runner(loop_factory=Skipping) as runner:
        yield cast("Skipping", runner.get_loop())


async def test_roaming_peer_does_not_grow_sizes() -> None:
    async with server_on("127.0.0.1") as (sock, _):
        for number in range(1000):
            assert sock.datagram_size((f"127.0.{number // 250}.{number % 250 + 1}", 1000)) > 1000
        assert held_by(sock) <= 256


@HOSTS
@pytest.mark.parametrize("with_segments", [True, False])
async def test_datagrams_arrive_as_they_were_sent(
    host: str, with_segments: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Datagrams of one size and of several, both ways, with the kernel's help and without."""
    if not with_segments:
        replaced.CAN_SEGMENT.set(monkeypatch, lambda _: False)
        replaced.COALESCE.set(monkeypatch, lambda _: False)
    sizes = [1200] * 150 + [700] + [1200] * 3 + [1, 2, 0, 5] + [60_000, 60_000, 9000]
    datagrams = [bytes([index % 251]) * size for index, size in enumerate(sizes)]
    async with pair(host) as (server, client, came, back):
        client.send(datagrams, None)
        await until(lambda: len(came) >= len(datagrams))
        assert came == datagrams
        server.send(datagrams, server.path(host, address_of(host, client.port)))
        await until(lambda: len(back) >= len(datagrams))
        assert back == datagrams


@pytest.mark.skipif(not has_segments(), reason="the kernel has no UDP segmentation")
@HOSTS
async def test_datagrams_of_one_size_go_in_one_call(host: str) -> None:
    async with watched(host) as (calls, client, came):
        client.send([bytes(1000)] * 64 + [bytes(400), bytes(1000)], None)
        await until(lambda: len(came) == 66)
        assert calls.sent == [64, 1, 1]
        assert client.receive_buffer > 0


@pytest.mark.parametrize(("pause", "reads"), [(1.0, [1, 2, 3]), (0.00005, [1, 5])])
async def test_wake_up_reads_once_unless_repeated(pause: float, reads: list[int], loop: Skipping) -> None:
    """A read that finds nothing costs as much as half a message; in a flood, one of many."""
    sock: Any = Watched(socket.socket(type=socket.SOCK_DGRAM))
    sock.bind(("127.0.0.1", 0))
    loop.held_at = 1000.0
    came: list[bytes] = []
    server = UdpSocket(sock, lambda _, datagrams: came.extend(bytes(each) for each, _ in datagrams))
    with contextlib.closing(server), socket.socket(type=socket.SOCK_DGRAM) as client:
        for number in range(4):
            client.sendto(bytes([number]), ("127.0.0.1", server.port))
        done = []
        for _ in reads:
            loop.readers[0]()
            done.append(sock.reads)
            loop.held_at += pause
        assert done == reads
        assert len(came) == min(4, reads[-1])


async def test_nothing_waits_in_a_socket_that_is_closed() -> None:
    async with watched() as (calls, client, _):
        calls.refuses = True
        client.send([b"waits"], None)
        assert client.congested
        client.close()
        calls.refuses = False
        client.send([b"late"], None)
        assert not client.congested
        assert client.waiting_bytes == 0


@pytest.mark.skipif(not has_segments(), reason="the kernel has no UDP segmentation")
@pytest.mark.parametrize("number", [errno.EIO, errno.EINVAL, errno.EMSGSIZE])
async def test_uncut_datagrams_go_singly_for_a_while(number: int, loop: Skipping) -> None:
    """An interface may not be able to, or the path has just become narrower; nothing is lost by it."""
    async with watched() as (calls, client, came):
        calls.failures = [OSError(number, "")]
        for _ in range(2):  # at once: a wait between them might outlast it
            client.send([bytes(1000)] * 10, None)
        await until(lambda: len(came) == 20)
        assert calls.sent == [1] * 20
        loop.skipped += 1.0
        client.send([bytes(1000)] * 10, None)
        await until(lambda: len(came) == 30)
        assert calls.sent[20:] == [10]


async def test_failing_datagram_is_lost_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    replaced.CAN_SEGMENT.set(monkeypatch, lambda _: False)
    async with watched() as (calls, client, came):
        calls.failures = [None, OSError(errno.EMSGSIZE, "")]
        client.send([b"a", b"b", b"c"], None)
        await until(lambda: len(came) == 2)
        assert came == [b"a", b"c"]


async def test_refused_datagrams_wait_in_bounded_order() -> None:
    async with watched() as (calls, client, came):
        written = asyncio.Event()
        client.when_writable.add(written.set)
        calls.refuses = True
        for number in range(40):
            client.send([bytes([number]) * 1000] * 1000, None)
        assert client.congested
        assert 16 << 20 <= client.waiting_bytes <= (16 << 20) + 1_000_000
        calls.refuses = False
        await written.wait()
        assert not client.congested
        assert client.waiting_bytes == 0
        await until(lambda: came)
        assert came == sorted(came)


class _Counted(bytes):
    """A datagram that counts how often its length is asked for."""

    asked = 0

    def __len__(self) -> int:
        _Counted.asked += 1
        return super().__len__()


async def test_waiting_datagrams_are_not_counted_each_time() -> None:
    """One link's datagrams wait for the kernel, and all links send on the same socket meanwhile."""
    async with watched() as (calls, client, _):
        calls.refuses = True
        client.send([_Counted(1400) for _ in range(5000)], None)
        _Counted.asked = 0
        for _ in range(1000):
            client.send([_Counted(1400)], None)
        assert _Counted.asked <= 10 * 1000


async def test_limit_that_was_raised_is_used_without_restart() -> None:
    async with watched() as (calls, client, _):
        calls.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 50_000)
        with socket.socket(type=socket.SOCK_DGRAM) as other:
            other.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            allowed = other.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
        assert allowed <= client.receive_buffer <= RECEIVE_BUFFER


@pytest.mark.parametrize(
    ("sizes", "ends"),
    [
        ([5], [1]),
        ([5, 5, 5], [3]),
        ([5, 5, 3, 5], [3, 4]),
        ([3, 5], [1, 2]),
        ([5, 0, 5], [1, 2, 3]),
        ([0, 0], [1, 2]),
        ([1000] * 70, [64, 70]),
        ([30_000] * 3, [2, 3]),
        ([65_507, 65_507], [1, 2]),
    ],
)
def test_runs_are_what_the_kernel_can_cut(sizes: list[int], ends: list[int]) -> None:
    datagrams, found, begin = [bytes(size) for size in sizes], [], 0
    while begin < len(datagrams):
        begin = end_of_run(datagrams, begin)
        found.append(begin)
    assert found == ends


def test_merged_datagrams_are_split_as_told() -> None:
    def control(size: int) -> list[tuple[int, int, bytes]]:
        return [(0, 8, b"other"), (socket.SOL_UDP, 104, size.to_bytes(4, "little"))]

    assert [bytes(each) for each in split_run(b"aabbc", control(2))] == [b"aa", b"bb", b"c"]
    assert split_run(b"aabbc", control(5)) == [b"aabbc"]
    assert split_run(b"aabbc", control(0)) == [b"aabbc"]
    assert split_run(b"", []) == [b""]

"""TCP's connecting, over real sockets on loopback addresses."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import os
import socket
import struct
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from aiohappyeyeballs import start_connection
from tests.support import constants, replaced
from tests.support.acceptors import Accepting
from tests.support.inside import socket_of
from tests.support.ports import free_port
from tests.support.wording import pattern, says

from rsb_bridge.transport import tcp
from rsb_bridge.transport.listening import ListenProblem, LookUpProblem, bind
from rsb_bridge.transport.streams import Stream, StreamHandler, StreamProblem, os_error_message
from rsb_bridge.transport.tcp import Tcp, TcpStream, congestion_control, prefer_bbr
from rsb_bridge.transport.transport import ListenError

if TYPE_CHECKING:
    from rsb_bridge.model.reason import Reason

_LIVE, _ALSO_LIVE, _SILENT, _REFUSING = (f"127.0.2.{n}" for n in range(1, 5))
_UNREACHABLE = "255.255.255.255"  # connect(2) refuses a broadcast address at once


@pytest.fixture
def port() -> Iterator[int]:
    """A port that two addresses answer on, and that one is silent on: its backlog is full, so SYNs are dropped."""
    with socket.socket() as live, socket.socket() as also_live, socket.socket() as silent:
        live.bind((_LIVE, 0))
        live.listen()
        number: int = live.getsockname()[1]
        also_live.bind((_ALSO_LIVE, number))
        also_live.listen()
        silent.bind((_SILENT, number))
        silent.listen(0)
        with _filled((_SILENT, number)):
            yield number


@contextmanager
def _filled(address: tuple[str, int]) -> Iterator[None]:
    waiting = [socket.socket() for _ in range(4)]
    try:
        for sock in waiting:
            sock.setblocking(False)
            sock.connect_ex(address)
        yield
    finally:
        for sock in waiting:
            sock.close()


@pytest.fixture
def resolves(monkeypatch: pytest.MonkeyPatch, port: int) -> list[str]:
    """The addresses that every name has."""
    addresses: list[str] = []

    async def look_up(host: str, number: int, within: float) -> list[tuple[object, ...]]:
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, number)) for address in addresses]

    replaced.TCP_LOOK_UP.set(monkeypatch, look_up)
    return addresses


def _open_sockets() -> set[str]:
    gc.collect(1)  # what the test has made; all that the worker has ever made takes half a second
    links = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # the folder's own
            links.add(str(descriptor.readlink()))
    return {link for link in links if link.startswith("socket:")}


async def test_silent_address_does_not_delay_next(
    monkeypatch: pytest.MonkeyPatch, port: int, resolves: list[str]
) -> None:
    """A name may have an IPv6 address whose packets are dropped on the way."""
    constants.TCP_CONNECT_TIMEOUT.set(monkeypatch, 120.0)
    resolves += [_SILENT, _LIVE]
    async with asyncio.timeout(180):
        stream = await Tcp().connect("robot", port, StreamHandler())
    assert stream.host == _LIVE
    stream.abort("over")


def test_all_that_are_silent_time_out(monkeypatch: pytest.MonkeyPatch, port: int, resolves: list[str]) -> None:
    constants.TCP_CONNECT_TIMEOUT.set(monkeypatch, 0.5)
    resolves += [_SILENT, _SILENT]
    before = _open_sockets()

    async def main() -> None:
        with pytest.raises(TimeoutError) as failure:
            await Tcp().connect("robot", port, StreamHandler())
        assert os_error_message(failure.value) == StreamProblem.TIMED_OUT()

    asyncio.run(main())
    assert _open_sockets() <= before


@pytest.mark.parametrize("addresses", [[_UNREACHABLE, _REFUSING], [_REFUSING, _UNREACHABLE], [_REFUSING, _REFUSING]])
async def test_where_some_cannot_be_reached_refusal_is_told(
    addresses: list[str], port: int, resolves: list[str]
) -> None:
    """On a network without IPv6 that address fails too, which is not what the operator has to know."""
    resolves += addresses
    with pytest.raises(OSError, match=r".+") as failure:
        await Tcp().connect("robot", port, StreamHandler())
    assert failure.value.errno == errno.ECONNREFUSED
    assert says(os_error_message(failure.value), StreamProblem.REFUSED)


async def test_connection_to_itself_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody listens, and the kernel gives the connection the port that it leads to."""
    number = free_port()
    own = [(socket.AF_INET, socket.SOCK_STREAM, 0, "", ("127.0.0.1", number))]

    def reusing(_: object) -> socket.socket:
        made = socket.socket()
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        return made

    connect = partial(start_connection, local_addr_infos=own, socket_factory=reusing)
    replaced.START_CONNECTION.set(monkeypatch, connect)
    with pytest.raises(ConnectionRefusedError):
        await Tcp().connect("127.0.0.1", number, StreamHandler())
    (server,) = await bind("127.0.0.1", number, socket.SOCK_STREAM)
    server.close()


async def test_connection_that_is_reset_at_once_leaves_no_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        async def connect(*given: Any, **named: Any) -> socket.socket:
            made.append(await start_connection(*given, **named))
            there, _ = server.accept()
            there.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            there.close()
            return made[0]

        replaced.START_CONNECTION.set(monkeypatch, connect)
        with pytest.raises(OSError, match=r".+"):
            await Tcp().connect("127.0.0.1", server.getsockname()[1], StreamHandler())
    assert made[0].fileno() == -1


def test_connection_that_comes_as_the_loop_ends_leaves_no_socket() -> None:
    """It is accepted in the loop's last turn. A socket that the collector closes warns."""
    number = free_port()

    async def listen() -> None:
        loop, listener = asyncio.get_running_loop(), await Tcp().listen("127.0.0.1", number, Accepting())
        client.connect(("127.0.0.1", number))
        loop.call_soon(loop.call_soon, listener.close)  # after that turn

    with socket.socket() as client, asyncio.Runner() as runner:
        runner.run(listen())
    gc.collect()


@pytest.mark.parametrize("turns", range(6))
async def test_connection_that_is_accepted_as_the_listener_closes_is_closed(turns: int) -> None:
    """Its server has ended the streams that it knows by then, and would hear of this one afterwards."""
    number, known = free_port(), list[Stream]()

    class Known(StreamHandler):
        def connected(self, stream: Stream) -> None:
            known.append(stream)

    listener = await Tcp().listen("127.0.0.1", number, Accepting(Known))
    with socket.create_connection(("127.0.0.1", number)) as client:
        for _ in range(turns):
            await asyncio.sleep(0)
        listener.close()
        for each in known:
            each.abort("the server stops")
        client.settimeout(20.0)
        with contextlib.suppress(ConnectionError):
            assert await asyncio.to_thread(client.recv, 1) == b""


async def test_two_that_bind_at_once_cannot_both_listen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel lets both bind the port, and refuses the second one that listens."""
    number = free_port()
    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        other.bind(("127.0.0.1", number))
        bound: list[socket.socket] = []

        async def bind_second(host: str, port: int, kind: socket.SocketKind, make: Any) -> list[socket.socket]:
            bound.extend(await bind(host, port, kind, make))
            other.listen()
            return bound

        replaced.TCP_BIND.set(monkeypatch, bind_second)
        with pytest.raises(ListenError, match=pattern(ListenProblem.TAKEN, address=f"127.0.0.1:{number}")):
            await Tcp().listen("127.0.0.1", number, Accepting())
    assert [each.fileno() for each in bound] == [-1], "closed"


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
async def test_every_address_has_ipv4(kind: socket.SocketKind) -> None:
    number = free_port()
    bound = await bind("::", number, kind)
    for listener in bound:
        if kind is socket.SOCK_STREAM:
            listener.listen()
    for family, host in ((socket.AF_INET, "127.0.0.1"), (socket.AF_INET6, "::1")):
        with socket.socket(family, kind) as client:
            client.connect((host, number))
            client.sendall(b"x")
            if kind is socket.SOCK_DGRAM:
                received = next(each for each in bound if each.family == family).recv(1)
                assert received == b"x"
    for listener in bound:
        listener.close()


@pytest.mark.parametrize("number", [errno.ENETUNREACH, errno.EHOSTUNREACH])
def test_unreachable_network_has_a_remedy(number: int) -> None:
    error = os.strerror(number)
    assert os_error_message(OSError(number, error)) == StreamProblem.UNREACHABLE(error=error)


async def test_a_name_without_an_address(port: int, resolves: list[str]) -> None:
    with pytest.raises(OSError, match=pattern(LookUpProblem.NO_ADDRESS, host="robot")):
        await Tcp().connect("robot", port, StreamHandler())


def test_silent_name_server_delays_neither_server_nor_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """The end waits for the threads of the loop's own pool."""
    answers = threading.Event()

    def silent(host: str, *_: object, flags: int = 0, **__: object) -> None:
        if not flags & socket.AI_NUMERICHOST:
            answers.wait(20)
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    replaced.NAME_SERVER.set(monkeypatch, silent)
    constants.LISTEN_LOOKED_UP_WITHIN.set(monkeypatch, 0.1)
    try:
        with pytest.raises(ListenError, match=pattern(LookUpProblem.NO_NAME_SERVER)):
            asyncio.run(bind("pc", 0, socket.SOCK_STREAM))
    finally:
        answers.set()


@pytest.mark.parametrize("addresses", [[_LIVE], [_LIVE, _ALSO_LIVE], [_SILENT, _LIVE]], ids=["one", "two", "silent"])
def test_cancelled_at_whatever_moment_it_leaves_no_socket(
    addresses: list[str], monkeypatch: pytest.MonkeyPatch, port: int, resolves: list[str]
) -> None:
    constants.TCP_NEXT_ADDRESS_AFTER.set(monkeypatch, 1e-6)
    resolves += addresses
    before = _open_sockets()

    class Handler(StreamHandler):
        stream: Stream | None = None

        def connected(self, stream: Stream) -> None:
            self.stream = stream

    async def cancel_after(steps: int) -> bool:
        """Cancel a connect after so many turns of the loop; whether it was too late."""
        handler = Handler()
        connecting = asyncio.ensure_future(Tcp().connect("robot", port, handler))
        for _ in range(steps):
            await asyncio.sleep(0)
        connecting.cancel()
        (outcome,) = await asyncio.gather(connecting, return_exceptions=True)
        if handler.stream is not None:
            handler.stream.abort("over")
        await asyncio.sleep(0)
        return isinstance(outcome, Stream)

    async def main() -> None:
        steps = 0
        while not await cancel_after(steps) and steps < 100:
            steps += 1
        await asyncio.sleep(0)

    asyncio.run(main())
    assert _open_sockets() <= before


class Kept(StreamHandler):
    """Keeps the received bytes, and the time of the end."""

    def __init__(self) -> None:
        self.came = bytearray()
        self.over = asyncio.Event()

    def received(self, data: bytes) -> None:
        self.came += data

    def closed(self, reason: Reason) -> None:
        self.over.set()


@asynccontextmanager
async def _connected() -> AsyncIterator[tuple[Stream, Kept, Stream, Kept]]:
    """Return two ends of a connection, each with its received bytes."""
    near_kept, far_kept = Kept(), Kept()
    listening = socket.create_server((_LIVE, 0))
    near_socket = socket.create_connection(listening.getsockname())
    far_socket, _ = listening.accept()
    listening.close()
    loop = asyncio.get_running_loop()
    _, near = await loop.create_connection(lambda: TcpStream(near_kept, set()), sock=near_socket)
    _, far = await loop.create_connection(lambda: TcpStream(far_kept, set()), sock=far_socket)
    try:
        async with asyncio.timeout(180):
            yield near, near_kept, far, far_kept
    finally:
        near.abort("over")
        far.abort("over")
        await asyncio.sleep(0)


async def test_slow_path_is_no_reason_to_send_again() -> None:
    """The kernel's longest wait for an acknowledgement is above the round trip, and short where that is short."""
    async with _connected() as (near, _, _, _):
        sock = socket_of(near)
        waits: list[float] = []
        for round_trip in (0.03, 1.7, 90.0, 0.03):
            near.round_trip_is(round_trip)
            try:
                waits.append(sock.getsockopt(socket.IPPROTO_TCP, tcp.TCP_RTO_MAX_MS) / 1000)
            except OSError:
                pytest.skip("Linux has this option since 6.15")
        assert waits[1] > 3 * 1.7
        assert waits[2] < 10.0
        assert waits[3] == tcp.RETRIED_AFTER


@pytest.mark.parametrize("size", [4, 10_000_000], ids=["sent", "waiting"])
async def test_last_words_arrive_though_the_peer_was_sending(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each side had not read what the other had sent. A reset would have made the peer's next write fail."""
    constants.STREAM_LINGER.set(monkeypatch, 120.0)
    async with _connected() as (near, near_kept, far, far_kept):
        near.pause_reading()
        far.pause_reading()
        far.write(b"unread")
        near.write(bytes(size - 4) + b"last")
        near.close()
        near.write(b"after the last")
        assert near.over
        for _ in range(10):
            far.write(b"more")
            await asyncio.sleep(0.01)
        far.resume_reading()
        await far_kept.over.wait()
        assert (len(far_kept.came), bytes(far_kept.came[-4:])) == (size, b"last")
        await near_kept.over.wait()
        assert near.gone
        assert not near_kept.came


@pytest.mark.parametrize("sends", [True, False])
async def test_peer_that_never_closes_is_not_waited_for(monkeypatch: pytest.MonkeyPatch, sends: bool) -> None:
    """One that floods is cut off at a number of bytes, before any time is up."""
    constants.STREAM_LINGER.set(monkeypatch, 120.0 if sends else 0.1)
    async with _connected() as (near, near_kept, far, _):
        far.pause_reading()
        if sends:
            far.write(bytes(20_000_000))
        near.close()
        await near_kept.over.wait()
        assert near.gone
        assert not far.gone


@pytest.mark.parametrize("kind", [Stream, TcpStream])
@pytest.mark.parametrize("end", ["abort", "close", "write"])
async def test_stream_may_end_as_writing_resumes(kind: type[Stream], end: str) -> None:
    """Its last bytes have just left: asyncio must not end it twice."""
    loop, errors = asyncio.get_running_loop(), list[str]()
    loop.set_exception_handler(lambda _, context: errors.append(str(context)))
    over = asyncio.Event()

    class Ends(StreamHandler):
        def writable(self) -> None:
            if end == "write":
                here.shutdown(socket.SHUT_WR)
                stream.write(b"in vain")
            else:
                getattr(stream, end)("the reason")

        def closed(self, reason: Reason) -> None:
            assert end == "write" or reason.text == "the reason"
            over.set()

    with socket.create_server((_LIVE, 0)) as server:
        here = socket.create_connection(server.getsockname())
        there, _ = server.accept()
    there.settimeout(60)
    here.setblocking(False)
    make = partial(kind, Ends(), set()) if kind is TcpStream else partial(kind, Ends())
    _, stream = await loop.create_connection(make, sock=here)
    stream.write(bytes(10_000_000))
    assert stream.congested

    def read_all() -> None:
        with there:
            while there.recv(1 << 20):
                pass

    with contextlib.suppress(ConnectionResetError):
        await asyncio.to_thread(read_all)
    async with asyncio.timeout(180):
        await over.wait()
    await asyncio.sleep(0)
    assert not errors


async def test_a_connection_that_the_peer_has_reset_closes() -> None:
    async with _connected() as (near, near_kept, far, far_kept):
        near.write(b"unread")
        near.pause_reading()
        far.pause_reading()
        far.abort("gone")
        await far_kept.over.wait()
        near.close()
        await near_kept.over.wait()


@pytest.mark.parametrize("number", [errno.EPIPE, errno.ECONNRESET, errno.ECONNABORTED])
def test_a_connection_that_breaks_is_explained(number: int) -> None:
    assert says(os_error_message(OSError(number, os.strerror(number))), StreamProblem.RESET)


async def test_a_connection_uses_the_preferred_congestion_control(
    monkeypatch: pytest.MonkeyPatch, port: int, resolves: list[str]
) -> None:
    """Reno is in every kernel, and on no machine the default."""
    constants.TCP_PREFERRED_CONGESTION_CONTROL.set(monkeypatch, "reno")
    resolves.append(_LIVE)
    stream = await Tcp().connect("robot", port, StreamHandler())
    assert congestion_control(socket_of(stream)) == "reno"
    stream.abort("over")


def test_congestion_control_that_machine_lacks_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as sock:
        sock.setsockopt(socket.IPPROTO_TCP, 13, b"reno")
        constants.TCP_PREFERRED_CONGESTION_CONTROL.set(monkeypatch, "unheard_of")
        prefer_bbr(sock)
        assert congestion_control(sock) == "reno"

"""UDP channels of both ends over real sockets, on a clock of the test's own."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from typing import TYPE_CHECKING

import pytest
from tests.channel.sides import Route
from tests.support.acceptors import Accepting
from tests.support.connection_keys import connection_keys
from tests.support.coroutines import until
from tests.support.held import held_by
from tests.support.schedulers import LoneConnection

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.datagram_channel import DatagramSender
from rsb_bridge.channel.reliable_datagrams import datagram_channel
from rsb_bridge.channel.udp_channel import (
    ClientUdpChannel,
    PathProbe,
    ServerUdpChannel,
    Silence,
    UdpChannel,
    UdpDemultiplexer,
)
from rsb_bridge.model.fates import ARM_REQUIRED, RELIABLE
from rsb_bridge.transport.udp import Udp
from rsb_bridge.wire.datagram import DatagramWriter, Probe, Urgent
from rsb_bridge.wire.framing import LEASED, Budget
from rsb_bridge.wire.sealing import PROBE_ROUTE, CipherSuite, Role

if TYPE_CHECKING:
    from rsb_bridge.transport.streams import Address
    from rsb_bridge.transport.transport import DatagramSocket

_HOST = "127.0.0.1"


class Lossy(ClientUdpChannel):
    """A client's end that may lose datagrams.

    Attributes:
        passing: gives those of the datagrams sent at once that get through.
    """

    def __init__(self, owner: LoneConnection, server: Address) -> None:
        self.passing: Callable[[Sequence[bytes]], Sequence[bytes]] = tuple
        super().__init__(owner, Udp(), server)

    def send(self, datagrams: Sequence[bytes]) -> None:
        super().send(self.passing(datagrams))


class Server:
    """A bound socket, and the UDP channels of the connections that the server knows.

    Attributes:
        time: s, on the clock of both ends.
        ready: link ids, each as often as its server's end became ready.
        channels: the server's ends by link id, the newest.
        made: how many they were.
        clients: the clients' ends, in the order of their calls.
        near: their connections.
        probes: what seals and opens each one's probes.
    """

    def __init__(self) -> None:
        self.port = 0
        self.time = 0.0
        self.ready: list[bytes] = []
        self.channels: dict[bytes, ServerUdpChannel] = {}
        self.made = 0
        self.clients: list[Lossy] = []
        self.probes: list[PathProbe] = []
        self.keys: dict[bytes, DataKeys] = {}
        self.near: list[LoneConnection] = []
        self._far: dict[bytes, LoneConnection] = {}
        self.demultiplexer = UdpDemultiplexer(self)

    def now(self) -> float:
        return self.time

    def new_udp_channel(self, link_id: bytes, socket: DatagramSocket, address: Address) -> ServerUdpChannel | None:
        far = self._far.get(link_id)
        if far is None:
            return None
        self.made += 1
        self.channels[link_id] = ServerUdpChannel(far, socket, _HOST)
        return self.channels[link_id]

    def connect(self, link_id: bytes) -> tuple[Lossy, DataKeys]:
        self.keys[link_id] = _keys(link_id, "server")
        self._far[link_id] = _Far(self, link_id)
        keys = _keys(link_id, "client")
        return self.call(keys), keys

    def call(self, keys: DataKeys) -> Lossy:
        """A client's end with these keys; closed with the server at the latest."""
        return self.probe_with(PathProbe(keys))

    def probe_with(self, probe: PathProbe) -> Lossy:
        """A client's end on another socket of its connection."""
        self.probes.append(probe)
        self.near.append(LoneConnection(probe, self.now))
        self.clients.append(Lossy(self.near[-1], (_HOST, self.port)))
        return self.clients[-1]

    def urgent(self, link_id: bytes) -> list[bytes]:
        """The urgent messages that have come over a connection."""
        return self._far[link_id].urgent

    def sends_to(self, channel: ServerUdpChannel, port: int) -> bool:
        """Whether an end sends to a port, which it names if it has heard nothing from there for a while."""
        self.time += 6.1
        channel.tick()
        self.time -= 6.1
        return channel.trouble == Silence.NOTHING_MORE(port=port, host=_HOST)


class _Far(LoneConnection):
    """The server's end of a connection."""

    def __init__(self, server: Server, link_id: bytes) -> None:
        super().__init__(PathProbe(server.keys[link_id]), server.now)
        self._server, self._link_id = server, link_id

    def udp_ready(self) -> None:
        self._server.ready.append(self._link_id)


def _keys(link_id: bytes, role: Role) -> DataKeys:
    return DataKeys(connection_keys(CipherSuite.AESGCM, bytes(32), link_id), role, Budget(1 << 20))


@asynccontextmanager
async def serving() -> AsyncIterator[Server]:
    server = Server()
    bound = await Udp().listen(_HOST, 0, Accepting(datagrams=server.demultiplexer.received))
    server.port = bound.sockets[0].port
    try:
        yield server
    finally:
        bound.close()
        for client in server.clients:
            client.close()


async def ready(channel: ClientUdpChannel | ServerUdpChannel) -> None:
    await until(lambda: channel.ready)


def _newest_is(server: Server, link_id: bytes) -> bool:
    """Whether the server's end of a connection was the last to become ready."""
    return server.ready[-1:] == [link_id]


async def met(server: Server) -> tuple[Lossy, ServerUdpChannel]:
    """A client's end, and the server's, which has the client's address."""
    client, _ = server.connect(b"link one")
    await ready(client)
    there = server.channels[b"link one"]
    await ready(there)
    return client, there


async def one_way(server: Server, *, armed: bool = False) -> tuple[Lossy, Route, DatagramSender]:
    """Connect a client that sends on a route; return its channel, the route on the server's side, and the sender."""
    client, keys = server.connect(b"link one")
    await ready(client)
    there = server.channels[b"link one"]
    await ready(there)
    route, here = Route(1, outgoing=False), Route(1, outgoing=True)
    route.fates = here.fates = ARM_REQUIRED if armed else RELIABLE
    datagram_channel(there, route, server.keys[b"link one"])
    sender = datagram_channel(client, here, keys)
    assert isinstance(sender, DatagramSender)
    return client, route, sender


def _has(route: Route, messages: int) -> bool:
    return len(route.arrived) >= messages


def _heard_more(channel: ClientUdpChannel, before: int) -> bool:
    return channel.received_bytes > before


@contextmanager
def elsewhere() -> Iterator[socket.socket]:
    with socket.socket(type=socket.SOCK_DGRAM) as thief:
        thief.bind((_HOST, 0))
        thief.setblocking(False)
        yield thief


async def received_by(thief: socket.socket) -> bytes:
    async with asyncio.timeout(60):
        return await asyncio.get_running_loop().sock_recv(thief, 4096)


async def test_each_end_says_once_that_it_is_ready() -> None:
    async with serving() as server:
        client, _ = server.connect(b"link one")
        await until(lambda: client.ready)
        for _ in range(3):
            client.tick()
        await until(lambda: client.received_bytes >= 4 * 60)
        assert server.near[0].ready == 1
        assert server.ready == [b"link one"]


async def test_datagrams_reach_routes_of_named_connection() -> None:
    """Two connections on one socket, a route each way on both, with the same route ids."""
    async with serving() as server:
        arrived: dict[bytes, tuple[Route, Route]] = {}
        for link_id in (b"link one", b"link two"):
            client, keys = server.connect(link_id)
            await ready(client)
            up, down = Route(1, outgoing=False), Route(2, outgoing=False)
            arrived[link_id] = (up, down)
            there = server.channels[link_id]
            await ready(there)
            datagram_channel(there, up, server.keys[link_id])
            datagram_channel(client, down, keys)
            for channel, number, codec in ((client, 1, keys), (there, 2, server.keys[link_id])):
                sender = datagram_channel(channel, Route(number, outgoing=True), codec)
                assert isinstance(sender, DatagramSender)
                sender.send([(link_id * (10 * number), 0, 0), (b"x" * 100_000, 0, 0)])
        await until(lambda: all(len(route.arrived) == 2 for pair in arrived.values() for route in pair))
        for link_id, (up, down) in arrived.items():
            assert sorted(up.payloads, key=len) == [link_id * 10, b"x" * 100_000]
            assert sorted(down.payloads, key=len) == [link_id * 20, b"x" * 100_000]
        assert server.made == 2


@pytest.mark.parametrize("lost", [0, 1], ids=["the first is lost", "the second is lost"])
async def test_armed_command_is_sent_twice_taken_once(lost: int) -> None:
    """Other messages are sent once, and so is one that takes several datagrams."""
    async with serving() as server:
        client, route, sender = await one_way(server)
        sent: list[Sequence[bytes]] = []

        def lose(datagrams: Sequence[bytes]) -> Sequence[bytes]:
            sent.append(datagrams)
            is_twice = len(datagrams) == 2 and len(set(datagrams)) == 1
            return [each for number, each in enumerate(datagrams) if not is_twice or number != lost]

        client.passing = lose
        command, long, other = b"go", b"x" * 100_000, b"words"
        sender.send([(command, 0, LEASED)])
        sender.send([(other, 0, 0)])
        await until(lambda: len(route.arrived) == 2)
        sender.send([(long, 0, LEASED)])
        await until(lambda: len(route.arrived) == 3)
        assert route.payloads == [command, other, long]
        assert [len(each) for each in sent[:2]] == [2, 1]
        assert len(set(sent[0])) == 1
        assert len({each for part in sent[2:] for each in part}) == sum(map(len, sent[2:]))
        client.passing = tuple
        sender.send([(command, 0, LEASED)])
        sender.send([(other, 0, 0)])
        await until(lambda: other in route.payloads[3:])
        assert route.payloads[3:] == [command, other]


async def test_last_command_is_sent_again_and_taken_once() -> None:
    """It may be the one that stops a robot, and no further one would make up for its loss."""
    async with serving() as server:
        client, route, sender = await one_way(server, armed=True)
        sent: list[bytes] = []

        def lose(datagrams: Sequence[bytes]) -> Sequence[bytes]:
            sent.extend(datagrams)
            return datagrams if len(sent) > 4 else ()  # the first two commands, each sent twice

        client.passing = lose
        sender.send([(b"go", 0, LEASED)])
        sender.send([(b"stop", 0, LEASED)])
        await until(lambda: route.arrived)
        await until(lambda: len(sent) == 4 + 5)
        await asyncio.sleep(0.3)
        assert len(sent) == 4 + 5
        assert route.payloads == [b"stop"]
        sender.close("over")


async def test_command_is_not_sent_again_after_later_message() -> None:
    """Even after one of several datagrams, which is sent once; the robot would take the earlier one for the newest."""
    async with serving() as server:
        client, route, sender = await one_way(server, armed=True)
        client.passing = lambda _: ()
        sender.send([(b"go", 0, LEASED)])
        client.passing = tuple
        long = b"x" * 100_000
        sender.send([(long, 0, LEASED)])
        await until(lambda: route.arrived)
        await asyncio.sleep(0.25)  # two times a repetition
        assert route.payloads == [long]


@pytest.mark.parametrize("lost", [0, 1])
async def test_urgent_message_is_sent_twice_and_taken_once(lost: int) -> None:
    """One of the two is lost."""
    async with serving() as server:
        client, _ = await met(server)
        taken = server.urgent(b"link one")
        client.send_urgent(b"both come")
        client.passing = lambda datagrams: [datagrams[1 - lost]]
        client.send_urgent(b"one is lost")
        client.passing = tuple
        client.send_urgent(b"the last")
        await until(lambda: taken[-1:] == [b"the last"])
        assert taken == [b"both come", b"one is lost", b"the last"]


@pytest.mark.parametrize("closes", [False, True])
async def test_incomplete_urgent_messages_expire(closes: bool) -> None:
    """No honest peer cuts them, but one may send the first half of each."""
    async with serving() as server:
        client, _ = server.connect(b"link one")
        await ready(client)
        for _ in range(20):
            client.send(server.probes[0].write(Urgent(bytes(2000)), 1400)[:1])
        budget, there = server.keys[b"link one"].budget, server.channels[b"link one"]
        await until(lambda: budget.held > 20_000)
        if closes:
            there.close()
        else:
            server.time += 5.1
            there.tick()
        assert budget.held == 0


async def test_a_connection_that_is_over_is_forgotten() -> None:
    """A client that reconnects for months leaves nothing in the server's table, and strangers leave nothing at all."""
    async with serving() as server:
        for number in range(20):
            link_id = number.to_bytes(8, "big")
            client, _ = server.connect(link_id)
            await ready(client)
            await until(partial(_newest_is, server, link_id))
            client.close()
            server.channels[link_id].close()
        stranger = _keys(b"stranger", "client")
        server.call(stranger)
        known, _ = server.connect(b"link one")
        await until(lambda: known.ready)
        assert held_by(server.demultiplexer) < 10


async def test_only_what_is_authentic_is_sign_of_life() -> None:
    async with serving() as server:
        client, _ = server.connect(b"link one")
        await ready(client)
        channel = server.channels[b"link one"]
        heard, server.time = channel.received_at, server.time + 60.0
        channel.received(PROBE_ROUTE, [bytes(60)], (_HOST, 1))
        channel.received(1, [bytes(60)], (_HOST, 1))
        assert channel.received_at == heard
        client.tick()
        await until(lambda: channel.received_at == server.time)


async def test_closing_old_channel_twice_keeps_new_one() -> None:
    async with serving() as server:
        client, _ = server.connect(b"link one")
        await until(lambda: client.ready)
        old = server.channels[b"link one"]
        old.close()
        client.tick()
        await until(lambda: server.made == 2)
        old.close()
        before = server.channels[b"link one"].received_bytes
        client.tick()
        await until(lambda: server.channels[b"link one"].received_bytes > before)
        assert server.made == 2


async def test_the_last_route_closes_it() -> None:
    async with serving() as server:
        client, keys = server.connect(b"link one")
        routes = [datagram_channel(client, Route(number, outgoing=number == 1), keys) for number in (1, 2)]
        routes[0].close("removed")
        assert not client.over
        routes[1].close("removed")
        assert client.over
        assert not client.socket.when_writable


async def test_a_route_that_sends_takes_no_datagrams() -> None:
    async with serving() as server:
        client, keys = server.connect(b"link one")
        await until(lambda: client.ready)
        there = server.channels[b"link one"]
        outgoing = Route(1, outgoing=True)
        datagram_channel(there, outgoing, server.keys[b"link one"])
        client.send(DatagramWriter(keys.keys.route_sealer(1, "client"), b"link one", 1).write(b"hello", 0, 0, 1000))
        before = there.received_bytes
        client.tick()
        await until(lambda: there.received_bytes > before)
        assert not outgoing.arrived


async def test_silence_is_named_with_its_port() -> None:
    async with serving() as server:
        client, there = await met(server)
        for end in (client, there):
            server.time += 6.0
            end.tick()
            assert not end.trouble
            server.time += 0.1
            end.tick()
            server.time -= 6.1
        assert client.trouble == Silence.NO_ANSWER(port=server.port, host=_HOST)
        assert there.trouble == Silence.NOTHING_MORE(port=client.socket.port, host=_HOST)
        heard = client.received_bytes
        client.tick()
        await until(lambda: client.received_bytes > heard)
        client.tick()
        assert not client.trouble


async def test_full_link_that_loses_probes_is_not_silent() -> None:
    """Messages arrive, and receipts for them come back: no firewall is in the way, and both sides go on sending."""
    async with serving() as server:
        client, up, sender = await one_way(server)
        there = server.channels[b"link one"]
        for number in range(1, 4):
            server.time += 5.0
            heard = client.received_bytes
            sender.send([(b"x" * 20_000, 0, 0)] * 200)
            await until(partial(_has, up, 200 * number))
            await until(partial(_heard_more, client, heard))
            for end in (client, there):
                UdpChannel.tick(end)  # a client's own would probe
                assert not end.trouble
        before = there.sent_bytes
        there.send([b"on"])
        assert there.sent_bytes > before


async def test_address_is_used_only_once_it_has_answered() -> None:
    """Somebody captures a probe and delivers it first, from elsewhere: the stream goes on to the client."""
    async with serving() as server:
        client, there = await met(server)
        (probe,) = server.probes[0].write(Probe(pong=False, opaque=0), 1000)
        with elsewhere() as thief:
            thief.sendto(probe, (_HOST, server.port))
            answer = await received_by(thief)
            assert len(answer) <= len(probe)
            there.send([b"to the client"])
            with pytest.raises(BlockingIOError):
                thief.recv(4096)
            assert server.sends_to(there, client.socket.port)


async def test_an_answer_that_takes_long_is_an_answer() -> None:
    """Over a satellite the client has probed again twice before its first answer arrives."""
    async with serving() as server:
        _client, there = await met(server)
        probes = server.probes[0]

        def probe(port: int, *, pong: bool = False, opaque: int = 0) -> None:
            there.received(PROBE_ROUTE, probes.write(Probe(pong, opaque), 1000), (_HOST, port))

        with elsewhere() as moved:
            port = moved.getsockname()[1]
            for _ in range(3):
                probe(port)
            asked = probes.read(await received_by(moved), server.time)
            assert isinstance(asked, Probe)
            for number in range(3):  # somebody delivers probes from elsewhere meanwhile
                probe(10 + number)
            assert not server.sends_to(there, port)
            probe(port, pong=True, opaque=asked.opaque)
            assert server.sends_to(there, port)


async def test_a_probe_that_another_one_has_overtaken_counts() -> None:
    """The probes of all sockets have one sequence, and the way to one port may be slower than that to another."""
    async with serving() as server:
        client, there = await met(server)
        first, second = (server.probes[0].write(Probe(pong=False, opaque=0), 1000) for _ in range(2))
        for (datagram,) in (second, first):
            server.time += 3.0
            there.received(PROBE_ROUTE, [datagram], (_HOST, client.socket.port))
            assert there.received_at == server.time


async def test_a_client_that_moves_is_followed() -> None:
    """Its address changes on the way (NAT): the server goes on to the new one as soon as that has answered."""
    async with serving() as server:
        client, there = await met(server)
        client.close()
        moved = server.probe_with(server.probes[0])
        await until(lambda: server.sends_to(there, moved.socket.port))
        assert server.made == 1


async def test_silent_address_gets_nothing() -> None:
    """The next owner of that address gets nothing; a probe from there opens it again."""
    async with serving() as server:
        client, there = await met(server)
        server.time += 6.1
        before = there.sent_bytes
        there.send([b"late"])
        assert there.sent_bytes == before
        client.tick()
        await until(lambda: there.received_at == server.time)
        there.send([b"again"])
        assert there.sent_bytes > before

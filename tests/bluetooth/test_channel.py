"""Topics that share a channel next to an IP link, with two whole engines. Loopback TCP replaces the radio."""

from __future__ import annotations

import asyncio
import socket
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from tests.bluetooth.guest.conftest import wait_until
from tests.bluetooth.guest.stand_in import StandIn
from tests.support.acceptors import Accepting
from tests.support.constants import STREAM_STALLED_AFTER
from tests.support.inside import inside
from tests.support.ports import free_port
from tests.support.waiting import eventually

from rsb_bridge.bluetooth.scan import held_channels
from rsb_bridge.config.keys import write_key
from rsb_bridge.engine import Engine
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.transport.registry import Transports
from rsb_bridge.transport.rfcomm import Rfcomm
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.transport.tcp import Tcp
from rsb_bridge.transport.udp import Udp
from rsb_bridge.wire.framing import CONTROL_LIMIT, DATA, HEADER, LENGTH, pack_frame
from rsb_bridge.wire.protocol_error import Broken
from rsb_bridge.wire.sealing import InvalidSeal

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from rsb_bridge.model.session import Direction
    from rsb_bridge.model.snapshot import Event, RouteSnapshot
    from rsb_bridge.transport.transport import Acceptor, Listener

_MAC = "5C:F3:70:9A:1B:2E"
_CHANNEL = 11


class _End(NamedTuple):
    """One end of a connection, and the loop it belongs to."""

    stream: Stream
    loop: asyncio.AbstractEventLoop

    def say(self, data: bytes) -> None:
        """Send what the engine would not."""
        self.loop.call_soon_threadsafe(self.stream.write, data)

    def cut(self) -> None:
        self.loop.call_soon_threadsafe(self.stream.abort, "cut")


class _Noting(StreamHandler):
    """Tells of a connection, then is out of the way."""

    def __init__(self, inner: StreamHandler, ends: list[_End]) -> None:
        self._inner = inner
        self._ends = ends

    def connected(self, stream: Stream) -> None:
        self._ends.append(_End(stream, asyncio.get_running_loop()))
        stream.handler = self._inner
        self._inner.connected(stream)


class Radio(Rfcomm):
    """RFCOMM as the engines see it, over TCP.

    Attributes:
        called: the client's ends of the connections that were made, the oldest first.
        accepted: the server's ends.
        off: whether connection attempts fail because nobody answers,
        searching: once it is no longer searched for.
    """

    def __init__(self) -> None:
        self.called: list[_End] = []
        self.accepted: list[_End] = []
        self.off = self.searching = False
        self._port = free_port()
        self._tcp = Tcp()

    async def listen(self, host: str, port: int, acceptor: Acceptor) -> Listener:
        assert (host, port) == (_MAC, _CHANNEL)
        noting = Accepting(lambda: _Noting(acceptor.make_handler(), self.accepted), shortage=acceptor.shortage)
        return await self._tcp.listen("127.0.0.1", self._port, noting)

    async def connect(self, host: str, port: int, handler: StreamHandler, rank: int | None = None) -> Stream:
        assert (host, port) == (_MAC, _CHANNEL)
        assert all(end.stream.over for end in self.called), "two adapters have one connection on a channel"
        if self.off:
            while self.searching:  # noqa: ASYNC110 — a test's thread sets it
                await asyncio.sleep(0.01)
            raise OSError("no answer")
        return await self._tcp.connect("127.0.0.1", self._port, _Noting(handler, self.called))


class Pair(NamedTuple):
    """Both engines, their domains and what is between them."""

    server: Engine
    client: Engine
    there: StandIn
    here: StandIn
    radio: Radio

    def carries(self, *topics: str) -> None:
        """Check that each carries messages of every size at once, whole and in order, in either direction."""
        sent = [bytes([number]) * size for number, size in enumerate((10, 5_000, 100_000))]
        ways = {t: (self.here, self.there) if t in self.here.offered else (self.there, self.here) for t in topics}
        wait_until(lambda: all(source.subscribed(topic) for topic, (source, _) in ways.items()), "all are open")
        for topic, (source, sink) in ways.items():
            sink.arrived[topic].clear()
            for payload in sent:
                source.publish(topic, payload)
        wait_until(lambda: all(len(sink.arrived[topic]) >= 3 for topic, (_, sink) in ways.items()), "all arrived")
        for topic, (_, sink) in ways.items():
            assert [one.payload for one in sink.arrived[topic]] == sent

    def route(self, topic: str) -> RouteSnapshot:
        """A topic as the client has it, once its snapshot does: the server's topics come by themselves."""

        def found() -> RouteSnapshot | None:
            return next((route for route in self.client.snapshot().routes if route.topic == topic), None)

        return eventually(found, what=f"{topic} is shown")

    def accepted(self, topic: str) -> bool:
        """Whether both sides have agreed about one of the client's topics."""
        (link,) = inside(self.client).role.links()
        return any(route.life.accepted for route in tuple(link.routes.values()) if route.local_topic == topic)

    def opened(self, topic: str) -> int:
        """Return how often the side that sends a topic has subscribed to it."""
        source = self.client if topic in self.here.offered else self.server
        events = (event for event in source.events() if event.code == EventCode.ROUTE_CONNECTED)
        return sum(event.topic == topic for event in events)

    @property
    def waiting(self) -> Collection[object]:
        """The client's topics that wait for the connection."""
        (link,) = inside(self.client).role.links()
        return link.channels.awaiting.get(("bluetooth", _CHANNEL), {})

    def remove(self, topic: str) -> None:
        self.client.remove_topic(self.route(topic).key).result(60)

    def settled(self, *topics: str) -> None:
        """Every message is accounted for."""
        for topic in topics:
            wait_until(lambda topic=topic: not self.route(topic).ledger.open, f"{topic} is settled")
            ledger = self.route(topic).ledger
            assert ledger.offered == ledger.delivered + sum(ledger.dropped.values())

    def faults(self) -> list[Event]:
        events = [event for engine in (self.server, self.client) for event in engine.events()]
        return [event for event in events if event.level in (Level.WARNING, Level.ERROR)]


def _data_frame(route: int) -> bytes:
    return pack_frame(HEADER.pack(DATA, 0, route, 0), bytes(20))


def on_channel(name: str, direction: Direction = "transmit", **more: Any) -> Topic:
    return Topic(name, direction, protocol="bluetooth", port=_CHANNEL, qos=10, compression="none", **more)


_TOPICS = (on_channel("/map"), on_channel("/joy"), on_channel("/cmd", "receive"), Topic("/odom", "transmit"))


@contextmanager
def paired(base: Path, *topics: Topic, **changes: Any) -> Iterator[Pair]:
    radio = Radio()
    transports = Transports(radio, Tcp(), Udp())
    write_key(base / "robot.key")
    common: dict[str, Any] = {
        "name": "robot1",
        "server_ip": "127.0.0.1",
        "server_port": free_port(),
        "key_file": "robot.key",
    }
    common |= {"bluetooth_address": _MAC, "domain_id": 1, "shutdown_topic": None} | changes
    here, there = StandIn(map=Qos(), joy=Qos(), odom=Qos(), late=Qos()), StandIn(cmd=Qos())
    server = Engine(Session(role="server", **common), base=base, ros=there, transports=transports)
    client = Engine(Session(role="client", topics=topics, **common), base=base, ros=here, transports=transports)
    server.start()
    try:
        client.start()
        yield Pair(server, client, there, here, radio)
    finally:
        client.stop()
        server.stop()


@pytest.mark.parametrize("topics", [_TOPICS, _TOPICS[::-1]], ids=["in order", "reversed"])
def test_topics_share_one_connection(topics: tuple[Topic, ...], tmp_path: Path) -> None:
    with paired(tmp_path, *topics) as pair:
        pair.carries("/map", "/joy", "/cmd", "/odom")
        pair.settled("/map", "/joy", "/odom")
        assert len(pair.radio.called) == 1
        assert not pair.faults()
        held = {(_MAC, _CHANNEL)}
        wait_until(lambda: held_channels(pair.server.session, pair.server.snapshot()) == held, "the snapshot has it")
        assert not held_channels(pair.client.session, pair.client.snapshot())


@pytest.mark.parametrize("topics", [_TOPICS, _TOPICS[::-1]], ids=["in order", "reversed"])
def test_a_channel_of_the_servers_ports_number(topics: tuple[Topic, ...], tmp_path: Path) -> None:
    """Channels and ports have numbers of their own, in any order of the connections."""
    host = "127.0.0.11"
    try:
        socket.create_server((host, _CHANNEL)).close()
    except PermissionError:
        pytest.skip(f"port {_CHANNEL} may not be bound here")
    with paired(tmp_path, *topics, server_ip=host, server_port=_CHANNEL) as pair:
        pair.carries("/map", "/joy", "/cmd", "/odom")
        assert not pair.faults()


def test_one_goes_and_others_come_while_connection_lives(tmp_path: Path) -> None:
    with paired(tmp_path, *_TOPICS) as pair:
        pair.carries("/map", "/joy", "/cmd")
        pair.remove("/map")
        pair.carries("/joy", "/cmd")
        pair.server.add_topic(on_channel("/late"), "robot1").result(60)
        pair.client.add_topic(on_channel("/map")).result(60)
        pair.carries("/map", "/joy", "/cmd", "/late")
        for topic in ("/joy", "/cmd", "/late"):
            pair.remove(topic)
        pair.carries("/map")
        assert len(pair.radio.called) == 1
        assert not pair.radio.called[0].stream.over
        pair.remove("/map")
        wait_until(lambda: pair.radio.accepted[0].stream.gone, "the last one takes it along")
        pair.client.add_topic(on_channel("/map")).result(60)
        pair.carries("/map", "/odom")
        assert len(pair.radio.called) == 2
        assert not pair.faults()


def test_topic_closed_amid_messages_disturbs_no_other(tmp_path: Path) -> None:
    with paired(tmp_path, *_TOPICS) as pair:
        pair.carries("/map", "/joy", "/cmd")
        for _ in range(10):
            pair.here.publish("/map", bytes(1_000_000))
        pair.server.remove_topic("robot1 → /map").result(60)  # its frames are still in flight
        pair.radio.called[0].say(_data_frame(1))
        pair.carries("/joy", "/cmd")
        assert len(pair.radio.called) == 1
        assert not pair.faults()


def test_topic_paused_from_start_joins_when_resumed(tmp_path: Path) -> None:
    with paired(tmp_path, on_channel("/map"), on_channel("/cmd", "receive", paused=True)) as pair:
        pair.carries("/map")
        pair.client.pause(pair.route("/cmd").key, False).result(60)
        pair.carries("/map", "/cmd")
        pair.client.pause(pair.route("/map").key, True).result(60)
        pair.carries("/cmd")
        pair.client.pause(pair.route("/map").key, False).result(60)
        pair.carries("/map", "/cmd")
        assert len(pair.radio.called) == 1
        assert not pair.faults()


@pytest.mark.parametrize("side", ["called", "accepted"])
def test_all_go_on_when_the_connection_dies(side: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    STREAM_STALLED_AFTER.set(monkeypatch, 60.0)
    with paired(tmp_path, *_TOPICS) as pair:
        pair.carries("/map", "/joy", "/cmd", "/odom")
        getattr(pair.radio, side)[0].cut()
        wait_until(lambda: len(pair.radio.called) == 2, "it is opened again")
        pair.carries("/map", "/joy", "/cmd", "/odom")
        pair.settled("/map", "/joy", "/odom")
        assert len(pair.radio.called) == 2
        assert [pair.opened(topic) for topic in ("/map", "/joy", "/cmd", "/odom")] == [1, 1, 1, 1]
        assert {fault.code for fault in pair.faults()} == {EventCode.LINK_STREAM_REOPENED}


def test_all_that_wait_hear_why_connection_failed(tmp_path: Path) -> None:
    with paired(tmp_path, Topic("/odom", "transmit")) as pair:
        pair.carries("/odom")
        pair.radio.off = pair.radio.searching = True
        for topic in _TOPICS[:3]:
            pair.client.add_topic(topic).result(60)
        wait_until(lambda: len(pair.waiting) == 3, "all wait for the same connection")
        pair.radio.searching = False
        names = [topic.topic for topic in _TOPICS[:3]]
        wait_until(lambda: all("no answer" in pair.route(name).reason for name in names), "all say so")
        assert all(pair.route(name).state is State.DOWN for name in names)
        pair.radio.off = False
        pair.carries("/odom", *names)


@pytest.mark.parametrize(
    ("side", "data", "words"),
    [
        ("called", _data_frame(9), Broken.FRAME_OF_UNKNOWN_ROUTE(kind=1, route=9)),
        ("accepted", _data_frame(9), Broken.FRAME_OF_UNKNOWN_ROUTE(kind=1, route=9)),
        ("called", _data_frame(5), Broken.FRAME_OF_UNKNOWN_ROUTE(kind=1, route=5)),
        ("called", pack_frame(bytes(HEADER.size)), Broken.FRAME_OF_UNKNOWN_ROUTE(kind=0, route=0)),
        ("called", _data_frame(1), InvalidSeal.FORGED(sequence=0)),
        ("accepted", _data_frame(1), Broken.DATA_AGAINST_ROUTE(route=1)),
        ("called", pack_frame(b"\1"), Broken.DATA_FRAME_TOO_SHORT(length=1, header=HEADER.size)),
        ("called", LENGTH.pack(CONTROL_LIMIT + 1),
         Broken.FRAME_TOO_LONG(length=CONTROL_LIMIT + 1, limit=CONTROL_LIMIT)),
    ],
)  # fmt: skip
def test_unexpected_input_ends_connection_in_words(side: str, data: bytes, words: str, tmp_path: Path) -> None:
    """Routes 1 and 3 are on it; 5 is the TCP topic's, 7 is paused and not on it yet, and 9 was never opened."""
    topics = (on_channel("/map"), on_channel("/joy"), Topic("/odom", "transmit"), on_channel("/late", paused=True))
    with paired(tmp_path, *topics) as pair:
        wait_until(lambda: pair.here.subscribed("/map", "/joy", "/odom") and pair.accepted("/late"), "all are open")
        getattr(pair.radio, side)[0].say(data)
        wait_until(lambda: any(words in fault.text for fault in pair.faults()), "the operators are warned")
        wait_until(
            lambda: all(end.stream.gone for end in pair.radio.called[:1] + pair.radio.accepted[:1]), "it is over"
        )

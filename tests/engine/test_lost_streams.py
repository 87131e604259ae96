"""Data connections that end while the link stays: real topics and calls go on, and lose nothing."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest
from std_srvs.srv import SetBool
from tests.support import replaced
from tests.support.bridge import balance, carries, happened, linked, outgoing, route, settled
from tests.support.constants import STREAM_STALLED_AFTER
from tests.support.domain import LATCHED, text
from tests.support.inside import inside
from tests.support.ports import free_port
from tests.support.steady import Steady
from tests.support.waiting import eventually

from rsb_bridge.link.client_end import ClientEnd
from rsb_bridge.link.connecting import Failure
from rsb_bridge.link.server_end import ServerEnd
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.transport.tcp import Tcp

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.link.data_channels import DataChannels
    from rsb_bridge.model.session import Direction
    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.wire.sealing import ConnectionKeys


def cut(engine: Engine, *, large: bool) -> None:
    """End one of the link's own data connections, as a firewall between does; the other side hears of it."""
    (link,) = inside(engine).role.links()

    def abort() -> None:
        pair = link.channels.pair_of("tcp", link.shared_port())
        assert pair is not None
        stream = pair.large if large else pair.small
        assert stream is not None
        stream.stream.abort("reset by a firewall")

    inside(engine).context.call(abort)


@pytest.mark.parametrize("large", [False, True])
@pytest.mark.parametrize("by_client", [False, True])
def test_topics_go_on(
    bridge: Bridge, robot: Domain, pc: Domain, large: bool, by_client: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One each way, with small and large messages by turns, while they are published at 50 Hz."""
    STREAM_STALLED_AFTER.set(monkeypatch, 60.0)
    ways: dict[str, tuple[Domain, Domain, Direction]] = {
        "/up": (robot, pc, "transmit"),
        "/down": (pc, robot, "receive"),
    }
    there = {topic: to.listener(topic) for topic, (_, to, _) in ways.items()}
    out = {topic: by.publisher(topic) for topic, (by, _, _) in ways.items()}
    topics = [Topic(topic, way, qos={"depth": 1000}) for topic, (_, _, way) in ways.items()]
    server, client = bridge.both(*topics)
    receivers, senders = {"/up": server, "/down": client}, {"/up": client, "/down": server}
    for topic, engine in receivers.items():
        carries([out[topic]], engine, [topic])
    openings = {topic: outgoing(engine, topic).route.id for topic, engine in senders.items()}

    for number in range(200):
        for each in out.values():
            each.publish(text(f"{number}" + " " * (40_000 if number % 2 else 10)))
        if number == 100:
            cut(client if by_client else server, large=large)
        time.sleep(0.02)
    for side in (server, client):
        eventually(lambda side=side: happened(side, EventCode.LINK_STREAM_REOPENED))
    for topic, engine in senders.items():
        ledger = settled(engine, topic, 200)
        assert balance(ledger) == ledger.delivered == 200
        eventually(lambda topic=topic: len(there[topic].payloads) >= 200)
        numbers = [int(payload[8:].split(b" ")[0].rstrip(b"\0")) for payload in there[topic].payloads]
        assert numbers == [*range(200)]
        assert outgoing(engine, topic).route.id == openings[topic]
    for side in (server, client):
        assert linked(side)
        assert not happened(side, EventCode.ROUTE_CHANNEL_LOST)


def test_latched_topics_and_services_go_on(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """A latched message that was lost comes on the next connection, without the others, and a service can be called."""
    pc.serve("/lamp", SetBool)
    out, there = robot.publisher("/map", qos=LATCHED), pc.listener("/map", qos=LATCHED)
    server, client = bridge.both(Topic("/map", "transmit"), Topic("/lamp", "transmit", kind="service"))
    carries([out], server, ["/map"])
    eventually(lambda: route(client, "/lamp").cause == "no_call")
    opening = outgoing(client, "/map").route.id
    cut(client, large=False)
    out.publish(text("map"))
    eventually(lambda: there.payloads)
    assert outgoing(client, "/map").route.id == opening
    eventually(lambda: route(client, "/lamp").cause == "no_call")
    assert linked(client)
    assert linked(server)


def test_link_moves_from_frozen_connections(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Something between takes what the connections carry, and keeps it, while datagrams pass."""
    out, there = robot.publisher("/scan"), pc.listener("/scan")
    server, client = bridge.both(Topic("/scan", "transmit", protocol="udp"))
    carries([out], server, ["/scan"])
    with Steady(out, 20.0, lambda number: text(str(number))):
        eventually(lambda: there.payloads)
        relay.stall()
        for side in (server, client):
            eventually(lambda side=side: happened(side, EventCode.LINK_UP, "over another connection"))
        before = len(there.payloads)
        eventually(lambda: len(there.payloads) > before)
        for side in (server, client):
            assert linked(side)
            assert not happened(side, EventCode.LINK_LOST)


def test_topics_without_streams_leave_nothing_behind(
    bridge: Bridge, robot: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A firewall may block its port for months, and it is tried again all the time."""
    port, openings = free_port(), set[int]()

    async def blocked(*_: Any, **__: Any) -> Failure:
        return Failure("blocked")

    def waiting() -> list[int]:
        (link,) = inside(server).role.links()
        return list(link.channels.awaiting.get(("tcp", port), {}))

    def tried() -> int:
        openings.update(waiting())
        client.retry().result(60)
        return len(openings)

    replaced.OPEN_DATA_STREAM.set(monkeypatch, blocked)
    robot.publisher("/scan")
    server, client = bridge.both(Topic("/scan", "transmit", port=port))
    eventually(lambda: tried() > 3, what="it is tried again")
    eventually(lambda: len(waiting()) <= 1, what="only the newest opening waits")


def find_by_announcements(monkeypatch: pytest.MonkeyPatch, bridge: Bridge) -> None:
    """Have clients look for their server over TCP as they do in a network that announces servers."""
    connect = Tcp.connect

    async def servers(transport: Tcp) -> list[str]:
        return ["127.0.0.1"]

    async def connect_to(transport: Tcp, host: str, port: int, *rest: Any) -> Stream:
        return await connect(transport, host, port or bridge.port, *rest)

    monkeypatch.setattr(Tcp, "servers", servers)
    monkeypatch.setattr(Tcp, "connect", connect_to)


@pytest.mark.parametrize("announced", [False, True])
@pytest.mark.parametrize("side", [ClientEnd, ServerEnd])
def test_connection_that_failed_internally_is_tried_again(
    bridge: Bridge, monkeypatch: pytest.MonkeyPatch, side: type[ClientEnd | ServerEnd], announced: bool
) -> None:
    made = side.new_channels
    fails = iter([MemoryError("no room")])

    def make(end: Any, control: ControlChannel, keys: ConnectionKeys) -> DataChannels:
        for error in fails:
            raise error
        return made(end, control, keys)

    monkeypatch.setattr(side, "new_channels", make)
    if announced:
        find_by_announcements(monkeypatch, bridge)
    engines = bridge.both()
    bridge.expected.update(engines)
    assert any(happened(engine, EventCode.ENGINE_ERROR, "no room") for engine in engines)
    assert not happened(engines[0], EventCode.LINK_REPLACED)  # it was closed, and not replaced by a second one

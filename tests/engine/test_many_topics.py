"""Hundreds of topics on one link: they share two streams, and nothing else waits for them while they open."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from typing import TYPE_CHECKING

import pytest
from tests.support import constants, replaced
from tests.support.bridge import happened, linked
from tests.support.inside import inside, role_of
from tests.support.rogue import Rogue
from tests.support.waiting import eventually

from rsb_bridge.config.keys import read_key
from rsb_bridge.link.pending_connections import Rejected
from rsb_bridge.link.roles import ServerRole
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Level
from rsb_bridge.transport.listening import FoundAddresses, look_up
from rsb_bridge.wire.messages import Accept, ListTopics, Ping, Pong, Propose, TopicList

if TYPE_CHECKING:
    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine
    from rsb_bridge.link.link import Link
    from rsb_bridge.wire.messages import ControlMessageBase

TOPICS = 200
STREAMS = 2
"""Of a link, besides its control connection."""


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Engines wait as long as a slow machine takes, for handshakes and for a client that sends no pings."""
    constants.DEAD_AFTER.set(monkeypatch, 60.0)
    constants.SERVER_HANDSHAKE_WITHIN.set(monkeypatch, 60.0)
    constants.CLIENT_HANDSHAKE_TIMEOUT.set(monkeypatch, 60.0)


def troubles(engine: Engine) -> list[str]:
    """Return its warnings, but not that of a busy machine."""
    found = (event for event in engine.events() if event.level in (Level.WARNING, Level.ERROR))
    return [event.text for event in found if not event.code.startswith("machine.")]


def link_of(engine: Engine) -> Link:
    (link,) = inside(engine).role.links()
    return link


def opened(engine: Engine) -> int:
    return sum(event.code is EventCode.ROUTE_CONNECTED for event in engine.events())


def test_all_topics_open_on_two_streams(bridge: Bridge) -> None:
    names = [f"/topic{number}" for number in range(TOPICS)]
    server = bridge.server()
    client = bridge.client(*(Topic(name, "transmit", type="std_msgs/msg/String", qos=1) for name in names))
    eventually(lambda: opened(client) == TOPICS, what="all topics open")
    assert troubles(server) == troubles(client) == []
    assert [route.key for route in link_of(client).routes.values() if not route.connected] == []
    assert len(link_of(client).carriers()) == 1 + STREAMS


def test_streams_go_where_the_control_connection_went(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    """The server's name is looked up once for a link, not for each stream."""
    asked: list[str] = []

    async def counted(host: str, port: int, within: float) -> FoundAddresses:
        asked.append(host)
        return await look_up(host, port, within)

    replaced.TCP_LOOK_UP.set(monkeypatch, counted)
    bridge.server()
    topics = (Topic(f"/topic{number}", "transmit", type="std_msgs/msg/String", qos=1) for number in range(3))
    client = bridge.client(*topics, server_ip="localhost")
    eventually(lambda: opened(client) == 3, what="all topics open")
    assert asked == ["localhost", *["127.0.0.1"] * STREAMS]


@pytest.mark.parametrize("address", ["127.0.0.1", "::1", "fe80::1%1"])
def test_what_is_an_address_already_needs_no_thread(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    replaced.LOOK_UP_IN_THREAD.set(monkeypatch, None)
    ((*_, found),) = asyncio.run(look_up(address, 49152, 1.0))
    assert found[:2] == (address.partition("%")[0], 49152)


def test_stranger_has_no_more_connections_because_of_client(bridge: Bridge) -> None:
    """As many as its routes wait for may come from its address, however many routes, and no more from another."""
    server = bridge.server()
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as rogue, contextlib.ExitStack() as crowd:
        rogue.say(*(propose(2 * number + 1, f"/topic{number}") for number in range(TOPICS)))
        for _ in range(TOPICS):
            rogue.wait_for(Accept)

        def come(count: int, host: str) -> None:
            for _ in range(count):
                crowd.enter_context(
                    socket.create_connection(("127.0.0.1", bridge.port), timeout=60, source_address=(host, 0))
                )

        come(STREAMS + 60, "127.0.0.1")
        come(60, "127.0.0.2")
        come(10, "127.0.0.3")
        eventually(lambda: pending(server) == STREAMS + 130)
        assert not happened(server, EventCode.LINK_REJECTED, Rejected.TOO_MANY)
        come(5, "127.0.0.2")
        crowded = eventually(lambda: happened(server, EventCode.LINK_REJECTED, Rejected.TOO_MANY))
        assert "127.0.0.2:" in crowded.text
        come(5, "127.0.0.1")
        eventually(
            lambda: (
                (event := happened(server, EventCode.LINK_REJECTED, Rejected.TOO_MANY)) and "127.0.0.1:" in event.text
            )
        )


def propose(number: int, topic: str) -> Propose:
    return Propose(route=number, topic=topic, remote_topic=topic, from_client=True, transport="tcp")


def pending(server: Engine) -> int:
    """Return the number of a server's unauthenticated connections."""
    role = role_of(server)
    assert isinstance(role, ServerRole)
    return len(role._server.pending.present)


def test_burst_of_messages_leaves_loop_to_others(bridge: Bridge) -> None:
    """A few are acted on at a time, in their order; each may make a DDS endpoint."""
    server = bridge.server()
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as rogue:
        eventually(lambda: linked(server))
        link = link_of(server)
        loop, handle = link.context.loop, link.handlers[Ping]
        together = [0]

        def counted(message: ControlMessageBase) -> None:
            together[-1] += isinstance(message, Ping)
            handle(message)

        def turn() -> None:
            together.append(0)
            loop.call_soon(turn)

        link.handlers[Ping] = counted
        link.context.call(turn)
        rogue.say(*(Ping(n=n, sent=n) for n in range(1, 1001)))
        assert [rogue.wait_for(Pong).n for _ in range(10)] == list(range(1, 11))
        eventually(lambda: sum(together) >= 1000)
        assert max(together) <= 8


def test_who_sends_ever_more_messages_waits(bridge: Bridge) -> None:
    """Neither pings nor anything else takes the loop from other links, or has more than a few answers."""
    server = bridge.server()
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as rogue:
        eventually(lambda: linked(server))
        link = link_of(server)
        handled, handle = [0], link.handlers[Ping]

        def counted(message: ControlMessageBase) -> None:
            handled[0] += isinstance(message, Ping)
            handle(message)

        link.handlers[Ping] = counted
        began = time.monotonic()
        rogue.say(*(Ping(n=n, sent=n) for n in range(1, 6001)))
        eventually(lambda: handled[0] == 6000)
        assert time.monotonic() - began >= (6000 - 4096) / 500  # at once, and a second
        rogue.say(ListTopics(request=1))
        pongs = 0
        while isinstance(rogue.wait_for(Pong, TopicList), Pong):
            pongs += 1
        assert 10 <= pongs <= 10 + 4 * (time.monotonic() - began)

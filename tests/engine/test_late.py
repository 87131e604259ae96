"""Messages that take too long, and a link that carries less than is asked of it: what both sides say of it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import link, linked, route
from tests.support.domain import text
from tests.support.relay import Relay
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, LinkCause

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.session import Protocol


class Talking:
    """Publishes at a rate until it is left; `size` bytes each."""

    def __init__(self, publisher: Publisher, rate: float, size: int) -> None:
        self._publisher, self._pause, self._text = publisher, 1 / rate, " " * size
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Talking:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.wait(self._pause):
            self._publisher.publish(text(self._text))


def both_say(engines: tuple[Engine, Engine], topic: str, state: State, cause: str, within: float) -> None:
    """Wait until both sides show this state and cause."""

    def said() -> bool:
        return all((route(each, topic).state, route(each, topic).cause) == (state, cause) for each in engines)

    try:
        eventually(said, within)
    except AssertionError:
        found = [(route(each, topic).state, route(each, topic).reason, link(each).warning) for each in engines]
        raise AssertionError(f"{topic} is not {state} on both sides within {within:g} s: {found}") from None


@pytest.fixture
def holding(bridge: Bridge) -> Iterator[Relay]:
    with Relay(("127.0.0.1", bridge.port)) as relay:
        yield relay


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
def test_messages_that_are_held_on_the_way_are_late_on_both_sides(
    protocol: Protocol, bridge: Bridge, holding: Relay, robot: Domain, pc: Domain
) -> None:
    out, _ = robot.publisher("/scan"), pc.listener("/scan")
    server = bridge.server()
    client = bridge.client(
        Topic("/scan", "transmit", protocol=protocol), server_ip="127.0.0.1", server_port=holding.port
    )
    eventually(lambda: linked(client) and linked(server), what="linked")
    with Talking(out, 1, 100):  # so few that the window of a stream takes them all
        both_say((client, server), "/scan", State.OK, Cause.NONE, 15)
        holding.delay = lambda: 3.0
        both_say((client, server), "/scan", State.LATE, Cause.LATE, 15)
        eventually(lambda: all(event_of(each, EventCode.ROUTE_FAULT, Cause.LATE) for each in (client, server)))
        holding.delay = lambda: 0.0
        both_say((client, server), "/scan", State.OK, Cause.NONE, 15)
        eventually(lambda: all(event_of(each, EventCode.ROUTE_RECOVERED, Cause.LATE) for each in (client, server)))
    assert not event_of(client, EventCode.LINK_FULL, LinkCause.FULL)


def event_of(engine: Engine, code: EventCode, cause: str = "") -> bool:
    return any((event.code, event.cause) == (code, cause) for event in engine.events())


def test_a_tunnel_that_carries_too_little_is_full_on_both_sides(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """It takes everything at first: only what arrives shows how little it carries."""
    out, _ = robot.publisher("/camera"), pc.listener("/camera")
    server = bridge.server()
    with Relay(("127.0.0.1", bridge.port), rate=1_000_000) as relay:
        client = bridge.client(Topic("/camera", "transmit"), server_ip="127.0.0.1", server_port=relay.port)
        eventually(lambda: linked(client) and linked(server), what="linked")
        with Talking(out, 20, 700):
            both_say((client, server), "/camera", State.OK, Cause.NONE, 15)
            relay.rate = 5_000
            eventually(lambda: all(link(each).cause == LinkCause.FULL for each in (client, server)))
            wrong = {Cause.LATE, Cause.QUEUE_FULL}  # the second one where what waits too long is dropped
            eventually(lambda: all(route(each, "/camera").cause in wrong for each in (client, server)))
            out_there, in_here = link(client).full_out, link(server).full_in
            assert out_there is not None
            assert in_here is not None
            for each in (out_there, in_here):
                assert 2_500 < each.carried < 7_500
                assert 11_000 < each.asked < 20_000
                assert each.topics == ("/camera",)
            assert event_of(client, EventCode.LINK_FULL, LinkCause.FULL)
            assert event_of(server, EventCode.LINK_FULL, LinkCause.FULL)
            relay.rate = 1_000_000
            eventually(lambda: all(not link(each).warning for each in (client, server)))
            both_say((client, server), "/camera", State.OK, Cause.NONE, 15)
        assert event_of(client, EventCode.LINK_ROOM)
        assert event_of(server, EventCode.LINK_ROOM)

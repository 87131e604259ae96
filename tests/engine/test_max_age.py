"""No message and no request that is older than `max_age` is published, after any delay on the way."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tests.engine.latched_helpers import JOINS_LATE, latched
from tests.support import constants
from tests.support.bridge import linked, opened, route
from tests.support.domain import text
from tests.support.inside import inside
from tests.support.long import long_cases
from tests.support.relay import Relay
from tests.support.spun import Spun
from tests.support.steady import Steady
from tests.support.waiting import eventually, holds

from rsb_bridge.model.motion import SLOWEST
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Listener

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.snapshot import Ledger
    from rsb_bridge.model.transports import Protocol

MAX_AGE = 0.5
TOLERANCE = 0.15
"""s that it takes on a busy machine from the last look at a message's age until it is published."""
HELD = 3.0
EXPIRED = {(State.LATE, Cause.LINK_SLOW), (State.LATE, Cause.CLOCK_UNKNOWN)}


@pytest.fixture
def holding(bridge: Bridge) -> Iterator[Relay]:
    with Relay(("127.0.0.1", bridge.port)) as relay:
        yield relay


class Noting:
    """Publishes numbers, and notes when each had been published; before that, a busy machine may hold it up.

    Attributes:
        at: ns since the epoch, by number.
    """

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self.at: list[int] = []

    def publish(self, message: bytes = b"") -> None:
        """Publish the next number, for any message."""
        self._publisher.publish(text(str(len(self.at))))
        self.at.append(time.time_ns())


def publishing(out: Any) -> Steady:
    """Publish 20 times a second."""
    return Steady(out, 20.0, lambda _: b"")


def ages(listener: Listener, out: Noting) -> list[float]:
    """Return the age (s) of each message when the bridge published it."""
    return [
        (published - out.at[int(deserialize_message(payload, String).data)]) / 1e9
        for payload, published in zip(listener.payloads, listener.published, strict=True)
    ]


def clocks_known(*engines: Engine) -> bool:
    return all(link.keepalive.stamps.offset is not None for each in engines for link in inside(each).role.links())


@pytest.mark.parametrize(
    ("side", "protocol"),
    [
        ("sender", "udp"),
        ("receiver", "tcp"),
        ("neither", "tcp"),
        *long_cases(("sender", "tcp"), ("receiver", "udp"), ("neither", "udp")),
    ],
)
def test_network_that_held_everything_yields_nothing_old(
    protocol: Protocol,
    side: str,
    bridge: Bridge,
    holding: Relay,
    robot: Domain,
    pc: Domain,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Either side may have the `max_age`: the robot that publishes, or the server of a topic that the robot lists.

    With neither, commands by their name are not published later, either.
    """
    constants.DEAD_AFTER.set(monkeypatch, 60.0)  # the silence loses no link
    out, heard = Noting(robot.publisher("/cmd")), pc.listener("/cmd")
    topic = Topic("/cmd", "transmit", protocol=protocol, max_age=MAX_AGE if side == "sender" else None)
    theirs = msgspec.structs.replace(topic, max_age=MAX_AGE)
    clients = (Client("robot1", topics=(theirs,)),) if side == "receiver" else None
    server = bridge.server(clients=clients)
    client = bridge.client(topic, server_ip="127.0.0.1", server_port=holding.port)
    eventually(lambda: linked(client) and linked(server) and clocks_known(client, server), what="linked")
    eventually(lambda: "/cmd" in opened(server), what="open")
    both = (client, server)
    with publishing(out) as published:
        eventually(lambda: len(heard.payloads) > 10, what="messages")
        # Without a `max_age`, commands have the uncertainty on top, and that of a busy machine's first pings is large.
        doubt, first = (min(SLOWEST, _uncertainty(server)), len(heard.payloads)) if side == "neither" else (0.0, 0)
        holding.delay = lambda: HELD
        began, count = time.monotonic(), published.count
        eventually(lambda: time.monotonic() - began > HELD and published.count > count + 40)  # a busy machine is slow
        holding.delay = lambda: 0.0
        before = len(heard.payloads)
        eventually(lambda: all(_shown(each, "/cmd") in EXPIRED for each in both), what="late on both sides")
        eventually(lambda: len(heard.payloads) > before + 40, what="fresh messages again")
        eventually(lambda: all(_shown(each, "/cmd")[0] is State.OK for each in both))

    def agreed() -> Ledger | None:
        """The ledger once both sides and the listener have counted the same."""
        ledger, there = (route(each, "/cmd").ledger for each in both)
        same = ledger == there and not ledger.open and ledger.delivered == len(heard.payloads)
        return ledger if same else None

    ledger = eventually(agreed)
    assert max(ages(heard, out)[first:]) <= MAX_AGE + 2 * doubt + TOLERANCE
    assert ledger.expired >= 20
    assert ledger.offered == ledger.delivered + ledger.expired + ledger.dropped_total
    assert ledger.offered <= published.count


def _uncertainty(engine: Engine) -> float:
    """s by which the other side's clock, and so an age, may be wrong."""
    (link,) = inside(engine).role.links()
    uncertainty = link.keepalive.stamps.uncertainty
    assert uncertainty is not None
    return uncertainty


def _shown(engine: Engine, topic: str) -> tuple[State, str]:
    found = route(engine, topic)
    return found.state, found.cause


def test_latched_message_is_too_old_for_late_joiner(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    out = Noting(robot.publisher("/mode", qos=latched(1)))
    out.publish()
    began = time.monotonic()
    eventually(lambda: time.monotonic() - began > 2 * MAX_AGE)
    server, client = bridge.both(Topic("/mode", "transmit", max_age=MAX_AGE))
    heard = pc.listener("/mode", qos=JOINS_LATE)
    eventually(lambda: route(client, "/mode").ledger.expired == 1)
    eventually(lambda: clocks_known(client, server))
    holds(lambda: not heard.payloads, 1.0)
    eventually(lambda: route(server, "/mode").ledger.expired == 1)

    def is_heard() -> bool:
        """Publish once more: a busy machine may take so long that one is too old, too."""
        out.publish()
        return bool(heard.payloads)

    eventually(is_heard)
    assert max(ages(heard, out)) <= MAX_AGE + TOLERANCE


def test_request_that_is_too_old_reaches_no_server(
    bridge: Bridge, holding: Relay, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.DEAD_AFTER.set(monkeypatch, 60.0)
    asked: list[float] = []

    def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        asked.append(time.monotonic())
        return response

    there, here = Spun(pc.id, "server"), Spun(robot.id, "caller")
    try:
        there.node.create_service(Trigger, "/start", serve)
        caller = here.node.create_client(Trigger, "/start")
        service = Topic("/start", "transmit", kind="service", max_age=MAX_AGE, timeout=10.0)
        server = bridge.server()
        client = bridge.client(service, server_ip="127.0.0.1", server_port=holding.port)
        eventually(lambda: linked(client) and linked(server) and clocks_known(client, server), what="linked")
        eventually(caller.service_is_ready, what="offered")

        def arrives() -> bool:
            """Ask once, until that arrives or is refused; a busy machine may hold it up before the network does."""
            before, refused = len(asked), _too_old(client, "/start")
            caller.call_async(Trigger.Request())
            eventually(lambda: len(asked) > before or _too_old(client, "/start") > refused)
            return len(asked) > before

        eventually(arrives, what="a request in time")
        before, old = len(asked), _too_old(server, "/start")
        holding.delay = lambda: 1.5

        def is_refused_there() -> bool:
            assert not arrives()
            return _too_old(server, "/start") > old

        eventually(is_refused_there)
        assert len(asked) == before
    finally:
        there.close()
        here.close()


def _too_old(engine: Engine, name: str) -> int:
    calls = route(engine, name).calls
    return 0 if calls is None else calls.refused.get("too old", 0)

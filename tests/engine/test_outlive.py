"""A link outlives its connections: topics and calls go on where they were, and the far side's graph stays as it is."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool
from tests.engine.outlive_helpers import OUTLIVES, away, numbers
from tests.support.bridge import balance, carries, happened, linked, outgoing, route, settled
from tests.support.domain import LATCHED, text
from tests.support.inside import inside
from tests.support.steady import Steady
from tests.support.waiting import eventually

from rsb_bridge.link.association import Association
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.wire.messages import Hello


@pytest.mark.parametrize(("protocol", "seconds"), [("tcp", 0.0), ("tcp", 3.0), ("udp", 0.0), ("udp", 3.0)])
def test_reliable_topics_lose_nothing_while_the_link_is_away(
    bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, protocol: str, seconds: float
) -> None:
    """One each way, with small and large messages by turns, through three cuts."""
    ways = {"/up": (robot, pc, "transmit"), "/down": (pc, robot, "receive")}
    there = {topic: to.listener(topic) for topic, (_, to, _) in ways.items()}
    out = {topic: by.publisher(topic) for topic, (by, _, _) in ways.items()}
    topics = [
        Topic(topic, way, qos={"depth": 1000}, protocol=protocol)  # type: ignore[arg-type]
        for topic, (_, _, way) in ways.items()
    ]
    server, client = bridge.both(*topics, outlive=OUTLIVES)
    receivers, senders = {"/up": server, "/down": client}, {"/up": client, "/down": server}
    for topic, engine in receivers.items():
        carries([out[topic]], engine, [topic])
    openings = {topic: outgoing(engine, topic).route.id for topic, engine in senders.items()}

    def endpoints() -> set[bytes]:
        found = (domain.node.get_publishers_info_by_topic(topic) for domain in (robot, pc) for topic in ways)
        return {bytes(each.endpoint_gid) for ends in found for each in ends}

    before_all = endpoints()

    def message(number: int) -> bytes:
        return text(f"{number}" + " " * (40_000 if number % 2 else 10))

    with Steady(out["/up"], 50.0, message) as up, Steady(out["/down"], 50.0, message) as down:
        for _ in range(3):
            before = up.count
            eventually(lambda before=before: up.count > before + 50)
            relay.refuse()
            relay.cut()
            eventually(lambda: away(client) and away(server))
            before = up.count
            eventually(lambda before=before: up.count > before + 50 * seconds)
            relay.refuse(False)
            eventually(lambda: linked(client) and linked(server))
    counts = {"/up": up.count, "/down": down.count}
    for topic, engine in senders.items():
        ledger = settled(engine, topic, counts[topic])
        assert balance(ledger) == ledger.delivered == counts[topic]
        eventually(lambda topic=topic: len(there[topic].payloads) >= counts[topic])
        assert numbers(there[topic].payloads) == [*range(counts[topic])]
        assert outgoing(engine, topic).route.id == openings[topic]
    assert endpoints() == before_all
    for side in (server, client):
        assert not happened(side, EventCode.LINK_STREAM_REOPENED)
        assert not happened(side, EventCode.ROUTE_FAULT, "late")


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
def test_latched_topics_and_services_go_on(
    bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, protocol: str
) -> None:
    pc.serve("/lamp", SetBool)
    out, there = robot.publisher("/map", qos=LATCHED), pc.listener("/map", qos=LATCHED)
    server, client = bridge.both(
        Topic("/map", "transmit", protocol=protocol),
        Topic("/lamp", "transmit", kind="service"),
        outlive=OUTLIVES,
    )
    carries([out], server, ["/map"])
    eventually(lambda: route(client, "/lamp").cause == "no_call")
    came = len(there.payloads)
    relay.refuse()
    relay.cut()
    eventually(lambda: away(client) and away(server))
    out.publish(text("map"))
    relay.refuse(False)
    eventually(lambda: there.payloads[came:])
    assert there.payloads[came:] == [text("map")]
    eventually(lambda: route(client, "/lamp").cause == "no_call")


def test_what_waits_is_dropped_with_the_association(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    out, there = robot.publisher("/scan"), pc.listener("/scan")
    server, client = bridge.both(Topic("/scan", "transmit", qos={"depth": 100}), outlive=2.0)
    carries([out], server, ["/scan"])
    opening = outgoing(client, "/scan").route.id
    relay.refuse()
    relay.cut()
    for side in (client, server):
        eventually(lambda side=side: happened(side, EventCode.LINK_CLOSED))
        assert not away(side)
    relay.refuse(False)
    eventually(lambda: linked(client) and linked(server))
    eventually(lambda: outgoing(client, "/scan").route.id not in (0, opening))
    carries([out], server, ["/scan"])
    out.publish(text("again"))
    eventually(lambda: there.payloads)


def test_queues_are_not_blamed_for_silent_link(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Once something is overdue on the connection, what the QoS drops counts as an outage, before the link is away."""
    out, there = robot.publisher("/scan"), pc.listener("/scan")
    server, client = bridge.both(Topic("/scan", "transmit", qos={"depth": 10}), outlive=OUTLIVES)
    carries([out], server, ["/scan"])
    (link,) = inside(client).role.links()
    with Steady(out, 100.0, lambda number: text(str(number))) as steady:
        eventually(lambda: there.payloads)
        relay.stall(new=True)
        eventually(lambda: link.keepalive.in_doubt)
        dropped = route(client, "/scan").ledger.dropped.get("queue full", 0)
        eventually(lambda: away(client))
        eventually(lambda: route(client, "/scan").ledger.dropped.get("outage", 0) > 200)
        relay.stall(False)
        relay.cut()
        eventually(lambda: linked(client) and linked(server))
    ledger = settled(client, "/scan", steady.count)
    assert balance(ledger) == steady.count
    assert ledger.dropped.get("queue full", 0) <= dropped + 100


@pytest.mark.parametrize(("here", "there"), [(2.0, OUTLIVES), (OUTLIVES, 2.0)])
def test_smaller_outlive_counts_on_both_sides(bridge: Bridge, relay: Relay, here: float, there: float) -> None:
    server, client = bridge.server(outlive=there), bridge.client(Topic("/scan", "transmit"), outlive=here)
    eventually(lambda: linked(client) and linked(server))
    relay.refuse()
    relay.cut()
    for side in (client, server):
        lost = eventually(lambda side=side: happened(side, EventCode.LINK_LOST))
        closed = eventually(lambda side=side: happened(side, EventCode.LINK_CLOSED))
        assert 1.9 < closed.time - lost.time < 10.0


@pytest.mark.parametrize(("here", "there"), [(0.0, OUTLIVES), (OUTLIVES, 0.0)])
def test_either_side_can_have_nothing_wait(bridge: Bridge, relay: Relay, here: float, there: float) -> None:
    server, client = bridge.server(outlive=there), bridge.client(outlive=here)
    eventually(lambda: linked(client) and linked(server))
    relay.refuse()
    relay.cut()
    for side in (client, server):
        eventually(lambda side=side: happened(side, EventCode.LINK_LOST))
        assert not away(side)


def test_what_waited_overruns_no_subscription(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Each of 600 events comes to a node that keeps a hundred, and takes one in a millisecond."""
    out, there = robot.publisher("/events"), pc.listener("/events", qos=QoSProfile(depth=100))
    server, client = bridge.both(Topic("/events", "transmit", qos={"history": "keep_all"}), outlive=OUTLIVES)
    carries([out], server, ["/events"])
    relay.refuse()
    relay.cut()
    eventually(lambda: away(client) and away(server))
    came = len(there.payloads)
    for number in range(600):
        out.publish(text(str(number)))
        time.sleep(0.001)
    eventually(lambda: route(client, "/events").reason.endswith(" s, 600 kept"))
    assert route(server, "/events").reason.endswith(" s for the link")
    (shown,) = client.snapshot().links
    assert shown.association_ends is not None
    assert shown.association_ends - client.snapshot().time < OUTLIVES
    relay.refuse(False)

    deadline = time.monotonic() + 60
    while len(there.payloads) < came + 600 and time.monotonic() < deadline:  # as a node that spins
        time.sleep(0.001)
    assert numbers(there.payloads[came:]) == [*range(600)]


def test_topics_of_a_link_that_is_away_share_a_limit(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    topics = "/one", "/other"
    out = {topic: robot.publisher(topic) for topic in topics}
    there = {topic: pc.listener(topic) for topic in topics}
    server, client = bridge.both(
        *(Topic(topic, "transmit", qos={"history": "keep_all"}) for topic in topics), outlive=OUTLIVES
    )
    carries(out.values(), server, topics)
    (link,) = inside(client).role.links()
    link.budget.waiting.limit = 100_000
    came = {topic: len(each.payloads) for topic, each in there.items()}
    relay.refuse()
    relay.cut()
    eventually(lambda: away(client) and away(server))
    for number in range(20):
        for each in out.values():
            each.publish(text(f"{number}" + " " * 10_000))
    for topic in topics:
        eventually(lambda topic=topic: route(client, topic).ledger.offered >= came[topic] + 20)
    assert 90_000 < link.budget.waiting.held <= 110_000
    relay.refuse(False)
    for topic in topics:
        eventually(lambda topic=topic: numbers(there[topic].payloads)[-1:] == [19])
    delivered = sum(len(each.payloads) - came[topic] for topic, each in there.items())
    assert delivered in (9, 10, 11)
    assert sum(route(client, topic).ledger.dropped["outage"] for topic in topics) == 40 - delivered


def test_client_is_refused_and_back_if_its_association_has_moved_on(
    bridge: Bridge, relay: Relay, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server has handled more from the connection before, after its answer on the new one."""
    server, client = bridge.both(Topic("/up", "transmit"), outlive=OUTLIVES)
    eventually(lambda: linked(client) and linked(server))
    may_resume, answers = Association.may_resume, [False, True]

    def has_moved_on_once(association: Association, hello: Hello) -> bool:
        return answers.pop() if answers else may_resume(association, hello)

    monkeypatch.setattr(Association, "may_resume", has_moved_on_once)
    relay.cut()
    eventually(lambda: happened(server, EventCode.LINK_REJECTED, "moved on"))
    eventually(lambda: happened(client, EventCode.LINK_UP, "goes on") and linked(client) and linked(server))
    assert not answers

"""Bridges in a ring, or side by side: no message goes round, and what can arrive does."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_msgs.msg import String
from tests.engine.loops_helpers import CHAT, DEEP, Pair, connect, new_domain, robot
from tests.support import constants
from tests.support.bridge import find, happened, route
from tests.support.domain import Domain, text
from tests.support.inside import inside
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.names import ANNOUNCEMENT_TOPIC
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.domain import Listener

__all__ = ["robot"]


ENTRY = '{"topic": "/x", "gid": "00", "via": ["a/x"]}'


@pytest.fixture(autouse=True)
def patience(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bridges get as long as a slow machine takes to announce the origin of messages; strangers never do."""
    if request.function is not test_a_stranger_may_announce_what_it_likes:
        constants.EXPLAINED_WITHIN.set(monkeypatch, 30.0)


@pytest.fixture
def pc(_domains: int) -> Iterator[Domain]:
    yield from new_domain(_domains + 1)


def one_way(bridge: Bridge, *domains: Domain) -> list[Pair]:
    """A ring: from each domain to the next, and from the last to the first."""
    return [
        connect(bridge, here, there, "transmit")
        for here, there in zip(domains, (*domains[1:], domains[0]), strict=True)
    ]


def refused(pair: Pair) -> bool:
    """Whether both sides say that the chat would loop."""
    return all(
        (found := find(engine, CHAT)) is not None and found.state is State.DOWN and found.cause == Cause.LOOP
        for engine in pair
    )


def says(publisher: Publisher, listeners: Iterable[Listener], words: str) -> None:
    """Publish until all listeners have heard something."""
    listeners = tuple(listeners)

    def heard() -> bool:
        publisher.publish(text(words))
        return all(any(each == words for each in listener.texts(100)) for listener in listeners)

    eventually(heard, what=f"{words} heard everywhere")


def counts(domains: dict[str, Domain], publishers: dict[str, Publisher], messages: int = 20) -> dict[str, float]:
    """Return how often each of these publishers' messages is heard in each domain, once all are heard everywhere."""
    listeners = {name: domain.listener(CHAT) for name, domain in domains.items()}
    for name, publisher in publishers.items():
        says(publisher, listeners.values(), f"{name} begins")
    for name, publisher in publishers.items():
        for number in range(messages):
            publisher.publish(text(f"{name} {number}"))
    for name, publisher in publishers.items():
        says(publisher, listeners.values(), f"{name} ends")
    found = {}
    for name in publishers:
        for where, listener in listeners.items():
            said = [each for each in listener.texts(10_000) if each.startswith(name) and each.split()[1].isdigit()]
            found[f"{name} in {where}"] = len(said) / messages
    return found


def test_ring_carries_what_can_arrive_and_nothing_round(
    bridge: Bridge, robot: Domain, pc: Domain, third: Domain
) -> None:
    """The route that would close the ring is refused on both sides, which name the bridges, while it would bring
    nothing new: until another one is removed, or somebody publishes elsewhere. Then each leaves out what has been
    where it leads.
    """
    domains = {"a": robot, "b": pc, "c": third}
    publishers = {"a": robot.publisher(CHAT)}
    ring = one_way(bridge, *domains.values())
    eventually(lambda: refused(ring[2]), what="refused")
    assert counts(domains, publishers) == {"a in a": 1, "a in b": 1, "a in c": 1}
    for engine in (engine for pair in ring[:2] for engine in pair):
        eventually(lambda engine=engine: route(engine, CHAT).state is State.OK)
    for engine in ring[2]:
        event = happened(engine, EventCode.ROUTE_LOOP)
        assert event is not None
        nodes = [inside(each.client).context.ros.node_name for each in ring[:2]]
        assert all(node in event.text for node in nodes)

    ring[0].client.remove_topic(route(ring[0].client, CHAT).key).result()
    eventually(lambda: not any(route(engine, CHAT).state is State.DOWN for engine in ring[2]), what="opened")
    eventually(lambda: all(happened(engine, EventCode.ROUTE_LOOP_GONE) for engine in ring[2]))
    publishers["c"] = third.publisher(CHAT)
    says(publishers["c"], [robot.listener(CHAT)], "c opened")
    ring[0].client.add_topic(Topic(CHAT, "transmit", qos=DEEP)).result()
    says(publishers["a"], [third.listener(CHAT)], "a again")

    publishers["b"] = pc.publisher(CHAT)
    assert counts(domains, publishers) == {f"{who} in {where}": 1 for who in domains for where in domains}
    for pair in ring:
        eventually(lambda pair=pair: all(route(engine, CHAT).state is State.OK for engine in pair))
    # The announcement of what this link brings may come a moment after the messages.
    eventually(lambda: "left out" in route(ring[0].client, CHAT).stages[0].detail, what="left out")


def test_a_ring_both_ways(bridge: Bridge, robot: Domain, pc: Domain, third: Domain) -> None:
    """Two ways lead to each other domain, and each message comes by both."""
    domains = {"a": robot, "b": pc, "c": third}
    publishers = {name: domain.publisher(CHAT) for name, domain in domains.items()}
    for here, there in ((robot, pc), (pc, third), (third, robot)):
        connect(bridge, here, there, "transmit", "receive")
    ways = {f"{who} in {where}": 1 if who == where else 2 for who in domains for where in domains}
    eventually(lambda: counts(domains, publishers) == ways, 180.0)


def test_two_bridges_side_by_side(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Each message arrives by both: they double messages, and no more."""
    publishers = {"a": robot.publisher(CHAT)}
    pairs = [connect(bridge, robot, pc, "transmit", "receive") for _ in range(2)]
    for pair in pairs:  # nobody publishes in b but the other bridge
        eventually(
            lambda pair=pair: {each.state for each in pair.client.snapshot().routes} == {State.DOWN, State.WAITING},
            what="refused",
        )
    domains = {"a": robot, "b": pc}
    publishers["b"] = pc.publisher(CHAT)
    ways = {"a in a": 1, "a in b": 2, "b in a": 2, "b in b": 1}
    eventually(lambda: counts(domains, publishers) == ways, 180.0)


def test_a_ring_through_one_engine(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Two clients in one domain: what one of them brings to the server, the other would bring back."""
    clients = tuple(Client(name, key_file=bridge.key_file) for name in ("there", "back"))
    server = bridge.server(clients=clients, shared_keys=True)
    there = bridge.client(Topic(CHAT, "transmit", qos=DEEP), name="there")
    back = bridge.client(Topic(CHAT, "receive", qos=DEEP), name="back")
    publisher = robot.publisher(CHAT)
    eventually(lambda: (found := find(back, CHAT)) and found.state is State.DOWN and found.cause == Cause.LOOP)
    assert counts({"a": robot, "b": pc}, {"a": publisher}) == {"a in a": 1, "a in b": 1}
    eventually(lambda: route(there, CHAT).state is State.OK)
    eventually(lambda: {each.state for each in server.snapshot().routes} == {State.OK, State.DOWN})


def test_one_server_passes_on_between_its_clients(bridge: Bridge, robot: Domain, third: Domain) -> None:
    """Without anybody in the server's domain, and with the type and the QoS of who publishes."""
    clients = tuple(Client(name, key_file=bridge.key_file) for name in ("from", "to"))
    bridge.server(clients=clients, shared_keys=True)
    bridge.client(Topic(CHAT, "transmit", qos=DEEP), name="from")
    bridge.client(Topic(CHAT, "receive", qos=DEEP), name="to", domain_id=third.id)
    assert counts({"a": robot, "c": third}, {"a": robot.publisher(CHAT)}) == {"a in a": 1, "a in c": 1}


def test_back_under_another_name_is_no_loop(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    clients = tuple(Client(name, key_file=bridge.key_file) for name in ("there", "back"))
    bridge.server(clients=clients, shared_keys=True)
    bridge.client(Topic(CHAT, "transmit", remote_topic="/there"), name="there")
    bridge.client(Topic("/back", "receive", remote_topic="/there"), name="back")
    says(robot.publisher(CHAT), [pc.listener("/there"), robot.listener("/back")], "a")


def test_a_stranger_may_announce_what_it_likes(bridge: Bridge, robot: Domain, pc: Domain, third: Domain) -> None:
    """It is reported once, and the ring is as safe as before."""
    publisher = robot.publisher(CHAT)
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    strangers = [domain.publisher(ANNOUNCEMENT_TOPIC, qos=latched) for domain in (robot, pc, third)]
    nonsense = [
        String(data="not JSON"),
        String(data='{"version": 7}'),
        String(data="[" * 100_000),
        String(data=" " * (5 << 20)),
        text("bytes")[:7],
        b"\0\1\0\0\xff\xff\xff\xff",
        String(data='{"version": 1, "publishers": [{"topic": "/x", "gid": "xyz", "via": []}]}'),
        String(data=f'{{"version": 1, "publishers": [{", ".join(20_000 * [ENTRY])}]}}'),
    ]
    ring = one_way(bridge, robot, pc, third)
    for each in nonsense:
        for stranger in strangers:
            stranger.publish(each)
    eventually(lambda: refused(ring[2]), what="refused")
    domains = {"a": robot, "b": pc, "c": third}
    assert counts(domains, {"a": publisher}) == {"a in a": 1, "a in b": 1, "a in c": 1}
    for pair in ring:
        for engine in pair:
            assert len([each for each in engine.events() if each.code == EventCode.ENGINE_ANNOUNCEMENTS]) < 5

"""Liveliness of publishers: what a listener asks for, and learns, is the same on the far side as on the near one."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, qos_profile_best_available
from tests.engine.loops_helpers import connect
from tests.support import constants, replaced
from tests.support.bridge import find, protocol_of, reloaded, route
from tests.support.domain import LATCHED, Domain, Listener, text
from tests.support.steady import Steady
from tests.support.waiting import eventually, holds

from rsb_bridge.model.qos import QosMismatch
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine

LEASE = 2.0
_CHANGED = rclpy_implementation.rcl_subscription_event_type_t.RCL_SUBSCRIPTION_LIVELINESS_CHANGED
_NODE = f"""
import sys, time
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import String
context = Context()
context.init([], domain_id=int(sys.argv[1]))
node = Node("mortal", context=context, enable_rosout=False, start_parameter_services=False)
qos = QoSProfile(depth=10, liveliness_lease_duration=Duration(seconds={LEASE}))
node.create_publisher(String, sys.argv[2], qos)
time.sleep(1000)
"""


def with_lease(kind: str = "automatic", lease: float = LEASE, *, latched: bool = False) -> QoSProfile:
    return QoSProfile(
        depth=10,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        liveliness=LivelinessPolicy[kind.upper()],
        liveliness_lease_duration=Duration(seconds=lease),
    )


MANUAL = with_lease("manual_by_topic")


class Watcher:
    """A listener that learns who is alive."""

    def __init__(self, domain: Domain, topic: str, qos: QoSProfile) -> None:
        self.listener: Listener = domain.listener(topic, qos=qos)
        self._event: Any = rclpy_implementation.EventHandle(self.listener.subscription.handle, _CHANGED)

    @property
    def alive(self) -> int:
        count: int = self._event.take_event().alive_count
        return count


def says(engine: Engine, topic: str) -> tuple[State, str]:
    found = route(engine, topic)
    return found.state, found.cause


def alive_after(publishers: Sequence[Publisher], watchers: Sequence[Watcher]) -> list[int]:
    """Assert publishers' liveliness, and return how many each watcher knows to be alive."""
    for each in publishers:
        each.assert_liveliness()
    return [each.alive for each in watchers]


@pytest.fixture
def mortal(robot: Domain) -> Iterator[subprocess.Popen[bytes]]:
    """A process whose publisher of /mortal is alive as long as the process is."""
    made = subprocess.Popen((sys.executable, "-c", _NODE, str(robot.id), "/mortal"))
    yield made
    made.kill()
    made.wait()


@pytest.mark.parametrize(
    ("topic", "latched", "qos"),
    [
        ("/tcp", False, "auto"),
        ("/udp", False, "auto"),
        ("/latched_tcp", True, "auto"),
        ("/tcp", False, {"liveliness": "manual_by_topic", "liveliness_lease_duration": 2 * LEASE}),
    ],
)
def test_lease_ends_on_far_side(bridge: Bridge, robot: Domain, pc: Domain, topic: str, latched: bool, qos: Any) -> None:
    watcher = Watcher(pc, topic, with_lease("manual_by_topic", 2 * LEASE, latched=latched))
    publisher = robot.publisher(topic, qos=with_lease("manual_by_topic", latched=latched))
    server, _ = bridge.both(Topic(topic, "transmit", protocol=protocol_of(topic), qos=qos))
    with Steady(publisher, 20.0, lambda _: text("x")):
        eventually(lambda: len(watcher.listener.payloads) > 20 and watcher.alive)
    eventually(lambda: not watcher.alive)
    # Without a message
    eventually(lambda: alive_after([publisher], [watcher]) != [0])
    assert says(server, topic)[0] is State.OK


@pytest.fixture
def missed_assertions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have every other subscription miss the first assertion, as `tests/ros/test_missed_assertions.py` shows."""
    ask, numbers, missed = replaced.ASK_LIVELINESS.value, dict[Any, int](), set[Any]()

    def told(asked: Any) -> tuple[int, int] | None:
        found: tuple[int, int] | None = ask(asked)
        if numbers.setdefault(asked, len(numbers)) % 2 or found is None:
            return found
        alive, not_alive = found
        if alive:
            missed.add(asked)
        return alive - (asked in missed), not_alive

    replaced.ASK_LIVELINESS.set(monkeypatch, told)


@pytest.mark.usefixtures("missed_assertions")
@pytest.mark.parametrize(
    ("topic", "listed", "direction"),
    [
        ("/tcp", "/tcp", "transmit"),
        ("/tcp", "/tcp", "receive"),
        ("/udp", "/udp", "transmit"),
        ("/latched/tcp", "/latched/*", "transmit"),
    ],
)
def test_missed_assertion_is_made_up_for(
    bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, topic: str, listed: str, direction: Any
) -> None:
    near, far = (robot, pc) if direction == "transmit" else (pc, robot)
    qos = with_lease("manual_by_topic", latched="latched" in topic)
    watcher, publishers = Watcher(far, topic, qos), [near.publisher(topic, qos=qos) for _ in range(2)]
    bridge.both(Topic(listed, direction, protocol=protocol_of(topic)))
    for each in publishers:
        follows(each, watcher)
    relay.cut()
    follows(publishers[0], watcher)


def test_death_of_process_is_heard(bridge: Bridge, mortal: subprocess.Popen[bytes], pc: Domain) -> None:
    watcher = Watcher(pc, "/mortal", with_lease())
    bridge.both(Topic("/mortal", "transmit"))
    eventually(lambda: watcher.alive == 1)
    holds(lambda: watcher.alive == 1, 2 * LEASE)
    mortal.kill()
    eventually(lambda: not watcher.alive)


def test_lease_ends_with_the_link(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    watcher = Watcher(pc, "/scan", with_lease())
    robot.publisher("/scan", qos=with_lease())
    _, client = bridge.both(Topic("/scan", "transmit"))
    eventually(lambda: watcher.alive == 1)
    client.stop()
    eventually(lambda: not watcher.alive)


def test_two_ways_do_not_keep_each_other_alive(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Each side publishes what the other one does, and would see itself alive."""
    qos = with_lease("manual_by_topic")
    watchers = [Watcher(domain, "/both", qos) for domain in (robot, pc)]
    publishers = [domain.publisher("/both", qos=qos) for domain in (robot, pc)]
    bridge.both(Topic("/both", "transmit"), Topic("/both", "receive"))
    eventually(lambda: alive_after(publishers, watchers) == [2, 2])
    eventually(lambda: alive_after(publishers[:1], watchers) == [1, 1])
    eventually(lambda: alive_after([], watchers) == [0, 0])


@pytest.mark.parametrize("direction", ["transmit", "receive"])
@pytest.mark.parametrize("asked", [with_lease(), with_lease("manual_by_topic", 1e6)])
def test_listener_that_asks_for_more_is_named(
    bridge: Bridge, robot: Domain, pc: Domain, direction: Any, asked: QoSProfile
) -> None:
    near, far = (robot, pc) if direction == "transmit" else (pc, robot)
    deaf, publisher = far.listener("/scan", qos=asked), near.publisher("/scan")
    server, client = bridge.both(Topic("/scan", direction))
    with Steady(publisher, 20.0, lambda _: text("x")):
        for engine in (server, client):
            eventually(lambda engine=engine: says(engine, "/scan") == (State.UNHEARD, Cause.QOS_INCOMPATIBLE))
            eventually(lambda engine=engine: "/stock" in route(engine, "/scan").reason)
    assert not deaf.payloads


def test_best_available_listener_is_told_its_reason(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Before it has a publisher, ROS makes it ask for the most."""
    pc.listener("/scan", qos=qos_profile_best_available)
    robot.publisher("/scan", qos=LATCHED)
    server, _ = bridge.both(Topic("/scan", "transmit"))
    eventually(lambda: says(server, "/scan") == (State.UNHEARD, Cause.QOS_INCOMPATIBLE))
    assert QosMismatch.LIVELINESS(kind="manual_by_topic") in route(server, "/scan").reason


def test_publisher_that_offers_less_than_the_topic(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    robot.publisher("/scan")
    server, client = bridge.both(Topic("/scan", "transmit", qos={"liveliness_lease_duration": LEASE}))
    for engine in (server, client):
        eventually(lambda engine=engine: says(engine, "/scan") == (State.DOWN, Cause.QOS_INCOMPATIBLE))


def asserted(lease: float) -> dict[str, Any]:
    return {"liveliness": "manual_by_topic", "liveliness_lease_duration": lease}


def follows(publisher: Publisher, watcher: Watcher) -> None:
    """Check that a watcher learns when a publisher is alive, and when it is not."""
    eventually(lambda: alive_after([publisher], [watcher]) == [1])
    eventually(lambda: not watcher.alive)


def changed_by_edit(client: Engine, _: Path, topic: Topic) -> None:
    client.edit_topic(route(client, topic.topic).key, topic).result(60)


def changed_in_file(client: Engine, folder: Path, topic: Topic) -> None:
    assert not reloaded(client, folder / "edited.yaml", topics=(topic,)).failed


@pytest.mark.parametrize("change", [changed_by_edit, changed_in_file])
def test_other_lease_counts_while_it_runs(
    change: Callable[[Engine, Path, Topic], None], bridge: Bridge, robot: Domain, pc: Domain
) -> None:
    watcher, publisher = Watcher(pc, "/scan", with_lease("manual_by_topic")), robot.publisher("/scan", qos=MANUAL)
    server, client = bridge.both(Topic("/scan", "transmit"))
    follows(publisher, watcher)
    change(client, bridge.folder, Topic("/scan", "transmit", qos=asserted(4 * LEASE)))
    eventually(lambda: says(server, "/scan") == (State.UNHEARD, Cause.QOS_INCOMPATIBLE))
    change(client, bridge.folder, Topic("/scan", "transmit", qos=asserted(LEASE)))
    follows(publisher, watcher)


@pytest.mark.parametrize(
    ("topic", "direction"), [("/sub/*", "transmit"), ("/sub/*", "receive"), ("/sub/scan", "receive")]
)
def test_lease_crosses_by_pattern_and_to_the_client(
    bridge: Bridge, robot: Domain, pc: Domain, topic: str, direction: Any
) -> None:
    near, far = (robot, pc) if direction == "transmit" else (pc, robot)
    watcher, publisher = Watcher(far, "/sub/scan", MANUAL), near.publisher("/sub/scan", qos=MANUAL)
    bridge.both(Topic(topic, direction))
    follows(publisher, watcher)


def test_far_publisher_stands_for_two(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """It is alive as long as one of them is."""
    watcher = Watcher(pc, "/scan", MANUAL)
    publishers = [robot.publisher("/scan", qos=MANUAL) for _ in range(2)]
    bridge.both(Topic("/scan", "transmit"))
    eventually(lambda: alive_after(publishers, [watcher]) == [1])
    holds(lambda: alive_after(publishers[:1], [watcher]) == [1], 2 * LEASE)
    eventually(lambda: not watcher.alive)


@pytest.mark.parametrize("others", [False, True])
def test_ring_of_two_bridges_keeps_nobody_alive(
    bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch, others: bool
) -> None:
    """Each of two bridges publishes what the other one takes, and would see it alive."""
    constants.EXPLAINED_WITHIN.set(monkeypatch, 30.0)
    watchers = [Watcher(domain, "/chat", MANUAL) for domain in (robot, pc)]
    publishers = [robot.publisher("/chat", qos=MANUAL)]
    if others:
        publishers.append(pc.publisher("/chat", qos=MANUAL))
    ways = ((robot, pc), (pc, robot))
    for pair in [connect(bridge, here, there, "transmit", qos="auto") for here, there in ways]:
        eventually(lambda pair=pair: all(find(engine, "/chat") is not None for engine in pair))
    alive = [2, 2] if others else [1, 1]
    eventually(lambda: alive_after(publishers, watchers) == alive)
    holds(lambda: alive_after(publishers, watchers) == alive, 2 * LEASE)
    eventually(lambda: alive_after(publishers[1:], watchers) == ([1, 1] if others else [0, 0]))
    eventually(lambda: alive_after([], watchers) == [0, 0])

"""Both sides' verdicts, in snapshots and as JSON, as nodes come and go.

`tests.console.test_both_screens` has each cause once, with both sides' words.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.bridge import carries, happened, now, route
from tests.support.domain import BEST_EFFORT, text
from tests.support.relay import message_number
from tests.support.waiting import eventually, holds

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.topic_verdict import USE_TCP
from rsb_console.command.formatting import json_status

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot

_TALKER = """
import sys, time, rclpy
from std_msgs.msg import String
rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("mortal")
publisher = node.create_publisher(String, sys.argv[2], 10)
while True:
    publisher.publish(String(data="alive"))
    time.sleep(0.05)
"""

_ODD = """
import sys, rclpy
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Int32
rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("odd", start_parameter_services=False)
for words in sys.stdin:
    match words.split():
        case ["publish", topic]:
            node.create_publisher(Int32, topic, 10)
        case ["subscribe", topic]:
            node.create_subscription(Int32, topic, print, qos_profile_sensor_data)
        case ["leave"]:
            for each in tuple(node.publishers):
                node.destroy_publisher(each)
"""


class Beat:
    """Publishes at a rate until it ends."""

    def __init__(self, publisher: Publisher, rate: float, message: Any) -> None:
        self.rate = rate
        self._publisher, self._message = publisher, message
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._over.wait(1 / self.rate):
            self._publisher.publish(self._message)

    def stop(self) -> None:
        self._over.set()
        self._thread.join()


@pytest.fixture
def beat() -> Iterator[Callable[..., Beat]]:
    """Makes publishers publish."""
    beats: list[Beat] = []

    def make(publisher: Publisher, rate: float = 20.0, message: Any = None) -> Beat:
        beats.append(Beat(publisher, rate, text("beat") if message is None else message))
        return beats[-1]

    yield make
    for each in beats:
        each.stop()


class Odd:
    """A node ``/odd`` in a process of its own: a participant can have one type on a topic.

    Two participants of one process that start together on a busy machine may stay unknown to each other for good.

    Args:
        domain: it is in this one, and known to its node.
    """

    def __init__(self, domain: Domain) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", _ODD, str(domain.id)], stdin=subprocess.PIPE, text=True, env=os.environ
        )
        eventually(lambda: "odd" in domain.node.get_node_names(), what="/odd in the domain")

    def tell(self, words: str) -> None:
        """Have it ``publish TOPIC``, ``subscribe TOPIC`` or ``leave``, which destroys its endpoints."""
        assert self._process.stdin
        print(words, file=self._process.stdin, flush=True)

    def close(self) -> None:
        """End it: its standard input ends."""
        self._process.communicate()


@pytest.fixture
def odd() -> Iterator[Callable[[Domain], Odd]]:
    """Makes such nodes."""
    with ExitStack() as stack:
        yield lambda domain: stack.enter_context(closing(Odd(domain)))


def verdict(engine: Engine, topic: str) -> tuple[State, str, str]:
    """State, cause and reason, as the screen has them, and the same as JSON."""
    shown = route(engine, topic)
    status = json.loads(json_status(now(engine)))["status"]["routes"]
    (as_json,) = [each for each in status if each["topic"] == topic]
    assert set(as_json) >= {"state", "cause", "reason", "from_peer"}
    return shown.state, shown.cause, shown.reason


def agree(
    client: Engine, server: Engine, topic: str, state: State, cause: Cause
) -> tuple[RouteSnapshot, RouteSnapshot]:
    """Wait until both sides say the same of a topic.

    Returns:
        What the client shows, and what the server does.
    """

    def both() -> list[Snapshot] | None:
        found = [now(engine) for engine in (client, server)]
        shown = [of(snapshot, topic) for snapshot in found]
        return found if all((each.state, each.cause) == (state, cause) for each in shown) else None

    try:
        found = eventually(both)
    except AssertionError:
        raise AssertionError([verdict(engine, topic) for engine in (client, server)]) from None
    for snapshot in found:
        (as_json,) = [each for each in json.loads(json_status(snapshot))["status"]["routes"] if each["topic"] == topic]
        assert (as_json["state"], as_json["cause"]) == (state, cause)
        assert of(snapshot, topic).reason
        assert 0.0 <= snapshot.time - of(snapshot, topic).since < 300.0
    here, there = (of(snapshot, topic) for snapshot in found)
    return here, there


def of(snapshot: Snapshot, topic: str) -> RouteSnapshot:
    """Return a topic's part of a snapshot."""
    return next(each for each in snapshot.routes if each.topic == topic)


def words(text: str, *expected: str) -> None:
    assert [each for each in expected if each not in text] == [], text


def logged(engine: Engine, cause: Cause) -> str:
    """Wait until the engine's log warns of a cause; the warning."""

    def warning() -> str:
        event = happened(engine, EventCode.ROUTE_FAULT)
        if event is None or event.cause != cause:
            return ""
        assert event.text.startswith(f"{event.topic}: {event.state.upper()}: ")
        assert event.from_peer == any(f": {side}: " in event.text for side in ("robot1", "server"))
        assert event.since is not None
        assert 0.0 <= event.time - event.since < 300.0
        return event.text

    return eventually(warning, what=f"{cause} in the log")


def test_a_subscriber_that_hears_nothing(
    bridge: Bridge, robot: Domain, pc: Domain, odd: Callable[[Domain], Odd], beat: Callable[..., Beat]
) -> None:
    server, client = bridge.both(Topic("/lidar", "transmit"))
    beat(robot.publisher("/lidar", qos=BEST_EFFORT))
    here, there = agree(client, server, "/lidar", State.UNHEARD, Cause.NO_SUBSCRIBER)
    words(there.reason, f"nobody subscribes to /lidar in domain {pc.id}")
    assert here.reason == f"server: {there.reason}"

    listener = pc.listener("/lidar")
    eventually(lambda: "/stock asks for reliable" in route(client, "/lidar").reason)  # DDS may tell the node later
    here, there = agree(client, server, "/lidar", State.UNHEARD, Cause.QOS_INCOMPATIBLE)
    words(there.reason, "/stock asks for reliable", "published with best_effort")
    words(here.reason, "server: ", "/stock asks for reliable")
    assert here.subscribers == there.subscribers == ("/stock",)
    assert "only" not in there.reason
    pc.publisher("/lidar")  # which it hears without the bridge
    eventually(lambda: "it hears only /stock" in route(client, "/lidar").reason)

    hears = pc.listener("/lidar", qos=BEST_EFFORT)  # one that hears it does not hide the other
    eventually(lambda: hears.payloads)
    agree(client, server, "/lidar", State.UNHEARD, Cause.QOS_INCOMPATIBLE)
    pc.node.destroy_subscription(listener.subscription)
    eventually(lambda: route(client, "/lidar").state == route(server, "/lidar").state == State.OK)

    odd(pc).tell("subscribe /lidar")
    eventually(lambda: "/odd has" in route(client, "/lidar").reason)
    here, there = agree(client, server, "/lidar", State.UNHEARD, Cause.TYPE_CONFLICT)
    words(there.reason, "/odd has std_msgs/msg/Int32", "carries std_msgs/msg/String")
    words(logged(client, Cause.TYPE_CONFLICT), "server: ")


def test_a_topic_slower_than_expected(bridge: Bridge, robot: Domain, pc: Domain, beat: Callable[..., Beat]) -> None:
    listener, out = pc.listener("/odom"), robot.publisher("/odom")
    server, client = bridge.both(Topic("/odom", "transmit", expected_rate=20.0))
    carries([out], server, ["/odom"])
    beating = beat(out, 2.0)
    here, there = agree(client, server, "/odom", State.SLOW, Cause.SLOW)
    words(here.reason, "of 20 expected", "that is all that /stock publishes")
    words(there.reason, "robot1: ", "of 20 expected")
    words(logged(server, Cause.SLOW), "SLOW")
    beating.stop()
    beat(out, 50.0)  # on a slow machine it is less
    eventually(lambda: route(client, "/odom").state == route(server, "/odom").state == State.OK)
    eventually(lambda: happened(server, EventCode.ROUTE_RECOVERED))
    assert listener.payloads


def test_a_publisher_that_dies_without_goodbye_is_noticed_before_dds_does(
    bridge: Bridge, robot: Domain, pc: Domain
) -> None:
    """Its rate was learned; DDS lists it for 20 to 40 s more."""
    listener = pc.listener("/odom")
    talker = subprocess.Popen([sys.executable, "-c", _TALKER, str(robot.id), "/odom"], env=os.environ)
    try:
        server, client = bridge.both(Topic("/odom", "transmit"), stale_after=4.0)
        eventually(lambda: (route(client, "/odom").expected_rate or 0) > 10, what="learned")
        eventually(lambda: route(client, "/odom").state is State.OK)  # a talker that is starved for a while is slow
    finally:
        talker.send_signal(signal.SIGKILL)
        talker.wait()
    here, there = agree(client, server, "/odom", State.STOPPED, Cause.PUBLISHER_SILENT)
    words(here.reason, "/mortal")
    words(there.reason, "robot1: ", "/mortal")
    assert listener.payloads
    # It stays so until DDS finds that it is gone, and then.
    for engine in (client, server):
        eventually(lambda engine=engine: happened(engine, EventCode.ROUTE_STALE), what="the warning of its silence")
    holds(lambda: {route(engine, "/odom").state for engine in (client, server)} == {State.STOPPED}, 3.0)
    agree(client, server, "/odom", State.STOPPED, Cause.PUBLISHER_GONE)


def test_a_topic_that_is_published_on_now_and_then_is_not_stale(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Nobody knows when the next message is due, and all that were sent have arrived."""
    listener, goal = pc.listener("/goal_pose"), robot.publisher("/goal_pose")
    server, client = bridge.both(Topic("/goal_pose", "transmit"), stale_after=0.5)
    carries([goal], server, ["/goal_pose"])

    def said() -> set[tuple[State, str]]:
        found = [route(engine, "/goal_pose") for engine in (client, server)]
        return {(each.state, each.cause) for each in found}

    for number in range(1, 4):
        goal.publish(text("a goal"))
        eventually(lambda number=number: len(listener.payloads) == number)
        eventually(lambda: said() == {(State.OK, "")})
        holds(lambda: said() == {(State.OK, "")}, 2.0)
    robot.node.destroy_publisher(goal)
    eventually(lambda: said() == {(State.OK, Cause.PUBLISHER_GONE)})
    holds(lambda: said() == {(State.OK, Cause.PUBLISHER_GONE)}, 2.0)
    assert [happened(engine, EventCode.ROUTE_STALE) for engine in (client, server)] == [None, None]


def test_two_types_on_one_topic(
    bridge: Bridge, robot: Domain, pc: Domain, odd: Callable[[Domain], Odd], beat: Callable[..., Beat]
) -> None:
    listener, out = pc.listener("/mixed"), robot.publisher("/mixed")
    other = odd(robot)
    other.tell("publish /mixed")
    server, client = bridge.both(Topic("/mixed", "transmit"))
    # Which state it is depends on whether one of the two was seen before the other.
    expected = ("std_msgs/msg/Int32", "std_msgs/msg/String", "/odd")
    for engine in (client, server):

        def mixed(engine: Engine = engine) -> RouteSnapshot | None:
            found = route(engine, "/mixed")
            return found if all(each in found.reason for each in expected) else None

        found = eventually(mixed)
        assert found.cause == Cause.TYPE_CONFLICT
        assert ("robot1: " in found.reason) == (engine is server)
    other.tell("leave")
    carries([out], server, ["/mixed"])
    beat(out)
    eventually(lambda: route(client, "/mixed").state == route(server, "/mixed").state == State.OK)
    other.tell("publish /mixed")
    here, _ = agree(client, server, "/mixed", State.UNHEARD, Cause.TYPE_CONFLICT)
    words(here.reason, "std_msgs/msg/Int32 (from /odd) is not bridged", "only std_msgs/msg/String")
    assert listener.payloads


def test_a_topic_that_is_throttled_on_purpose_is_fine(
    bridge: Bridge, robot: Domain, pc: Domain, beat: Callable[..., Beat]
) -> None:
    listener, out = pc.listener("/odom"), robot.publisher("/odom")
    server, client = bridge.both(Topic("/odom", "transmit", max_rate=5.0, expected_rate=25.0))
    carries([out], server, ["/odom"])
    beat(out, 50.0)
    eventually(lambda: len(listener.payloads) > 30)
    here, there = agree(client, server, "/odom", State.OK, Cause.THROTTLED)
    for shown in (here, there):
        words(shown.reason, "limit 5 Hz")
        ledger = shown.ledger
        assert ledger.throttled > 0
        assert ledger.delivered + ledger.in_flight == ledger.offered - ledger.throttled


def test_half_of_the_messages_lost_on_the_way(
    bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, beat: Callable[..., Beat]
) -> None:
    """Each takes several datagrams, and every other message loses one."""
    listener, out = pc.listener("/scan"), robot.publisher("/scan")
    server, client = bridge.both(Topic("/scan", "transmit", protocol="udp"))
    carries([out], server, ["/scan"])
    beat(out, 20.0, text("x" * 200_000))
    eventually(lambda: len(listener.payloads) > 20)
    eventually(lambda: route(client, "/scan").state is route(server, "/scan").state is State.OK)
    seen: set[int] = set()

    def lose_one_of_every_other(datagram: bytes) -> list[bytes]:
        number = message_number(datagram)
        if number is None or number % 2 or number in seen:
            return [datagram]
        seen.add(number)
        return []

    relay.to_server = lose_one_of_every_other
    agree(client, server, "/scan", State.SLOW, Cause.LOSSY)
    # a remedy is named once it is clear that the link is not full
    eventually(lambda: all(USE_TCP in route(each, "/scan").reason for each in (client, server)))
    here, there = agree(client, server, "/scan", State.SLOW, Cause.LOSSY)
    words(here.reason, "datagrams")
    words(there.reason, "robot1: ")
    words(logged(server, Cause.LOSSY), "robot1: ")
    relay.to_server = lambda datagram: [datagram]
    eventually(lambda: route(client, "/scan").state == route(server, "/scan").state == State.OK)

"""The bridge treats programs with another DDS, Cyclone DDS, in both domains as it treats stock nodes."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import SetBool
from tests.support import constants
from tests.support.bridge import heard, route
from tests.support.domain import text
from tests.support.spun import Spun
from tests.support.waiting import eventually

from rsb_bridge.cdr.description import TypeClash
from rsb_bridge.model.faults import is_wrong
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.distribution import package_of
from rsb_bridge.ros.ros_interface import BARE_DDS
from rsb_bridge.route.listeners import DURABLE, DeafText, UnmatchedText
from rsb_bridge.route.topic_verdict import PUBLISHED_NOTHING

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed: it has wheels for Python 3.11 to 3.13")

from cyclonedds.core import Policy
from tests.support.cyclone import HASHED, KEYED, NAMED, TIME, XCDR2, CycloneProgram

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

USUAL, ALL = Qos(), Qos(history="keep_all")
BEST_EFFORT, LATCHED = Qos(reliability="best_effort"), Qos(durability="transient_local", depth=5)


class Stock:
    """A stock node's endpoints, with the methods of `CycloneProgram`."""

    def __init__(self, domain: Domain) -> None:
        self._domain = domain

    def writer(self, topic: str, qos: Qos = USUAL) -> Any:
        return _StockWriter(self._domain.publisher(topic, qos=_profile(qos)))

    def reader(self, topic: str, qos: Qos = USUAL) -> Any:
        return _StockReader(self._domain.listener(topic, qos=_profile(qos)))


class _StockWriter:
    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher

    @property
    def matched(self) -> int:
        count: int = self._publisher.get_subscription_count()
        return count

    def publish(self, words: str) -> None:
        self._publisher.publish(text(words))


class _StockReader:
    def __init__(self, listener: Any) -> None:
        self._listener = listener

    @property
    def texts(self) -> list[str]:
        texts: list[str] = self._listener.texts(1000)
        return texts


def _profile(qos: Qos) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST if qos.history == "keep_last" else HistoryPolicy.KEEP_ALL,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliability == "reliable" else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
        deadline=Duration(seconds=qos.deadline),
        lifespan=Duration(seconds=qos.lifespan),
        liveliness=LivelinessPolicy[qos.liveliness.upper()],
        liveliness_lease_duration=Duration(seconds=qos.liveliness_lease_duration),
    )


@pytest.fixture(params=["cyclone", "ros"])
def sides(request: pytest.FixtureRequest, robot: Domain, pc: Domain) -> Iterator[tuple[Any, Any]]:
    """A program in the robot's domain, and one in the PC's."""
    if request.param == "ros":
        yield Stock(robot), Stock(pc)
    else:
        with closing(CycloneProgram(robot.id)) as near, closing(CycloneProgram(pc.id)) as far:
            yield near, far


def crossed(writer: Any, reader: Any, messages: list[str]) -> None:
    """Send these messages once a first one has shown that the route is open."""

    def is_open() -> bool:
        writer.publish("first")
        return bool(reader.texts)

    eventually(is_open)
    for each in messages:
        writer.publish(each)
    eventually(lambda: reader.texts[-len(messages) :] == messages)


@pytest.mark.parametrize("qos", [Qos(), BEST_EFFORT, LATCHED, ALL], ids=["reliable", "best_effort", "latched", "all"])
def test_messages_cross_in_both_directions(bridge: Bridge, sides: tuple[Any, Any], qos: Qos) -> None:
    near, far = sides
    up, down = near.writer("/up", qos), far.writer("/down", qos)
    bridge.both(Topic("/up", "transmit"), Topic("/down", "receive"))
    heard_up, heard_down = far.reader("/up", qos), near.reader("/down", qos)
    messages = ["a", "", "ä" * 40_000, "b"]
    crossed(up, heard_up, messages)
    crossed(down, heard_down, messages)


def test_large_messages_cross(bridge: Bridge, sides: tuple[Any, Any]) -> None:
    """From Fast DDS to Cyclone DDS, the first large one is usually lost, also without a bridge.

    At 20 Hz, a busy machine with the usual socket buffers loses all, also without a bridge (docs/support.md).
    """
    near, far = sides
    writer, reader = near.writer("/large"), far.reader("/large")
    bridge.both(Topic("/large", "transmit"))
    for large in "x" * 1_000_000, "y" * 3_000_000:
        published_at = float("-inf")

        def has_crossed(large: str = large) -> bool:
            nonlocal published_at
            if time.monotonic() > published_at + 1.0:
                writer.publish(large)
                published_at = time.monotonic()
            return large in reader.texts

        eventually(has_crossed)


def test_late_joiner_hears_latched_history(bridge: Bridge, sides: tuple[Any, Any]) -> None:
    near, far = sides
    writers = near.writer("/up", LATCHED), far.writer("/down", LATCHED)
    for number in range(7):
        for each in writers:
            each.publish(str(number))
    bridge.both(Topic("/up", "transmit"), Topic("/down", "receive"))
    for reader in far.reader("/up", LATCHED), near.reader("/down", LATCHED):
        eventually(lambda reader=reader: reader.texts == ["2", "3", "4", "5", "6"])


def test_nothing_of_keep_all_is_lost(bridge: Bridge, sides: tuple[Any, Any]) -> None:
    near, far = sides
    writer, reader = near.writer("/all", ALL), far.reader("/all", ALL)
    bridge.both(Topic("/all", "transmit"))
    crossed(writer, reader, [str(number) for number in range(500)])


def test_timed_policies_reach_far_side(bridge: Bridge, sides: tuple[Any, Any], pc: Domain) -> None:
    near, _ = sides
    near.writer("/timed", Qos(deadline=2.0, lifespan=4.0, liveliness="manual_by_topic", liveliness_lease_duration=3.0))
    bridge.both(Topic("/timed", "transmit"))
    offered = eventually(lambda: pc.node.get_publishers_info_by_topic("/timed"))[0].qos_profile
    assert [offered.deadline, offered.lifespan, offered.liveliness_lease_duration] == [
        Duration(seconds=seconds) for seconds in (2, 4, 3)
    ]
    assert offered.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC


def test_lifespan_with_old_stamps_loses_nothing(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """A publisher's clock may be wrong, and RustDDS stamps nothing: Fast DDS drops them by the lifespan of a reader."""
    with closing(CycloneProgram(robot.id)) as near:
        writer = near.writer("/stale", Qos(lifespan=2.0))
        bridge.both(Topic("/stale", "transmit"))
        reader = _StockReader(pc.listener("/stale"))

        def crosses() -> bool:
            writer.publish("a", time.time_ns() - 3600 * 10**9)
            return bool(reader.texts)

        eventually(crosses)


def test_program_is_named_as_no_node(bridge: Bridge, robot: Domain) -> None:
    with closing(CycloneProgram(robot.id)) as near:
        near.writer("/silent")
        _, client = bridge.both(Topic("/silent", "transmit"))
        expected = f"{BARE_DDS} {PUBLISHED_NOTHING[0]}"
        eventually(lambda: route(client, "/silent").reason == expected)


APART = {
    "ownership": ([Policy.Ownership.Exclusive], UnmatchedText.REFUSED),
    "representation": ([XCDR2], UnmatchedText.REFUSED),
    "partition": ([Policy.Partition(["cell"])], UnmatchedText.OTHER),
    "key": ([KEYED], UnmatchedText.KEY),
}


@pytest.mark.parametrize("policy", APART)
def test_writer_that_does_not_match_is_named(bridge: Bridge, robot: Domain, pc: Domain, policy: str) -> None:
    policies, why = APART[policy]
    with closing(CycloneProgram(robot.id)) as near:
        writer = near.writer("/apart", USUAL, *policies)
        server, client = bridge.both(Topic("/apart", "transmit"))
        expected = f"{BARE_DDS} does not match the bridge: {why()}"
        eventually(lambda: route(client, "/apart").reason == expected)
        eventually(lambda: expected in route(server, "/apart").reason)
        for side in server, client:
            found = route(side, "/apart")
            assert (found.state, found.cause, is_wrong(found)) == ("unheard", Cause.UNMATCHED, True)
        writer.publish("a")
        if policy != "key":  # one program has one type on a topic
            crossed(near.writer("/apart"), _StockReader(pc.listener("/apart")), ["b"])
            eventually(lambda: route(client, "/apart").state == "ok")


@pytest.mark.parametrize("policy", APART)
def test_reader_that_does_not_match_is_named(bridge: Bridge, robot: Domain, pc: Domain, policy: str) -> None:
    policies, why = APART[policy]
    with closing(CycloneProgram(pc.id)) as far:
        reader = far.reader("/apart", USUAL, *policies)
        writer = _StockWriter(robot.publisher("/apart"))
        server, client = bridge.both(Topic("/apart", "transmit"))
        expected = f"{BARE_DDS} does not match the bridge: {why()}"

        def is_named() -> bool:
            writer.publish("a")
            return route(server, "/apart").reason == expected

        eventually(is_named)
        eventually(lambda: expected in route(client, "/apart").reason)
        for side in server, client:
            found = route(side, "/apart")
            assert (found.state, found.cause, is_wrong(found)) == ("unheard", Cause.UNMATCHED, True)
        assert [each.reason for each in route(server, "/apart").audience.deaf] == [DeafText.UNMATCHED(why=why())]
        assert not reader.texts
        if policy != "key":
            crossed(writer, far.reader("/apart"), ["b"])
            eventually(lambda: route(server, "/apart").state == "ok")


def test_caller_that_names_its_writer_is_answered(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """As ros2-client does."""

    def answer(_: Any, response: Any) -> Any:
        response.message = "done"
        return response

    with closing(Spun(pc.id, "server")) as server, closing(CycloneProgram(robot.id)) as near:
        server.node.create_service(SetBool, "/switch", answer)
        bridge.both(Topic("/switch", "transmit", kind="service"))
        caller = near.caller("/switch")

        def is_answered() -> bool:
            caller.call()
            return "done" in caller.answers

        eventually(is_answered)


def test_program_that_is_killed_returns(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    server, client = bridge.both(Topic("/numbers", "transmit"))
    listener = pc.listener("/numbers")
    command = [sys.executable, "-m", "tests.support.cyclone", str(robot.id), "/numbers"]
    for _ in range(2):
        listener.forget()
        with subprocess.Popen(command, cwd=Path(__file__).parents[2]) as program:
            heard(listener, 5)
            program.kill()
        eventually(lambda: route(client, "/numbers").cause in {Cause.NO_PUBLISHER, Cause.PUBLISHER_GONE})
        eventually(lambda: route(server, "/numbers").cause in {Cause.NO_PUBLISHER, Cause.PUBLISHER_GONE})


MORE_DURABLE = {"transient": Policy.Durability.Transient, "persistent": Policy.Durability.Persistent}


@pytest.mark.parametrize("kind", MORE_DURABLE)
def test_more_durable_writer_is_latched_from_now_on(bridge: Bridge, robot: Domain, pc: Domain, kind: str) -> None:
    """Cyclone DDS gives a subscription of ROS no history of it."""
    with closing(CycloneProgram(robot.id)) as near:
        writer = near.writer("/durable", USUAL, MORE_DURABLE[kind])
        writer.publish("before")
        server, client = bridge.both(Topic("/durable", "transmit"))
        early = _StockReader(pc.listener("/durable", qos=_profile(LATCHED)))
        eventually(lambda: writer.matched)
        for words in "a", "b":
            writer.publish(words)
        eventually(lambda: early.texts[-2:] == ["a", "b"])
        late = _StockReader(pc.listener("/durable", qos=_profile(LATCHED)))
        eventually(lambda: late.texts[-2:] == ["a", "b"])
        writer.publish("c")
        eventually(lambda: late.texts[-3:] == early.texts[-3:] == ["a", "b", "c"])
        eventually(lambda: (route(client, "/durable").state, route(server, "/durable").state) == ("ok", "ok"))


@pytest.mark.parametrize("kind", MORE_DURABLE)
def test_reader_that_asks_for_more_durability_is_named(bridge: Bridge, robot: Domain, pc: Domain, kind: str) -> None:
    with closing(CycloneProgram(pc.id)) as far:
        far.reader("/durable", USUAL, MORE_DURABLE[kind])
        robot.publisher("/durable", qos=_profile(LATCHED))
        server, client = bridge.both(Topic("/durable", "transmit"))
        eventually(lambda: route(server, "/durable").cause == route(client, "/durable").cause == Cause.QOS_INCOMPATIBLE)
        found = route(server, "/durable")
        assert (found.state, is_wrong(found)) == ("unheard", True)
        assert f"asks for {DURABLE}" in found.reason


def test_nameless_subscription_of_another_type_is_a_note(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """As ros2-client's subscriptions to /clock, which nobody can correct."""
    with closing(CycloneProgram(pc.id, is_node=True)) as far:
        server, client = bridge.both(Topic("/ticks", "transmit"))
        crossed(_StockWriter(robot.publisher("/ticks")), _StockReader(pc.listener("/ticks")), ["a"])
        far.reader("/ticks", USUAL, TIME)
        for side in server, client:
            eventually(lambda side=side: route(side, "/ticks").cause == Cause.TYPE_CONFLICT)
            assert is_wrong(route(side, "/ticks"))
        with constants.NAMED_WITHIN.during(0.0):
            for side in server, client:
                eventually(lambda side=side: route(side, "/ticks").state == "ok")
                assert "of no known node has builtin_interfaces/msg/Time" in route(side, "/ticks").reason


def test_keyed_type_that_is_not_installed_is_refused(bridge: Bridge, robot: Domain) -> None:
    """No subscription there would match what a bridge without the type publishes."""
    with closing(CycloneProgram(robot.id)) as near:
        near.writer("/named", USUAL, NAMED, HASHED)
        server, client = bridge.both(Topic("/named", "transmit"))
        expected = TypeClash.KEYED(type="made_up_msgs/msg/Named", package=package_of("made_up_msgs"))
        for side in server, client:
            eventually(lambda side=side: expected in route(side, "/named").reason)
            assert (route(side, "/named").state, is_wrong(route(side, "/named"))) == ("down", True)

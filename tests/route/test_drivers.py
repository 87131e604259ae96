"""Several drivers of one robot are named on both sides, with the rates that the sender counts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.route.gates_helpers import armed
from tests.route.loop_filter_helpers import FIRST, SCAN, SECOND, Graph, World, world, world_of
from tests.support.judged import topic_verdict
from tests.support.offline import half_of
from tests.support.reports import told_words

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Driver, Level, State
from rsb_bridge.model.verdict import Cause, Verdict, worse
from rsb_bridge.ros.announcements import BY_HAND, Origin
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Endpoint, RawMessage
from rsb_bridge.route.combined_verdict import Announcer
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.wire.records import DriverRecord, ReceivedCounts, ReceivedReport, SentReport

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

__all__ = ["world"]
TWIST, CMD_VEL = "geometry_msgs/msg/Twist", "/cmd_vel"
SEVERAL, FINE = (State.OK, Cause.SEVERAL_PUBLISHERS), (State.OK, "")
TELEOP, JOYSTICK = Driver("/teleop", here=True, rate=0.0), Driver("/joystick", here=True, rate=0.0)
BESIDE = Driver("/nav", here=False)


class Velocities(Graph):
    """A graph whose topic moves a robot."""

    def publishers(self, topic: str) -> list[Endpoint]:
        return [each._replace(type_name=TWIST) for each in super().publishers(topic)]


@pytest.fixture
def driven(loop: VirtualLoop, make_context: Callable[..., Context]) -> World:
    graph = Velocities()
    return world_of(graph, make_context(graph), loop)


def looked(world: World) -> tuple[Driver, ...]:
    world.sender.route.tick()
    return world.sender.route.snapshot().drivers


def says(world: World) -> tuple[State, str]:
    snapshot = world.sender.route.snapshot()
    return snapshot.state, snapshot.cause


def other(world: World) -> None:
    world.graph.nodes[SECOND] = "/joystick"
    world.sender.route.advance()


def moves(world: World) -> None:
    """Have the publishers that are there publish at 10 Hz and 5 Hz for some seconds; all of it arrives."""
    for number in range(50):
        if number % 10 == 0:
            count = len(world.sent)
            world.sender.reported(ReceivedReport(route=1, subscribers=1))
            world.sender.reported(ReceivedCounts(route=1, received=count, delivered=count, newest=count))
            world.sender.route.tick()
        for gid in (FIRST, SECOND)[: 1 + number % 2]:
            if gid in world.graph.nodes:
                world.path.offer([RawMessage(b"moves", world.context.stamps.now(), gid)])
        world.wait(0.1)


def test_topic_that_moves_nothing_has_no_drivers(world: World) -> None:
    gates = len(world.path.gates.arriving)
    other(world)
    moves(world)
    assert (looked(world), len(world.path.gates.arriving)) == ((), gates)


def test_second_publisher_is_named_and_is_no_fault_when_it_leaves(world: World) -> None:
    for _ in range(4):
        moves(world)
    assert says(world) == FINE
    other(world)
    for _ in range(5):
        moves(world)
    found = world.sender.route.snapshot()
    assert says(world) == SEVERAL
    assert found.expected_rate == pytest.approx(15.0, rel=0.1)
    assert "/joystick and /talker" in found.reason
    del world.graph.nodes[SECOND]
    world.sender.route.advance()
    for _ in range(4):
        moves(world)
        assert says(world) == FINE
        assert world.sender.route.snapshot().expected_rate == pytest.approx(10.0, rel=0.1)


def test_each_driver_here_has_its_rate(driven: World) -> None:
    driven.graph.nodes[FIRST] = "/teleop"
    other(driven)
    moves(driven)
    rates = {each.name: each.rate for each in looked(driven) if each.here}
    assert rates == {"/teleop": pytest.approx(10.0, abs=1.0), "/joystick": pytest.approx(5.0, abs=1.0)}
    assert says(driven) == SEVERAL
    del driven.graph.nodes[SECOND]
    driven.sender.route.advance()
    assert [each.name for each in looked(driven)] == ["/teleop"]
    assert says(driven) == FINE


def test_driver_that_stops_is_silent_within_seconds(driven: World) -> None:
    moves(driven)
    for _ in range(4):
        driven.wait(1.0)
        driven.sender.route.tick()
    assert {each.rate for each in looked(driven)} == {0.0}


def test_hands_and_links_are_told_from_nodes(driven: World) -> None:
    announcements = driven.context.announcements
    crossing = [True]
    for gid, link, via, live in (
        (b"hand", BY_HAND, (), True),
        (b"two", "robot2", ("_rsb_robot2_1/scan",), True),
        (b"rest", "robot3", (), True),
        (b"dead", "robot4", ("_rsb_robot4_1/scan",), False),
    ):
        endpoint = Endpoint("/rsb", TWIST, "", Qos(), gid)
        announcements.announce(SCAN, link, endpoint, Origin(via, live), lambda: crossing[0])
    driven.sender.route.advance()
    found = [(each.name, each.by_hand) for each in looked(driven)]
    assert found == [("/talker", False), ("link robot2", False), ("", True)]
    crossing[0] = False  # as somebody disarms the other link
    assert [each.name for each in looked(driven)] == ["/talker", ""]


def test_other_side_is_told_and_tells(driven: World) -> None:
    moves(driven)
    looked(driven)
    report = told_words(driven.sender)
    assert {each.name: each.rate for each in report.drivers} == {"/talker": pytest.approx(10.0, abs=1.0)}
    assert says(driven) == FINE
    driven.sender.reported(ReceivedReport(route=1, drivers=(DriverRecord("/nav"),)))
    assert looked(driven)[1:] == (BESIDE,)
    assert says(driven) == SEVERAL
    driven.sender.reported(ReceivedReport(route=1))
    looked(driven)
    assert says(driven) == FINE


class Motors(NoRos):
    """The robot's graph, which a test changes."""

    def __init__(self) -> None:
        self.nodes: list[str] = []

    def publishers(self, topic: str) -> list[Endpoint]:
        return [Endpoint(node, TWIST, "", Qos(), node.encode()) for node in self.nodes]


@pytest.mark.parametrize(
    ("name", "arming", "named"),
    [(SCAN, False, ()), (SCAN, True, ("/nav", "link robot2")), (CMD_VEL, False, ("/nav", "link robot2"))],
)
def test_receiver_names_drivers_beside_its_link(
    name: str, arming: bool, named: tuple[str, ...], make_context: Callable[..., Context]
) -> None:
    graph = Motors()
    context = make_context(graph)
    receiver = half_of(Receiver, context, Topic(name, "receive"))
    receiver.route.open(1)
    receiver.route.on_accepted()
    if arming:
        armed(receiver.route.arming, context)
    graph.nodes = ["/nav"]
    for link in ("robot1", "robot2"):
        endpoint = Endpoint("/rsb", TWIST, "", Qos(), link.encode())
        context.announcements.announce(name, link, endpoint, Origin((f"_rsb_{link}_1{name}",)))
    receiver.route.advance()
    assert tuple(each.name for each in receiver.route.snapshot().drivers) == named
    records = tuple(DriverRecord(each) for each in named)
    report = told_words(receiver)
    assert report.drivers == records


@pytest.mark.parametrize("rate", [float("nan"), float("inf"), -1.0, 1e300])
def test_impossible_rates_of_peer_are_unknown(rate: float, make_context: Callable[..., Context]) -> None:
    receiver = half_of(Receiver, make_context(), Topic(CMD_VEL, "receive"))
    receiver.route.open(1)
    receiver.reported(SentReport(route=1, drivers=(DriverRecord("/teleop", rate),)))
    assert receiver.route.snapshot().drivers == (Driver("/teleop", here=False),)


@pytest.mark.parametrize("sends", [True, False])
@pytest.mark.parametrize("others", [{}, {"limit": 10.0}])
def test_note_is_no_fault(sends: bool, others: dict[str, Any]) -> None:
    facts: dict[str, Any] = {"sends": sends, "accepted": True, "crossing": Crossing.YES, "came": True, **others}
    facts |= {"endpoints": [Endpoint("/a", TWIST, "", Qos(), b"a")], "drivers": (TELEOP, BESIDE)}
    found = topic_verdict(**facts)
    assert (found.state, found.cause) == SEVERAL
    assert all(each in found.text for each in ("/teleop here", "/nav there"))
    assert len(found.text) <= 80


def test_note_explains_no_silence() -> None:
    silent = Verdict(State.STALE, Cause.SILENT, "nothing")
    note = Verdict(State.OK, Cause.SEVERAL_PUBLISHERS, "/a and /b")
    assert worse(note, silent) == (silent, False)
    assert worse(silent, note) == (silent, True)


def test_records_are_bounded() -> None:
    decoder = msgspec.msgpack.Decoder(SentReport)
    encoded = msgspec.msgpack.encode(SentReport(route=1, drivers=tuple(DriverRecord(f"/{at}") for at in range(17))))
    with pytest.raises(msgspec.ValidationError):
        decoder.decode(encoded)


def test_note_is_logged_once_and_no_fault() -> None:
    announcer = Announcer()
    note = Verdict(State.OK, Cause.SEVERAL_PUBLISHERS, "/a and /b")
    said = [announcer.announce(note, float(second)) for second in range(200)]
    events = [each for each in said if each is not None]
    assert [(each.code, each.level) for each in events] == [(EventCode.ROUTE_SEVERAL_PUBLISHERS, Level.INFO)]
    fault = Verdict(State.STALE, Cause.PUBLISHER_SILENT, "nothing")
    found = [announcer.announce(fault, 200.0 + second) for second in range(10)]
    found += [announcer.announce(note, 210.0 + second) for second in range(10)]
    codes = [each.code for each in found if each is not None]
    assert codes == [EventCode.ROUTE_FAULT, EventCode.ROUTE_RECOVERED, EventCode.ROUTE_SEVERAL_PUBLISHERS]

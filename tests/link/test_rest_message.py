"""The last message at a robot after an arming has ended, however it ends, is its rest; nothing that moves follows."""

from __future__ import annotations

import asyncio
import struct
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import msgspec
import pytest
from tests.link.arming_helpers import CONSOLE, arm, events, let_time_pass, propose, route
from tests.link.route_table_helpers import hear_all, pair_of
from tests.support.reports import told_counts

from rsb_bridge.cdr.known_types import resting, stamped, velocity_of
from rsb_bridge.model.calls import FieldError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.session import ArmedName, Topic
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import RosError, TopicSpec
from rsb_bridge.route.arming import CONSOLE_SILENT_AFTER, ArmingPhase, Disarmed
from rsb_bridge.route.lease import LASTS
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.rest_message import EVERY, HOLDS, TIMES
from rsb_bridge.route.topic_flow import AgreedEnd
from rsb_bridge.wire.framing import LEASED
from rsb_bridge.wire.headers import with_number
from rsb_bridge.wire.messages import Describe
from rsb_bridge.wire.records import Source

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.model.calls import Fields
    from rsb_bridge.model.session import Direction
    from rsb_bridge.route.route import Route

BEGIN = b"\0\1\0\0"
TWIST = "geometry_msgs/msg/Twist"
POSE = "geometry_msgs/msg/PoseStamped"
MOVES = BEGIN + struct.pack("<6d", 0.2, 0, 0, 0, 0, 0.5)
RESTS = BEGIN + bytes(48)
STAYS = BEGIN + struct.pack("<6d", 0.1, 0, 0, 0, 0, 0)
DEADMAN = 30.0
REST_OVER = EVERY * TIMES
OnEnd: TypeAlias = "str | dict[str, Any] | None"
SILENT = "demands nothing"


class Heard(NamedTuple):
    """A message that the robot's nodes heard.

    Attributes:
        at: s.
    """

    at: float
    payload: bytes


class Robot(NoRos):
    """The robot's ROS, which notes what is published.

    Attributes:
        heard: by the robot's nodes.
        open_at_rest: whether a publisher of a message that moves was open when another message came.
        voices: all publishers so far.
    """

    def __init__(self, loop: VirtualLoop) -> None:
        super().__init__()
        self.installed = (TWIST, POSE)
        self.heard: list[Heard] = []
        self.voices: list[Voice] = []
        self.open_at_rest = False
        self._loop = loop

    def advertise(self, spec: TopicSpec, origin: Hashable) -> Voice:
        self.voices.append(Voice(self, self._loop, len(self.voices) + 1))
        return self.voices[-1]

    def serialize(self, type_name: str, fields: Fields, now: int) -> bytes:
        if type_name not in self.installed:
            raise RosError("it is not installed")
        assert isinstance(fields, dict)
        fields = dict(fields)
        header = fields.pop("header", None)
        if header is not None and type_name == TWIST:
            raise FieldError("it has no header")
        if fields.keys() - {"x"}:
            raise FieldError("it has no such field")
        stamp = struct.pack("<iI", *divmod(now, 10**9)) if header else b""
        return BEGIN + stamp + struct.pack("<6d", float(str(fields.get("x", 0))), 0, 0, 0, 0, 0)


class Voice:
    acknowledged = True
    refuses = False

    def __init__(self, robot: Robot, loop: VirtualLoop, number: int) -> None:
        self.gid = bytes([number]) * 16
        self._robot, self._loop = robot, loop
        self.subscriber_count = 1
        self.is_open, self.has_moved = True, False

    def assert_liveliness(self) -> None:
        pass

    def publish(self, payload: bytes) -> None:
        assert self.is_open
        if bytes(payload) == MOVES:
            self.has_moved = True
        else:
            self._robot.open_at_rest |= any(each.is_open and each.has_moved for each in self._robot.voices)
        self._robot.heard.append(Heard(self._loop.time(), bytes(payload)))

    def close(self) -> None:
        self.is_open = False


class Driven:
    """A robot, which is the client, and a control PC, whose operator has armed the topic.

    Attributes:
        robot: the robot's ROS.
    """

    def __init__(
        self,
        loop: VirtualLoop,
        make_context: Callable[..., Context],
        kind: str = TWIST,
        on_end: OnEnd = None,
        there: OnEnd = SILENT,
        *,
        serves: bool = False,
    ) -> None:
        """Arm it.

        Args:
            on_end: of the robot's session, or None if it only demands that the topic is armed.
            there: the same of the control PC's session.
            serves: whether the robot is the server. A client demands it by an entry, a server by a pattern.
        """
        self.robot, self._loop = Robot(loop), loop
        of_client, of_server = (there, on_end) if serves else (on_end, there)
        armed = () if of_server == SILENT else (ArmedName("/cmd_*", deadman=DEADMAN, on_end=of_server),)
        client = make_context(ros=None if serves else self.robot)
        server = make_context(ros=self.robot if serves else None, role="server", armed=armed)
        self.pair = pair_of(client, server)
        propose(self.pair[0], self.entry(kind, of_client, direction="transmit" if serves else "receive"))
        hear_all(self.pair)
        _, pc = self.pair = self.pair[::-1] if serves else self.pair
        self.kind = kind
        self.describe()
        if not self.receiver.route.id:
            return  # it is refused
        arm(pc).result()
        let_time_pass(self.pair, 0.5)

    @staticmethod
    def entry(kind: str, on_end: OnEnd, direction: Direction = "receive") -> Topic:
        if on_end == SILENT:
            return Topic("/cmd_vel", direction, type=kind)
        return Topic("/cmd_vel", direction, arm=True, deadman=DEADMAN, type=kind, on_end=on_end)

    def describe(self, qos: Qos | None = None) -> None:
        description = Describe(
            self.receiver.route.id, self.kind, "RIHS01_" + "0" * 64, qos or Qos(), (Source(("there",)),)
        )
        self.pair[0].table.handle(description)

    @property
    def receiver(self) -> Receiver:
        half = route(self.pair[0]).half
        assert isinstance(half, Receiver)
        return half

    def drive(self, payload: bytes = MOVES, by: Route | None = None, number: int | None = None) -> None:
        by = by or self.receiver.route
        lease = by.arming.lease
        assert lease is not None
        by.deliver([(with_number(number or lease.number, payload), by.context.stamps.now(), LEASED)])

    def wait(self, seconds: float) -> None:
        self._loop.run_until_complete(asyncio.sleep(seconds))

    @property
    def payloads(self) -> list[bytes]:
        return [each.payload for each in self.robot.heard]


@pytest.fixture
def make_driven(loop: VirtualLoop, make_context: Callable[..., Context]) -> Callable[..., Driven]:
    return partial(Driven, loop, make_context)


@pytest.fixture
def driven(make_driven: Callable[..., Driven]) -> Driven:
    made = make_driven()
    made.drive()
    assert made.payloads == [MOVES]
    return made


def by_an_operator(driven: Driven, at: int) -> None:
    driven.pair[at].table.arming.disarm(route(driven.pair[at]), Disarmed.OPERATOR)


def by_a_pause(driven: Driven, at: int) -> None:
    driven.pair[at].table.pause(route(driven.pair[at]), paused=True)


def by_removal(driven: Driven, at: int) -> None:
    driven.pair[at].remove()


def by_reloading(driven: Driven, at: int) -> None:
    driven.pair[at].table.arming.disarm_all(Disarmed.RELOADED)


def by_reopening(driven: Driven, at: int) -> None:
    route(driven.pair[at]).channel_lost(Reason("cut", EndCode.BROKE))


def by_the_links_end(driven: Driven, at: int) -> None:
    driven.pair[0].linked = False
    driven.pair[0].table.disconnected()


def by_the_consoles_end(driven: Driven, at: int) -> None:
    driven.pair[1].table.arming.gone(CONSOLE)


@pytest.mark.parametrize("at", [0, 1], ids=["on the robot", "on the control PC"])
@pytest.mark.parametrize(
    "ends",
    [
        by_an_operator,
        by_a_pause,
        by_removal,
        by_reloading,
        by_reopening,
        by_the_links_end,
        by_the_consoles_end,
    ],
)
def test_robot_rests_at_once_however_it_is_disarmed(
    ends: Callable[[Driven, int], None], at: int, driven: Driven, loop: VirtualLoop
) -> None:
    began, opening = loop.time(), driven.receiver.route
    lease = opening.arming.lease
    assert lease is not None
    number = lease.number
    ends(driven, at)
    hear_all(driven.pair)
    assert driven.robot.heard[1:] == [(began, RESTS)]
    assert not driven.robot.open_at_rest
    for _ in range(20):
        driven.drive(by=opening, number=number)  # messages that were in flight
        driven.wait(0.05)
    rests = driven.robot.heard[1:]
    assert {each.payload for each in rests} == {RESTS}
    assert len(rests) == TIMES
    assert rests[-1].at - began == pytest.approx(EVERY * (TIMES - 1), abs=0.01)
    assert not loop.errors


def test_robot_rests_once_sides_are_apart(driven: Driven, loop: VirtualLoop) -> None:
    """Nothing is disarmed yet: the two may hear each other again, and then it goes on."""
    began = loop.time()
    driven.wait(LASTS + 0.1)
    assert driven.payloads[1:2] == [RESTS]
    assert driven.robot.heard[1].at - began <= LASTS + 0.01
    assert driven.receiver.route.arming.phase is ArmingPhase.ARMED
    let_time_pass(driven.pair, 1.0)
    driven.drive()
    let_time_pass(driven.pair, 1.0)
    assert driven.payloads[-1] == MOVES


@pytest.mark.parametrize("at", [0, 1], ids=["on the robot", "on the control PC"])
def test_robot_rests_when_time_of_arming_is_over(
    at: int, loop: VirtualLoop, make_driven: Callable[..., Driven]
) -> None:
    """To the moment, and not at the next tick: here the console is silent, before the deadman's time is over."""
    driven = make_driven()
    if at == 0:
        by_an_operator(driven, 1)
        hear_all(driven.pair)
        driven.describe()
        arm(driven.pair[0]).result()
        let_time_pass(driven.pair, 0.5)
    armed_at = loop.time() - 0.5
    for _ in range(int(CONSOLE_SILENT_AFTER / 0.05) + 10):
        driven.drive()
        driven.wait(0.05)
        hear_all(driven.pair)
    rests = [each for each in driven.robot.heard if each.payload == RESTS]
    assert rests[0].at - armed_at == pytest.approx(CONSOLE_SILENT_AFTER, abs=0.15)
    assert driven.robot.heard[-1].payload == RESTS


def test_velocity_holds_for_second_without_further_message(driven: Driven, loop: VirtualLoop) -> None:
    """The message that would have stopped the robot may have been lost, though both sides hear each other."""
    for _ in range(2):
        let_time_pass(driven.pair, 0.9 * HOLDS)
        driven.drive()
    assert set(driven.payloads) == {MOVES}
    moved = loop.time()
    let_time_pass(driven.pair, HOLDS + REST_OVER + 0.1)
    rests = [each for each in driven.robot.heard if each.payload == RESTS]
    assert len(rests) == TIMES
    assert HOLDS <= rests[0].at - moved < HOLDS + 0.05
    driven.drive()
    assert driven.payloads[-1] == MOVES
    driven.drive(RESTS)
    let_time_pass(driven.pair, 2 * HOLDS)
    assert driven.payloads[-2:] == [MOVES, RESTS], "no rest follows a rest"


def test_message_that_moves_nothing_holds_for_good(make_driven: Callable[..., Driven]) -> None:
    driven = make_driven(POSE, on_end={"x": 0.1, "header": "auto"})
    driven.drive()
    let_time_pass(driven.pair, 3 * HOLDS)
    assert driven.payloads == [MOVES]


def test_resting_robot_hears_no_more(driven: Driven) -> None:
    driven.drive(RESTS)
    by_an_operator(driven, 0)
    driven.wait(1.0)
    assert driven.payloads == [MOVES, RESTS]


def test_robot_rests_despite_changed_publishers(driven: Driven) -> None:
    """A node there, or an operator, publishes with another QoS, and so has the robot's own topic from then on."""
    driven.describe(Qos(depth=3, deadline=1.0))
    let_time_pass(driven.pair, 0.5)
    by_an_operator(driven, 0)
    assert driven.payloads == [MOVES, RESTS]


def move_by_hand(driven: Driven, qos: Qos) -> None:
    driven.receiver.rest.prepare(TopicSpec("/cmd_vel", TWIST, "RIHS01_" + "0" * 64, qos))
    driven.receiver.rest.moved_by_hand(MOVES, driven.robot.voices[-1])


def test_robot_moved_by_hand_rests_despite_node(
    make_driven: Callable[..., Driven],
) -> None:
    driven = make_driven()
    move_by_hand(driven, Qos(depth=7))
    driven.describe(Qos(depth=3, deadline=1.0))
    by_an_operator(driven, 0)
    assert driven.payloads == [RESTS]


def test_nothing_is_published_where_nothing_has_moved(make_driven: Callable[..., Driven]) -> None:
    driven = make_driven()
    by_an_operator(driven, 0)
    driven.wait(1.0)
    assert driven.payloads == []


def test_next_arming_s_first_message_ends_rest(driven: Driven) -> None:
    """Not the arming itself: the first rest may have come before a subscription had found its publisher."""
    by_an_operator(driven, 0)
    hear_all(driven.pair)
    driven.describe()
    arm(driven.pair[1]).result()
    let_time_pass(driven.pair, 2 * EVERY)
    assert driven.payloads[-2:] == [RESTS, RESTS]
    driven.drive()
    count = len(driven.payloads)
    assert count < 1 + TIMES
    let_time_pass(driven.pair, 1.0)
    assert len(driven.payloads) == count


def test_hand_and_nodes_share_rests_publisher(driven: Driven) -> None:
    """Subscriptions take some time to find a publisher, which a rest has not."""
    before = len(driven.robot.voices)
    for qos in (Qos(depth=3), Qos(depth=7, reliability="best_effort")):
        move_by_hand(driven, qos)
    assert len(driven.robot.voices) == before
    by_an_operator(driven, 0)
    assert driven.payloads[-1] == RESTS


def test_a_type_that_moves_nothing_has_no_rest(make_driven: Callable[..., Driven]) -> None:
    driven = make_driven("std_msgs/msg/String")
    driven.drive(BEGIN + b"\x02\0\0\0a\0")
    by_an_operator(driven, 0)
    driven.wait(1.0)
    assert len(driven.payloads) == 1


ENDS: list[tuple[str, OnEnd, OnEnd, str]] = [
    (TWIST, None, SILENT, "zero"),
    (TWIST, None, None, "zero"),
    (TWIST, None, "none", "zero"),
    (TWIST, None, {"x": 1.0}, "zero"),
    (TWIST, SILENT, None, "zero"),
    (TWIST, SILENT, "zero", "zero"),
    (TWIST, SILENT, "none", "zero"),
    (TWIST, SILENT, {"x": 1.0}, "zero"),
    (TWIST, "zero", "none", "zero"),
    (TWIST, "zero", {"x": 1.0}, "zero"),
    (TWIST, "none", SILENT, "none"),
    (TWIST, "none", None, "zero"),
    (TWIST, "none", "none", "none"),
    (TWIST, "none", "zero", "zero"),
    (TWIST, "none", {"x": 1.0}, "zero"),
    (TWIST, {"x": 0.1}, SILENT, '{"x": 0.1}'),
    (TWIST, {"x": 0.1}, "zero", '{"x": 0.1}'),
    (TWIST, {"x": 0.1}, {"x": 1.0}, '{"x": 0.1}'),
    (POSE, None, {"x": 1.0}, "none"),
    (POSE, None, "zero", "none"),
    (POSE, "none", {"x": 1.0}, "none"),
    (POSE, SILENT, {"x": 1.0}, "none"),
    (POSE, "zero", {"x": 1.0}, "zero"),
    (POSE, {"x": 0.1}, {"x": 1.0}, '{"x": 0.1}'),
]
"""Types, the words of the robot's and the control PC's session, and what the robot gets."""
RESTS_OF = {"zero": RESTS, '{"x": 0.1}': STAYS}
"""The rests that the robot hears."""


@pytest.mark.parametrize("serves", [False, True], ids=["client", "server"])
@pytest.mark.parametrize(("kind", "on_end", "there", "gets"), ENDS)
def test_a_peer_may_only_stop_the_robot(
    kind: str,
    on_end: OnEnd,
    there: OnEnd,
    gets: str,
    serves: bool,
    make_driven: Callable[..., Driven],
) -> None:
    driven = make_driven(kind, on_end, there, serves=serves)
    driven.drive()
    assert driven.receiver.facts.on_end == gets
    by_an_operator(driven, 0)
    driven.wait(1.0)
    bodies = [BEGIN + each[-48:] for each in driven.payloads[1:]]
    assert bodies == ([RESTS_OF[gets]] * TIMES if gets in RESTS_OF else [])


@pytest.mark.parametrize(("kind", "on_end", "there", "gets"), ENDS)
def test_both_sides_show_the_same_end(
    kind: str, on_end: OnEnd, there: OnEnd, gets: str, make_driven: Callable[..., Driven]
) -> None:
    driven = make_driven(kind, on_end, there)
    assert AgreedEnd(route(driven.pair[1])).of(kind) == gets == driven.receiver.facts.on_end


@pytest.mark.parametrize("serves", [False, True], ids=["client", "server"])
def test_a_foreign_edit_gives_no_motion(serves: bool, make_driven: Callable[..., Driven]) -> None:
    """The control PC's operator edits its entry, or its session is read again, while the topic is armed."""
    driven = make_driven(TWIST, None, "zero", serves=serves)
    driven.drive()
    pc = driven.pair[1]
    if serves:
        pc.change(route(pc), on_end={"x": 1.0})
    else:
        session = msgspec.structs.replace(pc.context.session, armed=(ArmedName("/cmd_*", on_end={"x": 1.0}),))
        pc.context.session = session
        pc.context.demands.changed()
        pc.context.demands.apply()
    for _ in range(5):  # until the proposing side opens it again
        let_time_pass(driven.pair, 1.0)
    hear_all(driven.pair)
    driven.describe()
    arm(pc).result()
    let_time_pass(driven.pair, 0.5)
    driven.drive()
    by_an_operator(driven, 0)
    driven.wait(1.0)
    assert driven.payloads == [MOVES, *[RESTS] * TIMES] * 2


@pytest.mark.parametrize(
    ("on_end", "there", "is_logged"),
    [
        (None, SILENT, False),
        (None, None, False),
        (None, "zero", False),
        (None, "none", True),
        (None, {"x": 1.0}, True),
        (SILENT, "zero", True),
        ("none", "zero", True),
        ("none", None, True),
        ({"x": 0.1}, SILENT, False),
    ],
)
def test_a_foreign_end_is_logged(
    on_end: OnEnd, there: OnEnd, is_logged: bool, make_driven: Callable[..., Driven]
) -> None:
    driven = make_driven(TWIST, on_end, there)
    driven.describe()
    assert len(events(driven.pair[0], EventCode.ROUTE_OTHER_END)) == is_logged


def test_a_message_has_a_fresh_stamp_each_time(make_driven: Callable[..., Driven]) -> None:
    driven = make_driven(POSE, {"x": 0.1})
    driven.drive()
    by_an_operator(driven, 0)
    driven.wait(1.0)
    stamps = [struct.unpack_from("<iI", each, 4) for each in driven.payloads[1:]]
    assert len(set(stamps)) == TIMES


def test_zero_of_another_type_has_its_defaults(make_driven: Callable[..., Driven]) -> None:
    driven = make_driven(POSE, "zero")
    driven.drive()
    by_an_operator(driven, 0)
    driven.wait(1.0)
    assert {each[12:] for each in driven.payloads[1:]} == {bytes(48)}


@pytest.mark.parametrize(("kind", "on_end"), [(TWIST, {"y": 0.1}), ("a_msgs/msg/Speed", "zero")])
def test_unfitting_message_is_refused_before_motion(
    kind: str, on_end: str | dict[str, Any], make_driven: Callable[..., Driven]
) -> None:
    driven = make_driven(kind, on_end)
    assert "on_end" in driven.receiver.route.life.refusal.text
    assert not any(voice.is_open for voice in driven.robot.voices), "a refused topic has no publisher"


def test_the_velocity_that_the_robot_has_is_reported(driven: Driven) -> None:
    """To the other side, and at once as far as it begins or ceases to move."""
    there = route(driven.pair[1])

    def shown() -> list[tuple[float, float] | None]:
        if (counts := told_counts(driven.receiver)) is not None:
            there.half.reported(counts)
        found = [each.snapshot().arming for each in (driven.receiver.route, there)]
        return [None if each is None else each.velocity for each in found]

    assert shown() == [(0.2, 0.5)] * 2
    soon = driven.pair[0].reported
    soon.clear()
    driven.drive()
    assert not soon
    driven.drive(RESTS)
    driven.drive()
    assert len(soon) == 2
    by_an_operator(driven, 0)
    assert len(soon) == 3
    assert driven.receiver.facts.velocity == (0.0, 0.0)


def test_a_velocity_nobody_hears_is_not_reported(driven: Driven) -> None:
    assert driven.receiver.facts.velocity == (0.2, 0.5)
    for voice in driven.robot.voices:
        voice.subscriber_count = 0
    assert driven.receiver.facts.velocity is None
    driven.drive(RESTS)
    assert driven.receiver.facts.velocity == (0.0, 0.0)


@pytest.mark.parametrize(
    ("type_name", "message", "velocity"),
    [
        (TWIST, MOVES, (0.2, 0.5)),
        (TWIST, b"\0\0\0\0" + struct.pack(">6d", 0.2, 0, 0, 0, 0, 0.5), (0.2, 0.5)),
        (TWIST, MOVES[:-1], None),
        (TWIST, b"", None),
        (TWIST, BEGIN + struct.pack("<6d", float("nan"), 0, 0, 0, 0, 0), None),
        ("std_msgs/msg/String", MOVES, None),
    ],
)
def test_the_velocity_of_a_message(type_name: str, message: bytes, velocity: tuple[float, float] | None) -> None:
    assert velocity_of(type_name, message) == velocity


def header(frame: bytes, sec: int = 5) -> bytes:
    return BEGIN + struct.pack("<iII", sec, 6, len(frame) + 1) + frame + b"\0"


def padded(payload: bytes, to: int) -> bytes:
    return payload + bytes(-(len(payload) - 4) % to)


@pytest.mark.parametrize(
    ("type_name", "message", "rest"),
    [
        (TWIST, MOVES, RESTS),
        (
            "geometry_msgs/msg/TwistStamped",
            padded(header(b"base"), 8) + struct.pack("<6d", 1, 2, 3, 4, 5, 6),
            padded(header(b"base"), 8) + bytes(48),
        ),
        ("ackermann_msgs/msg/AckermannDrive", BEGIN + struct.pack("<5f", 1, 2, 3, 4, 5), BEGIN + bytes(20)),
        (
            "ackermann_msgs/msg/AckermannDriveStamped",
            padded(header(b"b"), 4) + struct.pack("<5f", 1, 2, 3, 4, 5),
            padded(header(b"b"), 4) + bytes(20),
        ),
        (
            "sensor_msgs/msg/Joy",
            padded(header(b"joy1"), 4) + struct.pack("<I2fI3i", 2, 0.5, -1.0, 3, 1, 0, 1),
            padded(header(b"joy1"), 4) + struct.pack("<I2fI3i", 2, 0.0, 0.0, 3, 0, 0, 0),
        ),
    ],
)
def test_rest_has_header_and_lengths_of_message(type_name: str, message: bytes, rest: bytes) -> None:
    assert resting(type_name, message) == rest
    assert resting(type_name, rest) == rest
    fresh = stamped(type_name, rest, 7_000_000_008)
    assert (fresh == rest) == (type_name in (TWIST, "ackermann_msgs/msg/AckermannDrive"))
    assert fresh == rest or struct.unpack_from("<iI", fresh, 4) == (7, 8)
    assert len(fresh) == len(rest)


@pytest.mark.parametrize("type_name", ["geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/Joy"])
def test_a_malformed_message_has_no_rest(type_name: str) -> None:
    assert resting(type_name, b"\0\1") is None
    assert resting(type_name, BEGIN + bytes(8) + b"\xff\xff\xff\x7f") is None
    assert resting("sensor_msgs/msg/Joy", padded(header(b""), 4) + struct.pack("<I", 9)) is None

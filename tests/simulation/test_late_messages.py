"""After a gap a robot gets no old command, and what tells a state is live at once; other messages keep their pace."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import pytest
from tests.simulation.beds import Yard, until
from tests.simulation.ros import hash_of
from tests.support.long import long

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import EditTopic
from rsb_bridge.model.motion import LATEST
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Sequence

    from tests.simulation.engine_host import EngineHost

    from rsb_bridge.model.snapshot import Ledger
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.route import Route

TWIST, JOINTS = "geometry_msgs/msg/Twist", "sensor_msgs/msg/JointState"
_NUMBERS = "std_msgs/msg/Float64MultiArray"
_HZ = 50
_NEVER = 1e9
_ON_THE_WAY = 0.2
"""s that a message takes at most between the nodes and the bridges, and on the path."""
_GAP, _BEFORE, _AFTER = 5.0, 8.0, 12.0
_LIVE_WITHIN = 0.4


class Heard(NamedTuple):
    made: float
    at: float

    @property
    def age(self) -> float:
        return self.at - self.made


class Course(Yard):
    """A robot, a server, and a topic of 50 Hz from one to the other, which goes through a gap.

    Attributes:
        heard: when each message was made, and when it came.
        made: how many there were.
        back: when the gap ended.
        ledger: of both sides, at the end.
        left_out: the events of each side about commands that were left out.
    """

    ledger: Ledger
    left_out: list[list[str]]

    def __init__(
        self,
        topic: Topic,
        name: str = "",
        type_name: str = TWIST,
        qos: Qos = Qos(),  # noqa: B008
        *,
        lister: str = "robot",
    ) -> None:
        super().__init__(*([topic] if lister == "robot" else []))
        if lister == "server":
            self.list_on_server(topic)
        for host in (self.robot, self.server):
            host.session = msgspec.structs.replace(host.session, outlive=60.0)
        self.topic, self.name, self.lister = topic, name or topic.topic, lister
        self.heard: list[Heard] = []
        self.made = 0
        self.back = 0.0
        entry = msgspec.structs.replace(topic, topic=self.name)
        self._flow = flow = self.world.add_topic_flow(self.world.robots[0], entry, self.world.random("flow"))
        flow.type_name, flow.qos, flow.period = type_name, qos, _NEVER
        for host in (self.robot, self.server):
            host.domain.installed[type_name] = hash_of(type_name)
        self._check_heard = flow._heard
        flow._heard = self._hear  # type: ignore[method-assign]

    @property
    def source(self) -> EngineHost:
        return self.robot if self.topic.direction == "transmit" else self.server

    @property
    def sink(self) -> EngineHost:
        return self.server if self.topic.direction == "transmit" else self.robot

    @property
    def host_of_list(self) -> EngineHost:
        return self.robot if self.lister == "robot" else self.server

    def route(self, host: EngineHost) -> Route:
        return self.routes(on_server=host is self.server)[self.name]

    def play(self, gap: Callable[[Course], Coroutine[None, None, None]]) -> None:
        self.world.play(life=self.live(self._through(gap)))

    async def _through(self, gap: Callable[[Course], Coroutine[None, None, None]]) -> None:
        talk = asyncio.ensure_future(self._talk())
        with self.world.trouble("a gap", *self.world.robots):
            await until(lambda: len(self.heard) > _HZ, 60.0)
            await asyncio.sleep(_BEFORE)
            await gap(self)
            self.back = self.world.loop.time()
            await asyncio.sleep(_AFTER)
        talk.cancel()
        # Until the last report has come, messages count as under way.
        await until(lambda: self._snapshot(self.source).open == 0, 10.0)
        await until(lambda: self._snapshot(self.source) == self._snapshot(self.sink), 10.0)
        self.ledger, self.left_out = self._snapshot(self.source), [*map(self._left_out, (self.robot, self.server))]

    def _snapshot(self, host: EngineHost) -> Ledger:
        return self.route(host).snapshot().ledger

    def _left_out(self, host: EngineHost) -> list[str]:
        assert host.run is not None
        return [each.text for each in host.run.events.after(0) if each.code == EventCode.ROUTE_COMMANDS_LEFT_OUT]

    async def _talk(self) -> None:
        while True:
            self._flow.publish()
            self.made += 1
            await asyncio.sleep(1 / _HZ)

    def _hear(self, batch: Sequence[RawMessage]) -> None:
        self._check_heard(batch)
        now = self.world.loop.time()
        self.heard += [Heard(self._flow.made_at(each.payload) or 0.0, now) for each in batch]

    @property
    def oldest(self) -> float:
        return max(each.age for each in self.heard)

    @property
    def late(self) -> list[float]:
        """When messages came after the gap that had waited."""
        return [each.at for each in self.heard if each.age > _ON_THE_WAY and each.at >= self.back]

    @property
    def live_after(self) -> float:
        """Seconds from the gap's end until a message came that was younger than 0.2 s."""
        return next(each.at for each in self.heard if each.at > self.back and each.age < _ON_THE_WAY) - self.back


# --- gaps


async def _cut(course: Course, seconds: float) -> None:
    ends = course.robot.machine, course.server.machine
    course.world.network.cut(*ends)
    await asyncio.sleep(seconds)
    course.world.network.heal(*ends)


async def cut(course: Course) -> None:
    """Nothing passes, until both sides have given up the connection and after."""
    await _cut(course, _GAP)


async def short_cut(course: Course) -> None:
    await _cut(course, 2.0)


async def half_open(course: Course) -> None:
    """Nothing passes towards the listener, and all passes back."""
    ends = course.source.machine, course.sink.machine
    course.world.network.cut_one_way(*ends)
    await asyncio.sleep(_GAP)
    course.world.network.heal(*ends)


async def _stop(course: Course, host: EngineHost) -> None:
    assert host.run is not None
    process = host.run.process
    course.world.loop.freeze(process)
    await asyncio.sleep(3.0)
    course.world.loop.thaw(process, reads_first=True)


async def receiver_stops(course: Course) -> None:
    await _stop(course, course.sink)


async def sender_stops(course: Course) -> None:
    """Its messages wait in DDS."""
    await _stop(course, course.source)


async def _edited(course: Course, **keys: Any) -> None:
    host = course.host_of_list
    run, route = host.run, course.route(host)
    assert run is not None
    await run.command(run.bridge.do(EditTopic(route.key, msgspec.structs.replace(route.spec, **keys))), "anna")
    await asyncio.sleep(2.0)


async def edited(course: Course) -> None:
    """It may be late until an edit."""
    await _edited(course, max_age=None)
    await cut(course)


async def reloaded(course: Course) -> None:
    """It may be late by an edit until its file is read again."""
    await _edited(course, max_age=0.0)
    host = course.host_of_list
    run = host.run
    assert run is not None
    await run.command(run.bridge.reload(host.session, host.keys, dry_run=False), "anna")
    await asyncio.sleep(2.0)
    await cut(course)


GAPS = (cut, short_cut, half_open, receiver_stops, sender_stops)
_KEEP_ALL = Qos(history="keep_all")
_BEST_EFFORT = Qos(reliability="best_effort")


def check_commands(course: Course) -> None:
    """Check that nothing old came, and that both sides say so in the same line with the number of the account."""
    assert course.oldest <= LATEST + _ON_THE_WAY
    assert course.live_after < 3.0
    ledger = course.ledger
    assert ledger.offered == ledger.delivered + ledger.expired + sum(ledger.dropped.values())


@pytest.mark.parametrize("gap", GAPS, ids=lambda gap: gap.__name__)
@pytest.mark.parametrize("protocol", ["tcp", "udp"])
@pytest.mark.parametrize("direction", ["receive", *long("transmit")])
def test_no_old_command_comes_after_gap(gap: Any, protocol: Any, direction: Any) -> None:
    course = Course(Topic("/cmd_vel", direction, protocol=protocol))
    course.play(gap)
    check_commands(course)


@pytest.mark.parametrize(
    ("topic", "name", "type_name", "qos"),
    [
        (Topic("/base/**", "transmit"), "/base/out", TWIST, Qos()),
        (Topic("/forward_position_controller/commands", "transmit"), "", _NUMBERS, Qos()),
        (Topic("/arm/*", "receive"), "/arm/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", Qos()),
        (Topic("/pad", "receive", qos=1), "", "sensor_msgs/msg/Joy", Qos(depth=1)),
        (Topic("/cmd_vel", "receive", qos={"history": "keep_all"}), "", TWIST, _KEEP_ALL),
        (Topic("/cmd_vel", "receive", qos={"reliability": "best_effort"}), "", TWIST, _BEST_EFFORT),
    ],
)
@pytest.mark.parametrize("lister", ["robot", "server"])
def test_each_kind_of_command_comes_live(topic: Topic, name: str, type_name: str, qos: Qos, lister: str) -> None:
    """By type or name, of an entry or a pattern of either side."""
    if topic.is_pattern and lister == "server":
        topic = msgspec.structs.replace(topic, direction="receive")
    course = Course(topic, name, type_name, qos, lister=lister)
    course.play(cut)
    check_commands(course)


@pytest.mark.parametrize(("gap", "first"), [(edited, 0.0), (reloaded, None)])
def test_changed_session_counts_at_next_gap(gap: Any, first: float | None) -> None:
    course = Course(Topic("/cmd_vel", "receive", max_age=first))
    course.play(gap)
    check_commands(course)


def test_one_line_says_how_many_were_left_out() -> None:
    course = Course(Topic("/cmd_vel", "receive"))
    course.play(cut)
    ledger = course.ledger
    lost = ledger.offered - ledger.delivered
    assert lost > (_GAP - 1) * _HZ
    assert [[int(text.split()[1]) for text in texts] for texts in course.left_out] == [[lost], [lost]]


@pytest.mark.parametrize(
    ("keys", "all_wait"),
    [({"max_age": 0.0, "qos": {"history": "keep_all"}}, True), ({"keep": 60.0}, True), ({"max_age": 30.0}, False)],
)
def test_session_decides_about_late_commands(keys: dict[str, Any], all_wait: bool) -> None:
    """With an age of its own, still only the newest waits: a robot would follow all the old ones before it."""
    course = Course(Topic("/cmd_vel", "receive", **keys), qos=_KEEP_ALL)
    course.play(cut)
    assert course.oldest > _GAP - 1.0
    assert (course.made - len(course.heard) <= 1) == all_wait


# --- what tells a state


@pytest.mark.parametrize("gap", [cut, short_cut, half_open, receiver_stops], ids=lambda gap: gap.__name__)
@pytest.mark.parametrize("protocol", ["tcp", "udp"])
@pytest.mark.parametrize("direction", ["transmit", *long("receive")])
def test_state_is_live_at_once(gap: Any, protocol: Any, direction: Any) -> None:
    course = Course(Topic("/joints", direction, protocol=protocol, qos=500), type_name=JOINTS, qos=Qos(depth=500))
    course.play(gap)
    late = course.late
    assert late, "nothing waited"
    assert late[-1] - late[0] <= _LIVE_WITHIN
    made = [each.made for each in course.heard]
    assert made == sorted(made)
    assert course.made - len(made) <= 1  # all were given to DDS, in order
    assert len(set(late)) > 10  # and not at one stroke


@pytest.mark.parametrize(("keys", "qos"), [({"keep": 60.0}, Qos()), ({"qos": {"history": "keep_all"}}, _KEEP_ALL)])
def test_what_is_wanted_whole_keeps_its_pace(keys: dict[str, Any], qos: Qos) -> None:
    course = Course(Topic("/joints", "transmit", **keys), type_name=JOINTS, qos=qos)
    course.play(cut)
    late = course.late
    assert late[-1] - late[0] > 1.0
    assert course.made - len(course.heard) <= 1

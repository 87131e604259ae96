"""Actions over a bridge, in worlds where nothing happens but what is made to happen."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import msgspec
import pytest
from tests.simulation import faults
from tests.simulation.action_invariants import halves_of, left_at_rest, said
from tests.simulation.action_server import Plan
from tests.simulation.beds import Bed, until
from tests.simulation.conditions import STILL
from tests.simulation.conftest import bed_of
from tests.simulation.services import Server
from tests.simulation.world import World
from tests.support import replaced
from tests.support.long import long

from rsb_bridge.model.commands import ArmTopic, DisarmTopic
from rsb_bridge.model.session import Topic
from rsb_bridge.route.lease import LeasePhase

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from tests.simulation.action_flow import ActionFlow
    from tests.simulation.engine_host import EngineHost
    from tests.simulation.goals import Goal

    from rsb_bridge.route.calls.caller import Caller
    from rsb_bridge.route.calls.provider import Provider

_SETTLED = 60.0
"""s after which no server that was killed is seen any more, and every goal has been answered or given up."""
SIDES = ("server", "client")


class Court(Bed):
    """One action of a robot's session, its server and its client.

    Args:
        provider: which side has the server.
    """

    def __init__(self, provider: str, seed: int = 1, outlive: float = 0.0, **spec: Any) -> None:
        self.world = World(seed, replace(STILL, topics=(0,), checks=(1.0, 2.0), outlive=outlive))
        (robot,) = self.world.robots
        self.robot = robot
        action = Topic("/do", "transmit" if provider == "server" else "receive", kind="action", **spec)
        robot.host.session = msgspec.structs.replace(robot.host.session, topics=(action,))
        self.action: ActionFlow = self.world.add_action_flow(robot, action, 0.0)
        ends: tuple[EngineHost, EngineHost] = robot.host, self.world.server
        self.near, self.far = ends if provider == "server" else ends[::-1]

    async def begin(self) -> None:
        if self.action.topic.arm:
            self.action.troubles["not armed at times"] += 1
            await super().begin()
            await self.arm()
        await until(lambda: self.action.ready, 30.0)

    async def arm(self) -> None:
        await self._do(ArmTopic, self.near)

    def callers(self) -> Caller | Provider:
        """Return the callers' half."""
        return next(half for half in halves_of(self.world, self.action) if half.outgoing)

    async def disarm(self, host: EngineHost) -> None:
        await self._do(DisarmTopic, host)

    async def _do(self, command: type[ArmTopic | DisarmTopic], host: EngineHost) -> None:
        run = host.run
        assert run is not None
        (route,) = [route for link in run.links() for route in link.routes.values()]
        await run.command(run.bridge.do(command(route.key)))

    async def live(self, life: Coroutine[None, None, None]) -> None:
        """Run a test, and wait until everything that it leaves behind is forgotten."""
        await super().live(life)
        self.action.rest()
        await until(lambda: not self.action.goes_on, 250.0)
        await asyncio.sleep(_SETTLED)
        halves = halves_of(self.world, self.action)
        assert len(halves) == 2
        for half in halves:
            if left := left_at_rest(half):
                self.world.wrong(f"at rest, {half.route.key} still has {left}; {said(self.world, self.action)}")

    async def goal(self, **plan: Any) -> Goal:
        goal = self.action.send(Plan(**plan))
        assert goal is not None
        await until(lambda: goal.told, 5.0)
        return goal

    @contextlib.contextmanager
    def cut(self) -> Iterator[None]:
        ends = self.near.machine, self.far.machine
        with self.world.trouble("cut", self.robot):
            self.world.network.cut(*ends)
            yield
            self.world.network.heal(*ends)

    async def restart(self, host: EngineHost) -> None:
        with self.world.trouble("killed", self.robot):
            host.kill()
            await asyncio.sleep(2.0)
            host.start()


@pytest.fixture
def court(request: pytest.FixtureRequest) -> Court:
    return Court(**bed_of(request))


@pytest.mark.parametrize("provider", SIDES)
@pytest.mark.bed(outlive=60.0)
async def test_goal_that_was_accepted_goes_on_over_cut(provider: str, court: Court) -> None:
    """Its result is there though the action server forgets it after 10 s; another's is not taken for it."""
    goals = [await court.goal(runs=runs, state=state) for runs, state in ((3.0, "aborted"), (50.0, "succeeded"))]
    with court.cut():
        await asyncio.sleep(40.0)
        assert [each.state for each in goals] == ["aborted", ""]
        assert not goals[0].result
        assert not court.action.server.remembers(goals[0].id)  # type: ignore[union-attr]
    await until(lambda: goals[0].result, 15.0)
    await until(lambda: goals[1].result, 30.0)
    assert [each.result for each in goals] == ["aborted", "succeeded"]


@pytest.mark.parametrize("provider", SIDES)
@pytest.mark.bed(outlive=60.0)
async def test_cancel_of_a_cut_waits_for_its_end(provider: str, court: Court) -> None:
    first, second = await court.goal(runs=300.0), await court.goal(runs=100.0)
    with court.cut():
        await asyncio.sleep(10.0)
        court.action.cancel(first)
        assert first.cancel is not None
        asked_at = first.cancel.at
        await asyncio.sleep(20.0)
        assert not first.cancelled
    await until(lambda: first.result, 15.0)
    assert (first.result, first.cancel.at) == ("canceled", asked_at), "its client has not asked again"
    assert not second.result


@pytest.mark.parametrize("provider", SIDES)
@pytest.mark.parametrize("end", ["near", "far", "cut"])
@pytest.mark.bed(arm=True, deadman=0.0, outlive=60.0)
async def test_end_of_arming_loses_no_caller(provider: str, end: str, court: Court) -> None:
    """A client's cancel and its requests for results are under way then, and it asks nothing twice."""
    court.action.asks_again = False
    first, second = await court.goal(runs=300.0), await court.goal(runs=30.0)
    for path in court.world.network.both_ways(court.near.machine, court.far.machine):
        path.latency = (0.2, 0.2)
    court.action.cancel(first)
    await asyncio.sleep(0.05)
    if end == "cut":
        with court.cut():
            await asyncio.sleep(15.0)
    else:
        await court.disarm(getattr(court, end))
    await until(lambda: first.result, 15.0)
    await until(lambda: second.result, 30.0)
    assert [each.result for each in (first, second)] == ["canceled", "succeeded"]
    calls = court.callers().flow.calls
    assert calls.lost == calls.in_flight == 0
    await court.arm()
    await until(lambda: court.action.ready, 5.0)
    await court.goal(runs=1.0)


@pytest.mark.parametrize("provider", SIDES)
@pytest.mark.bed(arm=True, deadman=0.0, outlive=20.0)
async def test_calls_are_lost_with_their_association(provider: str, court: Court) -> None:
    court.action.asks_again = False
    goal = await court.goal(runs=100.0)
    calls = court.callers().flow.calls
    with court.cut():
        await asyncio.sleep(15.0)
        assert (calls.in_flight, calls.lost) == (1, 0)
        await asyncio.sleep(20.0)
        assert (calls.in_flight, calls.lost) == (0, 1)
    await until(lambda: court.action.answers, 30.0)
    court.action.ask_result(goal)
    await until(lambda: goal.result, 90.0)


@pytest.mark.parametrize("provider", SIDES)
@pytest.mark.parametrize("goes_on", [pytest.param(True, marks=pytest.mark.bed(outlive=60.0)), False])
async def test_goal_on_its_way_begins_once_or_never(provider: str, goes_on: bool, court: Court) -> None:
    """If the association goes on, both goals begin. Else the late one never does, and nobody hears of the other."""
    came = court.action.send(Plan(after=15.0, runs=5.0))
    assert came is not None
    await until(lambda: came.arrived, 5.0)
    with court.cut():
        late = court.action.send()
        assert late is not None
        await asyncio.sleep(20.0)
        assert came.server is not None
    if goes_on:
        await until(lambda: came.result == late.result == "succeeded", 30.0)
    assert (came.told, late.told) == ((True, True) if goes_on else (None, None))
    assert (came.arrived, late.arrived) == (1, goes_on)
    await until(lambda: all(half.flow.calls.in_flight == 0 for half in halves_of(court.world, court.action)), 45.0)
    await until(lambda: court.action.ready, 30.0)
    await court.goal(runs=1.0)  # the server reports that it has no other goals


@pytest.mark.parametrize("provider", SIDES)
@pytest.mark.parametrize("end", ["near", "far"])
async def test_client_asks_again_after_bridge_restarts(provider: str, end: str, court: Court) -> None:
    """The goal goes on, but whatever was asked about it is lost with the bridge."""
    goal = await court.goal(runs=60.0)
    cancelled = await court.goal(runs=300.0)
    await court.restart(getattr(court, end))
    await until(lambda: court.action.ready, 30.0)
    court.action.cancel(cancelled)
    await until(lambda: cancelled.result, 30.0)
    assert cancelled.result == "canceled"
    await until(lambda: goal.result, 90.0)
    assert (goal.result, goal.arrived) == ("succeeded", 1)


@pytest.mark.parametrize("provider", SIDES)
@pytest.mark.bed(timeout=4.0)
async def test_result_may_take_its_time_long_after_its_goal(provider: str, court: Court) -> None:
    goal = await court.goal(runs=0.1)
    await until(lambda: goal.result, 5.0)
    await asyncio.sleep(8.0)
    for path in court.world.network.both_ways(court.near.machine, court.far.machine):
        path.latency = (1.5, 1.5)
    court.action.ask_result(goal)
    await until(lambda: court.action.answered == 2, 3.5)


@pytest.mark.bed(provider="client", timeout=2.0)
async def test_server_that_does_not_answer_leaves_nothing_behind(court: Court) -> None:
    for _ in range(5):
        court.action.send(Plan(after=None))
    await asyncio.sleep(5.0)
    expired = [half.flow.calls.expired for half in halves_of(court.world, court.action)]
    assert expired == [5, 5]
    await court.goal(runs=1.0)  # the server reports that it has no other goals


@pytest.mark.parametrize("provider", SIDES)
async def test_goal_asked_in_vain_leaves_nothing(provider: str, court: Court) -> None:
    goal = court.action.send(Plan(after=None))
    assert goal is not None
    await until(lambda: goal.arrived, 5.0)
    with court.cut():
        await asyncio.sleep(10.0)
    await until(lambda: all(half.flow.calls.lost for half in halves_of(court.world, court.action)), 45.0)
    await until(lambda: court.action.ready, 30.0)
    await court.goal(runs=1.0)  # the server reports that it has no other goals
    assert goal.arrived == 1


@pytest.mark.parametrize("provider", SIDES)
@pytest.mark.bed(timeout=100.0)
async def test_server_that_is_replaced_unseen_leaves_nothing_behind(provider: str, court: Court) -> None:
    """Others see the server that was killed until after the next one is there: at no time is there none."""
    goal = court.action.send(Plan(after=None))
    assert goal is not None
    await until(lambda: goal.arrived, 5.0)
    court.action.vanish(killed=True)
    court.action.appear()
    await asyncio.sleep(1.0)
    court.action.vanish()  # it may have got the call, too, as it was there when the bridge looked next
    await asyncio.sleep(1.0)
    court.action.appear()
    await until(lambda: not court.action.dead_is_seen, 60.0)
    await until(lambda: all(half.flow.calls.lost for half in halves_of(court.world, court.action)), 5.0)
    await court.goal(runs=1.0)  # the server reports that it has no other goals


@pytest.mark.parametrize("seed", [1, 2, *long(3, 4, 5, 6)])
def test_nothing_is_left_over_after_course_of_faults(seed: int) -> None:
    """Links drop, bridges and servers are killed, at either end, while goals are sent, and cancelled, all the time."""
    court = Court(SIDES[seed % 2], seed, timeout=(None, 5.0)[seed // 2 % 2])
    action, world = court.action, court.world

    async def live() -> None:
        action.busy(2.0)
        random = world.random("course")
        courses: list[Callable[[], Coroutine[None, None, None]]] = [
            lambda: faults.cut(world, court.robot, random),
            lambda: faults.cut(world, court.robot, random),
            lambda: faults.kill(world, court.robot, random),
            lambda: faults.kill(world, None, random),
            lambda: faults.server_ends(world, action, random),
            lambda: faults.server_dies(world, action, random),
            lambda: faults.offer_fails(world, action, random),
        ]
        with patch.object(faults, "duration", lambda random: random.uniform(0.5, 20.0)):
            for _ in range(8):
                await random.choice(courses)()
                await asyncio.sleep(random.uniform(0.0, 25.0))
        assert action.answered > 10
        action.rest()
        await until(lambda: not action.goes_on, 250.0)
        await asyncio.sleep(_SETTLED)
        # A goal whose call was given up counts as running until the server's next status message. A server that has
        # replaced another unseen publishes none before its first goal.
        await court.goal(runs=1.0)

    court.world.play(life=court.live(live()))


@pytest.mark.parametrize("mistaken", [False, True], ids=["as it is", "one answer begins the lease"])
def test_a_goal_right_after_arming_is_accepted(mistaken: bool) -> None:
    """A goal that is sent at once may overtake what keeps the lease."""
    court = Court("server", arm=True, deadman=0.0, max_age=0.0)
    told: list[bool | None] = []

    async def live() -> None:
        await asyncio.sleep(10.0)
        court.world.network.path(court.near.machine, court.far.machine).latency = (0.0, 0.4)
        run, services = court.near.run, court.far.domain.services
        assert run is not None
        for _ in range(6):
            (route,) = [route for link in run.links() for route in link.routes.values()]
            arms = court.world.loop.create_task(run.command(run.bridge.do(ArmTopic(route.key))))
            while (goal := court.action.send(Plan(runs=0.1))) is None:
                Server(services, "/passer_by", "/else", "std_srvs/srv/Empty", "", lambda _: None).close()
                await asyncio.sleep(0.02)  # the providing side has reasons to look at its graph meanwhile
            await arms
            await asyncio.sleep(3.0)
            told.append(goal.told)
            await run.command(run.bridge.do(DisarmTopic(route.key)))
            await asyncio.sleep(3.0)

    async def troubled() -> None:
        with court.world.flow_trouble(court.action, "armed at times"):
            await live()

    with contextlib.ExitStack() as stack:
        if mistaken:
            too_soon = property(lambda lease: lease.phase in (LeasePhase.ANSWERED, LeasePhase.BEGUN))
            stack.enter_context(replaced.LEASE_BEGUN.during(too_soon))
        court.world.play(60.0, troubled())
    assert len(told) == 6
    assert (False in told) == mistaken

"""Arming over the route tables of both sides, on virtual time: any doubt means disarmed."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
from tests.link.arming_helpers import (
    COMMANDS,
    CONSOLE,
    DEADMAN,
    arm,
    events,
    let_time_pass,
    make_armable,
    pair,
    propose,
    route,
    sleep,
    turn,
)
from tests.link.route_table_helpers import Pair, Side, hear_all, pair_of
from tests.route.unpacking_helpers import OnePublisher
from tests.support.wording import pattern

from rsb_bridge.engine.topic_commands import ArmingCommands
from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.link_arming import ArmingProblem
from rsb_bridge.model.calls import Refused
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import ArmTopic, AskHolder, DisarmTopic, TakeArming, acting, on_console
from rsb_bridge.model.demands import DemandSource
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.reason import EndCode
from rsb_bridge.model.session import ArmedName as ArmedEntry
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.route.arming import (
    ANSWERED_WITHIN,
    CONSOLE_SILENT_AFTER,
    PEER_GRACE,
    ArmingPhase,
    Disarmed,
)
from rsb_bridge.route.blocking_rules import blocked
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.gates import GatedMessage, lease_gate
from rsb_bridge.route.lease import LASTS, SLOW
from rsb_bridge.transport.streams import CLOSED_BY_PEER
from rsb_bridge.wire.messages import Arm, Armed, Close, Describe, Disarm, Lease, Pause, Propose, Provide
from rsb_bridge.wire.records import LaneEntry
from rsb_bridge.wire.records import Source as Origin

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

__all__ = ["make_armable", "pair"]


def passes(*sides: Side) -> list[bool]:
    return [route(side).arming.crossing(side.context.now()) is Crossing.YES for side in sides]


def stands(*sides: Side) -> list[bool]:
    return [route(side).arming.crossing(side.context.now()).flows for side in sides]


def why(side: Side, code: EventCode = EventCode.ROUTE_DISARMED) -> str:
    return events(side, code)[-1].cause


@pytest.mark.parametrize("at", [0, 1], ids=["on the robot", "on the control PC"])
def test_message_from_before_arming_is_not_published(at: int, pair: Pair) -> None:
    """The lease goes on from one arming to the next, and a number of the first may still be young."""
    arm(pair[at]).result()
    receiving = pair[0]
    lease = route(receiving).arming.lease
    assert lease is not None
    before = lease.number
    gate = lease_gate(route(receiving).arming)
    assert gate(GatedMessage(0, before), 0.0) is None
    pair[at].table.arming.disarm(route(pair[at]), Disarmed.OPERATOR)
    hear_all(pair)
    arm(pair[at]).result()
    assert lease.passes(before)
    assert gate(GatedMessage(0, before), 0.0) is Refused.DISARMED
    assert gate(GatedMessage(0, lease.number), 0.0) is None


def command(
    side: Side, *, take: bool = False, ask: bool = False, disarm: bool = False, own: bool = False, by: str = CONSOLE
) -> asyncio.Task[None]:
    """Have the bridge arm as `rsb-console arm` does, for a console; the other side hears nothing of it yet.

    Args:
        disarm: disarm instead.
    """

    async def no_motions(_: set[str]) -> None:
        """Nobody drives by hand."""

    role = SimpleNamespace(links=lambda: [side])
    bridge = SimpleNamespace(role=role, find=lambda key: (side, side.routes[key]), end_motions=no_motions)
    commands = ArmingCommands(cast("Any", bridge))
    key = route(side).key

    async def give() -> None:
        with acting("anna"), on_console(by):
            if disarm:
                await commands.disarm(DisarmTopic(key, own))
            elif ask:
                await commands.ask(AskHolder(key))
            else:
                await (commands.take(TakeArming(key)) if take else commands.arm(ArmTopic(key)))

    task = side.context.loop.create_task(give())
    turn(side)
    return task


@pytest.mark.parametrize("take", [False, True], ids=["arm", "take"])
@pytest.mark.parametrize("at", [0, 1], ids=["on the robot", "on the control PC"])
def test_disarmed_topic_is_armed_once_link_moves(at: int, take: bool, pair: Pair) -> None:
    """The link holds the messages about its new opening for a while."""
    side = pair[at]
    arm(side).result()
    side.table.arming.disarm(route(side), Disarmed.OPERATOR)
    task = command(side, take=take)
    sleep(pair[0], 0.8 * ANSWERED_WITHIN)
    assert not task.done()
    let_time_pass(pair, 1.0)
    task.result()
    assert stands(*pair) == [True, True]


@pytest.mark.parametrize("at", [0, 1], ids=["on the robot", "on the control PC"])
def test_topic_that_never_reopens_is_not_awaited(at: int, pair: Pair) -> None:
    side = pair[at]
    arm(side).result()
    side.table.arming.disarm(route(side), Disarmed.OPERATOR)
    task = command(side)
    sleep(pair[0], 1.1 * ANSWERED_WITHIN)
    assert ArmingProblem.NOT_OPEN() in str(task.exception())
    let_time_pass(pair, 1.0)
    assert stands(*pair) == [False, False]


def test_console_gone_before_opening_arms_nothing(pair: Pair) -> None:
    pc = pair[1]
    arm(pc).result()
    pc.table.arming.disarm(route(pc), Disarmed.OPERATOR)
    task = command(pc)
    pc.table.arming.gone(CONSOLE)
    let_time_pass(pair, 1.0)
    assert ArmingProblem.WITHDRAWN(topic="/cmd_vel") in str(task.exception())
    assert stands(*pair) == [False, False]


@pytest.mark.parametrize(
    ("by", "own", "arms"), [(CONSOLE, True, False), ("ben's", False, False), ("ben's", True, True)]
)
def test_topic_disarmed_before_opening_stays_disarmed(by: str, own: bool, arms: bool, pair: Pair) -> None:
    """An operator leaves the screen on which they have armed it, or another one disarms it."""
    pc = pair[1]
    arm(pc).result()
    pc.table.arming.disarm(route(pc), Disarmed.OPERATOR)
    task = command(pc)
    command(pc, disarm=True, own=own, by=by)
    let_time_pass(pair, 1.0)
    assert (task.exception() is None) == arms
    assert stands(*pair) == [arms, arms]


def test_console_gone_before_type_arms_nothing(pair: Pair, loop: VirtualLoop) -> None:
    pc, loop.thread_takes = pair[1], 0.5
    task = command(pc)
    pc.table.arming.gone(CONSOLE)
    let_time_pass(pair, 1.0)
    assert ArmingProblem.WITHDRAWN(topic="/cmd_vel") in str(task.exception())
    assert stands(*pair) == [False, False]


def test_console_gone_before_robot_stands_arms_nothing(pair: Pair) -> None:
    """The taken topic is disarmed all the same."""
    pc = pair[1]
    arm(pc, console="ben's").result()
    task = command(pc, take=True)
    assert not task.done()
    pc.table.arming.gone(CONSOLE)
    let_time_pass(pair, 1.0)
    assert ArmingProblem.WITHDRAWN(topic="/cmd_vel") in str(task.exception())
    assert stands(*pair) == [False, False]


def test_console_gone_before_answer_leaves_holder(pair: Pair) -> None:
    pc = pair[1]
    arm(pc, console="ben's").result()
    task = command(pc, ask=True)
    assert not task.done()
    pc.table.arming.gone(CONSOLE)
    pc.table.questions.answer(route(pc), "ben's", gives=True)
    let_time_pass(pair, 1.0)
    assert ArmingProblem.WITHDRAWN(topic="/cmd_vel") in str(task.exception())
    assert (stands(*pair), route(pc).arming.console) == ([True, True], "ben's")


@pytest.mark.parametrize("at", [0, 1], ids=["on the robot", "on the control PC"])
def test_an_operator_of_either_side_arms_both(at: int, pair: Pair, loop: VirtualLoop) -> None:
    assert passes(*pair) == [False, False]
    arm(pair[at]).result()
    assert passes(*pair) == [True, True]
    here, there = (route(side).arming.snapshot(loop.time()) for side in (pair[at], pair[1 - at]))
    assert here is not None
    assert there is not None
    assert (here.by, here.here, here.left) == ("anna", True, DEADMAN)
    assert (there.by.endswith(": anna"), there.here, there.left) == (True, False, DEADMAN)
    for side in pair:
        (event,) = events(side, EventCode.OPERATOR_ARMED)
        assert (event.who.endswith("anna"), event.topic, event.new) == (True, "/cmd_vel", "armed")


def test_nothing_passes_before_both_sides_agree(pair: Pair) -> None:
    robot, pc = pair
    task = arm(pc, answered=False)
    assert stands(robot, pc) == [False, False]
    robot.hear()
    robot.hear()
    assert route(robot).arming.phase is ArmingPhase.BEGINS, "it has agreed, but has no answer to its own number yet"
    assert not route(robot).crossing.flows
    assert stands(robot, pc) == [False, False]
    assert passes(robot, pc) == [False, False]
    assert route(robot).verdict().state is State.DISARMED
    hear_all(pair)
    turn(pair[0])
    assert task.done()
    assert passes(robot, pc) == [True, True]


def test_side_that_does_not_answer_leaves_it_disarmed(pair: Pair) -> None:
    robot, pc = pair
    task = arm(pc, answered=False)
    robot.inbox.clear()
    for _ in range(6):
        let_time_pass(pair, 1.0)
    turn(pair[0])
    assert isinstance(task.exception(), LinkError)
    assert passes(*pair) == [False, False]
    assert why(pc, EventCode.ROUTE_NOT_ARMED) == Disarmed.NO_ANSWER
    assert not events(pc, EventCode.ROUTE_DISARMED)


@pytest.mark.parametrize("at", [0, 1], ids=["armed on the robot", "armed on the control PC"])
def test_topic_disarms_without_key_in_time(at: int, pair: Pair, loop: VirtualLoop) -> None:
    side, other = pair[at], pair[1 - at]
    arm(side).result()
    for _ in range(int(DEADMAN) - 1):
        side.table.arming.seen(CONSOLE, pressed=False)
        let_time_pass(pair, 1.0)
    assert passes(*pair) == [True, True]
    loop.jump(1.0)
    assert passes(side) == [False]  # not a moment later, tick or not
    assert route(side).snapshot().cause == (Cause.DISARMING if route(side).outgoing else Cause.DISARMED)
    assert route(side).snapshot().reason.startswith(Disarmed.DEADMAN.text)
    let_time_pass(pair, 0.0)
    hear_all(pair)
    assert passes(*pair) == [False, False]
    assert why(side) == why(other) == Disarmed.DEADMAN


def test_key_begins_time_anew_on_both_sides(pair: Pair) -> None:
    robot, pc = pair
    arm(pc).result()
    for second in range(200):
        pc.table.arming.seen(CONSOLE, pressed=second % 20 == 19)
        pc.table.arming.seen("another console", pressed=True)
        let_time_pass(pair, 1.0)
    hear_all(pair)
    assert passes(*pair) == [True, True]
    assert len(events(robot, EventCode.OPERATOR_ARMED)) == 1


def test_other_side_disarms_by_own_clock_without_keys(pair: Pair, loop: VirtualLoop) -> None:
    robot, pc = pair
    arm(pc).result()
    loop.jump(DEADMAN + PEER_GRACE)
    assert passes(robot) == [False]
    robot.table.tick()
    assert why(robot) == Disarmed.DEADMAN


def test_without_deadman_only_console_has_to_be_there(make_armable: Callable[..., Pair]) -> None:
    pair = robot, pc = make_armable(Topic("/cmd_vel", "receive", arm=True, deadman=0.0))
    arm(pc).result()
    for _ in range(100):
        pc.table.arming.seen(CONSOLE, pressed=False)
        let_time_pass(pair, 3.0)
    assert passes(*pair) == [True, True]
    pc.table.arming.gone("another console")
    assert passes(*pair) == [True, True]
    pc.table.arming.gone(CONSOLE)
    hear_all(pair)
    assert passes(*pair) == [False, False]
    assert why(robot) == Disarmed.CONSOLE_GONE


def test_console_without_sign_of_life_is_gone(pair: Pair) -> None:
    robot, pc = pair
    arm(robot).result()
    let_time_pass(pair, CONSOLE_SILENT_AFTER - 0.5)
    assert passes(*pair) == [True, True]
    let_time_pass(pair, 0.5)
    hear_all(pair)
    assert passes(*pair) == [False, False]
    assert why(robot) == why(pc) == Disarmed.CONSOLE_GONE


def test_console_that_expires_leaves_that_as_cause(pair: Pair, loop: VirtualLoop) -> None:
    _, pc = pair
    arm(pc).result()
    loop.jump(DEADMAN)
    pc.table.arming.gone(CONSOLE)
    hear_all(pair)
    assert [why(side) for side in pair] == [Disarmed.DEADMAN, Disarmed.DEADMAN]


def test_lost_link_disarms_and_new_one_stays_disarmed(pair: Pair) -> None:
    robot, pc = pair
    arm(pc).result()
    for side in pair:
        side.linked = False
        side.inbox.clear()
        side.table.disconnected()
    assert passes(*pair) == [False, False]
    sleep(pair[0], LASTS)
    assert why(robot) == why(pc) == Disarmed.LINK_LOST
    for side in pair:
        side.linked = True
        side.table.connected()
    hear_all(pair)
    assert passes(*pair) == [False, False]
    arm(pc).result()
    assert passes(*pair) == [True, True]


@pytest.mark.parametrize("at", [0, 1], ids=["the robot", "the control PC"])
def test_operator_of_either_side_disarms_what_other_armed(at: int, pair: Pair, loop: VirtualLoop) -> None:
    arm(pair[1 - at]).result()
    side = pair[at]
    before = route(side).id
    with acting("bob"):
        side.table.arming.disarm(route(side), Disarmed.OPERATOR)
    assert passes(side) == [False]
    hear_all(pair)
    assert passes(*pair) == [False, False]
    for each in pair:
        (event,) = events(each, EventCode.OPERATOR_DISARMED)
        assert (event.who.endswith("bob"), event.from_peer) == (True, each is not side)
        snapshot = route(each).arming.snapshot(loop.time())
        assert snapshot is not None
        assert (snapshot.armed, snapshot.why) == (False, Disarmed.OPERATOR)
        assert "bob" in snapshot.reason
        assert route(each).id not in (0, before), "opened again: messages in flight belong to another route id"
    arm(side).result()
    assert passes(*pair) == [True, True]


def test_data_connection_may_end_before_next_proposal(pair: Pair) -> None:
    robot, pc = pair
    for _ in range(3):
        arm(robot).result()
        with acting("anna"):
            robot.table.arming.disarm(route(robot), Disarmed.OPERATOR)
        pc.table.handle(pc.inbox.popleft())
        assert route(pc).arming.phase is ArmingPhase.SPENT
        route(pc).channel_lost(CLOSED_BY_PEER)
        hear_all(pair)
    assert not route(pc).losses.repeated


def test_opening_is_armed_once_whatever_peer_says(pair: Pair) -> None:
    """The control PC's own bridge is made to lie: it never opens the route again, and arms it at once."""
    robot, pc = pair
    arm(pc).result()
    opening = route(robot).id
    with acting("bob"):
        robot.table.arming.disarm(route(robot), Disarmed.OPERATOR)
    again = route(robot).id
    assert again != opening
    robot.table.handle(Arm(opening, "a liar"))
    robot.table.handle(Armed(again))
    assert passes(robot) == [False]


def test_who_only_answers_arms_nothing(pair: Pair) -> None:
    robot, _ = pair
    robot.table.handle(Armed(route(robot).id))
    robot.table.handle(Disarm(route(robot).id, "operator", "nobody"))
    assert passes(robot) == [False]
    assert not events(robot, EventCode.OPERATOR_ARMED, EventCode.OPERATOR_DISARMED, EventCode.ROUTE_DISARMED)


def test_side_marks_its_own_topic_whatever_peer_proposes(pair: Pair) -> None:
    """The control PC removes the robot's topic, and proposes it without a mark, from a topic of another name."""
    robot, pc = pair
    pc.table.handle(Close(route(pc).id, "removed", code=EndCode.REMOVED))
    robot.inbox.append(Close(route(robot).id, "removed", code=EndCode.REMOVED))
    hear_all(pair)
    assert not robot.routes
    for number, name in enumerate(("/cmd_vel", "/another")):
        robot.table.handle(Propose(route=100 + 2 * number, topic=name, remote_topic="/cmd_vel", from_client=False))
    assert [each.arming.required for each in robot.routes.values()] == [True, True]
    assert {each.arming.deadman for each in robot.routes.values()} == {DEADMAN}


def test_the_shorter_deadman_of_both_sides_counts(make_armable: Callable[..., Pair]) -> None:
    robot, pc = make_armable(Topic("/other", "receive"))
    propose(pc, Topic("/cmd_vel", "receive", arm=True, deadman=20.0))
    propose(robot, Topic("/cmd_vel", "receive", arm=True, deadman=0.0))
    for _ in range(3):
        let_time_pass((robot, pc), 1.0)
    commands = [each for side in (robot, pc) for each in side.routes.values() if "cmd" in each.key]
    assert [(each.arming.required, each.arming.deadman) for each in commands] == [(True, 20.0)] * 2


@pytest.mark.parametrize("first", [0, 1])
def test_of_two_operators_at_once_client_s_arms(first: int, pair: Pair) -> None:
    robot, pc = pair
    tasks = [arm(pair[at], console=f"console {at}", answered=False) for at in (first, 1 - first)]
    hear_all(pair)
    turn(pair[0])
    assert passes(*pair) == [True, True]
    assert (route(robot).arming.console, route(pc).arming.console) == ("console 0", None)
    assert [task.exception() is None for task in tasks] == [first == 0, first == 1]


def test_pause_reports_disarming_until_nothing_is_published(pair: Pair) -> None:
    _, pc = pair
    arm(pc).result()
    pc.table.pause(route(pc), paused=True)
    assert route(pc).verdict().state is State.DISARMING
    hear_all(pair)
    assert route(pc).verdict().state is State.PAUSED


@pytest.mark.parametrize("at", [0, 1], ids=["on the robot", "on the control PC"])
def test_who_pauses_armed_topic_is_named_twice(at: int, pair: Pair) -> None:
    here, there = pair[at], pair[1 - at]
    arm(there).result()
    with acting("berta"):
        here.table.pause(route(here), paused=True)
    hear_all(pair)
    assert passes(*pair) == [False, False]
    for side in pair:
        assert route(side).pausing.paused
        assert route(side).pausing.who.endswith("berta")
        assert why(side) == Disarmed.PAUSED
    (event,) = events(there, EventCode.OPERATOR_PAUSED)
    assert event.who.endswith("says: berta")
    here.table.pause(route(here), paused=False)
    hear_all(pair)
    assert passes(*pair) == [False, False]


def test_peer_that_pauses_without_disarming_has_disarmed(pair: Pair) -> None:
    robot, pc = pair
    arm(pc).result()
    opening = route(robot).id
    for paused in (True, False):
        robot.table.handle(Pause(opening, paused=paused, revision=1000 + (not paused)))
    assert passes(robot) == [False]
    assert why(robot) == Disarmed.PAUSED


def test_late_mark_counts_on_topic_taken_over(
    make_armable: Callable[..., Pair],
) -> None:
    """The control PC removes the robot's topic and proposes it itself; then the robot's session file gets the mark."""
    robot, pc = pair = make_armable(Topic("/cmd_vel", "receive"))
    pc.table.remove(route(pc), "removed")
    hear_all(pair)
    propose(pc, Topic("/cmd_vel", "receive"))
    hear_all(pair)
    assert passes(*pair) == [True, True]
    propose(robot, COMMANDS)
    assert not route(robot).life.accepted, "closed at once, and opened again with the mark"
    for _ in range(20):
        let_time_pass(pair, 1.0)
    assert route(pc).life.accepted
    assert passes(*pair) == [False, False]
    arm(robot).result()
    assert passes(*pair) == [True, True]


def test_peer_that_arms_too_often_is_refused(pair: Pair) -> None:
    robot, pc = pair
    outcomes: list[Any] = []
    for _ in range(40):
        outcomes.append(arm(pc).exception())
        with acting("a script"):
            pc.table.arming.disarm(route(pc), Disarmed.OPERATOR)
        hear_all(pair)
    assert [error is None for error in outcomes] == [True] * 20 + [False] * 20
    assert len(events(robot, EventCode.OPERATOR_ARMED)) == 20
    for _ in range(30):
        let_time_pass(pair, 1.0)
    arm(pc).result()


@pytest.mark.parametrize(
    ("topic", "prepare"),
    [
        (Topic("/cmd_vel", "receive"), None),
        (COMMANDS, "paused"),
        (COMMANDS, "armed"),
        (COMMANDS, "down"),
    ],
    ids=["need not be", "paused", "armed already", "link down"],
)
def test_what_cannot_be_armed_says_why(topic: Topic, prepare: str | None, make_armable: Callable[..., Pair]) -> None:
    pair = robot, pc = make_armable(topic)
    if prepare == "paused":
        pc.table.pause(route(pc), paused=True)
        hear_all(pair)
    elif prepare == "armed":
        arm(robot).result()
    elif prepare == "down":
        pc.linked = False
    with pytest.raises(LinkError, match=pattern(ArmingProblem.CANNOT)):
        arm(pc, console="another").result()


def test_budget_of_armings_bounds_events_of_attempts(pair: Pair) -> None:
    robot, _ = pair
    robot.table.pause(route(robot), paused=True)
    for _ in range(100):
        robot.table.handle(Arm(route(robot).id, "a console"))
    found = [each.cause for each in events(robot, EventCode.ROUTE_NOT_ARMED)]
    assert set(found) == {Disarmed.PAUSED}
    assert not events(robot, EventCode.ROUTE_DISARMED)
    assert 1 < len(found) < 30


def test_unarmable_topic_says_so_in_advance(pair: Pair) -> None:
    _, pc = pair
    pc.linked = True
    before = blocked(route(pc).half.facts, route(pc).crossing)
    assert before is not None
    assert "rsb-console arm" in before.text
    route(pc).arming.end(Disarmed.LINK_SLOW)
    verdict = blocked(route(pc).half.facts, route(pc).crossing)
    assert verdict == Verdict(State.DISARMED, Cause.DISARMED, Disarmed.LINK_SLOW.text)


def test_link_with_long_round_trip_cannot_be_armed(pair: Pair) -> None:
    robot, pc = pair
    task = arm(pc, answered=False)
    for side in (robot, pc):
        sleep(pair[0], SLOW / 2 + 0.01)
        while side.inbox:
            side.hear()
    hear_all(pair)
    turn(pair[0])
    assert Disarmed.LINK_SLOW.text in str(task.exception())
    assert why(pc, EventCode.ROUTE_NOT_ARMED) == why(robot) == Disarmed.LINK_SLOW  # the robot had armed it
    assert stands(*pair) == [False, False]


@pytest.mark.parametrize("at", [0, 1], ids=["the robot", "the control PC"])
def test_stalled_side_disarms_despite_first_answers(at: int, pair: Pair, loop: VirtualLoop) -> None:
    robot, pc = pair
    arm(pc).result()
    let_time_pass(pair, 2.0)
    loop.jump(LASTS + 0.1)  # neither timers nor messages
    pair[at].table.handle(Lease(number=1000, echo=pair[at].table.arming.lease.state.number))
    assert passes(pair[at]) == [False]
    turn(pair[0])
    hear_all(pair)
    turn(pair[0])
    assert stands(*pair) == [False, False]
    sleep(pair[0], LASTS)
    assert why(robot) == why(pc) == Disarmed.LEASE


def test_the_lease_costs_nothing_while_nothing_is_armed(pair: Pair) -> None:
    _, pc = pair
    arm(pc).result()
    pc.table.arming.disarm(route(pc), Disarmed.OPERATOR)
    let_time_pass(pair, 1.0)
    numbers = [side.table.arming.lease.state.number for side in pair]
    let_time_pass(pair, 10.0)
    assert [side.table.arming.lease.state.number for side in pair] == numbers


def test_sender_shows_disarmed_once_peer_has_answered(pair: Pair) -> None:
    _, pc = pair
    arm(pc).result()
    with acting("anna"):
        pc.table.arming.disarm(route(pc), Disarmed.OPERATOR)
    assert (route(pc).settling.under_way, stands(pc)) == (True, [False])
    assert not events(pc, EventCode.OPERATOR_DISARMED)
    hear_all(pair)
    assert not route(pc).settling.under_way
    assert [event.who for event in events(pc, EventCode.OPERATOR_DISARMED)] == ["anna"]


def test_sender_shows_disarmed_in_second_without_answer(pair: Pair) -> None:
    _, pc = pair
    arm(pc).result()
    pc.table.arming.disarm(route(pc), Disarmed.OPERATOR)
    sleep(pair[0], LASTS - 0.01)
    assert route(pc).settling.under_way
    sleep(pair[0], 0.02)
    assert not route(pc).settling.under_way


def test_the_receiving_side_is_disarmed_at_once(pair: Pair) -> None:
    robot, pc = pair
    arm(pc).result()
    robot.table.arming.disarm(route(robot), Disarmed.OPERATOR)
    assert not route(robot).settling.under_way
    assert events(robot, EventCode.OPERATOR_DISARMED)


def test_answer_to_dropped_demand_is_none_to_disarm(pair: Pair) -> None:
    """The peer has not heard of the disarm yet, and goes on publishing earlier messages."""
    robot, pc = pair
    arm(pc).result()
    pc.table.arming.demand_dropped(DemandSource(("", "/cmd_vel"), "/cmd_vel", DEADMAN))
    pc.table.arming.disarm(route(pc), Disarmed.OPERATOR)
    robot.hear()
    while pc.inbox:
        pc.hear()
    assert passes(robot) == [True]
    assert route(pc).settling.under_way
    hear_all(pair)
    assert not route(pc).settling.under_way


def test_max_age_edited_there_holds_on_both(make_armable: Callable[..., Pair]) -> None:
    pair = robot, pc = make_armable(Topic("/cmd_vel", "receive", max_age=0.5))
    robot.context.demands.apply()
    for seconds in (0.2, 2.0, 0.3):
        pc.change(route(pc), max_age=seconds)
        hear_all(pair)
        assert [route(side).age.max_age for side in pair] == [seconds, seconds]
        turn(pair[0])
        hear_all(pair)
        assert [route(side).age.max_age for side in pair] == [seconds, seconds]


def test_edit_of_other_limit_adds_no_max_age(make_armable: Callable[..., Pair]) -> None:
    pair = robot, pc = make_armable(Topic("/cmd_vel", "receive", arm=True))
    robot.context.demands.apply()
    pc.change(route(pc), max_rate=5.0)
    hear_all(pair)
    assert (route(robot).spec.max_rate, route(robot).spec.max_age) == (5.0, None)
    assert [route(side).age.max_age for side in pair] == [1.0, 1.0]


def test_repeated_proposals_have_demands_counted_once(pair: Pair) -> None:
    """Counting takes a server of many clients much longer than a peer takes to cause it."""
    robot, pc = pair
    turn(robot)
    before = robot.demands_counted, pc.demands_counted
    for _ in range(10):
        propose(robot, Topic("/chat", "transmit"))
        hear_all(pair)
        robot.table.remove(next(each for each in robot.routes.values() if each.spec.topic == "/chat"), "removed")
        hear_all(pair)
        turn(robot)
    assert robot.demands_counted > before[0]
    assert pc.demands_counted == before[1]


@pytest.mark.parametrize("sent", ["geometry_msgs/msg/Twist", "std_msgs/msg/String"])
def test_sent_entry_keeps_type_of_its_demands(sent: str, make_context: Callable[..., Context]) -> None:
    """The robot demands that commands are armed, and the control PC claims to send texts."""
    armed = (ArmedEntry("/cmd*", type="Twist"),)
    robot, pc = pair_of(make_context(ros=OnePublisher(), armed=armed), make_context(role="server"))
    propose(pc, Topic("/cmd_vel", "receive", type="String"))
    robot.hear()
    half = route(robot)
    assert half.life.accepted
    assert not half.arming.required
    robot.table.handle(Describe(half.id, sent, "RIHS01_" + "0" * 64, Qos(), (Origin(("there",)),)))
    assert half.life.accepted == (sent == "std_msgs/msg/String")


@pytest.mark.parametrize("provided", ["std_srvs/srv/SetBool", "std_srvs/srv/Trigger"])
def test_provided_entry_keeps_type_of_its_demands(provided: str, make_context: Callable[..., Context]) -> None:
    demand = ArmedEntry("/set*", kind="service", type="std_srvs/srv/SetBool")
    robot, pc = pair_of(make_context(armed=(demand,)), make_context(role="server"))
    propose(pc, Topic("/set_light", "transmit", kind="service", type="std_srvs/srv/Trigger"))
    robot.hear()
    half = route(robot)
    assert half.life.accepted
    assert not half.arming.required
    robot.table.handle(Provide(half.id, (LaneEntry(provided, "RIHS01_" + "0" * 64, 1),)))
    assert half.life.accepted == (provided == "std_srvs/srv/Trigger")

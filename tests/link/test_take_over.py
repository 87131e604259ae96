"""An arming goes over to an operator who asks its holder, unless the holder keeps it."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest
from tests.link.arming_helpers import COMMANDS, CONSOLE, arm, events, let_time_pass, propose, route, turn
from tests.link.route_table_helpers import Pair, Side, hear_all, pair_of
from tests.support.wording import says

from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.holder_questions import _AT_ONCE, ASKER_SILENT_AFTER, TakeOverText
from rsb_bridge.model.by_hand import ASKED_FOR
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import acting
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.wire.messages import AskEnded

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.model.snapshot import ArmingSnapshot

OTHER = "bert's"


@pytest.fixture
def pair(make_context: Callable[..., Context]) -> Pair:
    """A robot, which is the client, and a control PC, whose operator anna has armed the topic."""
    robot, pc = pair_of(make_context(), make_context(role="server"))
    propose(robot, COMMANDS)
    hear_all((robot, pc))
    arm(pc).result()
    return robot, pc


def ask(side: Side, console: str = OTHER) -> asyncio.Task[None]:
    async def asking() -> None:
        with acting("bert"):
            await side.table.questions.ask(route(side), console)

    task = side.context.loop.create_task(asking())
    turn(side)
    hear_all((side, side.other))
    turn(side)
    return task


def both_are_there(pair: Pair, at: int) -> None:
    """For a quarter of a second: the holder, and the operator who asks."""
    pair[1].table.arming.seen(CONSOLE, pressed=True)
    pair[at].table.questions.seen(OTHER)
    let_time_pass(pair, 0.25)


def shown(side: Side) -> ArmingSnapshot:
    arming = route(side).snapshot().arming
    assert arming is not None
    return arming


def problem(task: asyncio.Task[None]) -> str:
    with pytest.raises(LinkError) as error:
        task.result()
    return str(error.value)


both = pytest.mark.parametrize("at", [0, 1], ids=["from the other side", "beside the holder"])


@both
def test_holder_sees_asker_and_remaining_time(at: int, pair: Pair) -> None:
    """Both sides do so; the topic stays armed meanwhile."""
    task = ask(pair[at])
    for side in pair:
        assert "bert" in shown(side).asked_by
        assert shown(side).goes_in == pytest.approx(ASKED_FOR, abs=0.1)
    let_time_pass(pair, 2.5)
    assert shown(pair[1]).goes_in == pytest.approx(ASKED_FOR - 2.5, abs=0.3)
    assert all(shown(side).armed for side in pair)
    assert not task.done()


@both
def test_holder_who_gives_it_ends_wait_at_once(at: int, pair: Pair) -> None:
    task = ask(pair[at])
    pair[1].table.questions.answer(route(pair[1]), CONSOLE, gives=True)
    hear_all(pair)
    turn(pair[0])
    assert task.done()
    task.result()
    assert all(not shown(side).asked_by for side in pair)


@both
def test_a_holder_who_keeps_it_is_named(at: int, pair: Pair) -> None:
    task = ask(pair[at])
    pair[1].table.questions.answer(route(pair[1]), CONSOLE, gives=False)
    hear_all(pair)
    turn(pair[0])
    text = problem(task)
    assert says(text, TakeOverText.KEPT)
    assert "anna" in text
    assert all(shown(side).armed and not shown(side).asked_by for side in pair)


@both
def test_without_an_answer_it_goes_over(at: int, pair: Pair, loop: VirtualLoop) -> None:
    task = ask(pair[at])
    began = loop.time()
    while not task.done():
        both_are_there(pair, at)
    task.result()
    assert loop.time() - began == pytest.approx(ASKED_FOR, abs=0.5)


@both
@pytest.mark.parametrize("alive_for", [0.0, 8.5])
def test_console_that_asked_and_is_silent_gets_nothing(
    at: int, alive_for: float, pair: Pair, loop: VirtualLoop
) -> None:
    """It stood still: nobody is there who would drive. The question is gone, and the holder goes on."""
    task = ask(pair[at])
    began = loop.time()
    while not task.done():
        pair[1].table.arming.seen(CONSOLE, pressed=True)
        if loop.time() - began < alive_for:
            pair[at].table.questions.seen(OTHER)
        let_time_pass(pair, 0.25)
    assert says(problem(task), TakeOverText.ASKER_SILENT)
    assert loop.time() - began == pytest.approx(alive_for + ASKER_SILENT_AFTER, abs=0.5)
    assert all(shown(side).armed and not shown(side).asked_by for side in pair)


@both
def test_silent_console_gets_nothing_disarmed_meanwhile(at: int, pair: Pair) -> None:
    """The machine may have slept: its operator asked before that."""
    task = ask(pair[at])
    now = pair[at].context.now
    with patch.object(pair[at].context, "now", lambda: now() + 60.0):
        pair[1].table.arming.disarm(route(pair[1]), Disarmed.DEADMAN)
        hear_all(pair)
        turn(pair[0])
        assert says(problem(task), TakeOverText.ASKER_SILENT)


ENDS = {
    "kept": (EventCode.OPERATOR_KEPT, "anna"),
    "given": (EventCode.OPERATOR_GAVE, "anna"),
    "not answered": (EventCode.OPERATOR_UNANSWERED, "bert"),
    "withdrawn": (EventCode.OPERATOR_WITHDREW, "bert"),
}


@both
@pytest.mark.parametrize("end", ENDS)
def test_both_sides_record_question_and_outcome(end: str, at: int, pair: Pair, loop: VirtualLoop) -> None:
    task = ask(pair[at])
    if end in ("kept", "given"):
        pair[1].table.questions.answer(route(pair[1]), CONSOLE, gives=end == "given")
    elif end == "withdrawn":
        task.cancel()
    until = loop.time() + ASKED_FOR + 1.0
    while end == "not answered" and loop.time() < until:
        both_are_there(pair, at)
    turn(pair[0])
    hear_all(pair)
    turn(pair[0])
    code, who = ENDS[end]
    for number, side in enumerate(pair):
        asked, ended = events(side, EventCode.OPERATOR_ASKED, *(each for each, _ in ENDS.values()))
        assert (asked.code, ended.code) == (EventCode.OPERATOR_ASKED, code)
        assert "bert" in asked.who
        assert who in ended.who
        assert asked.from_peer is (number != at)
        assert ended.from_peer is (number != (1 if who == "anna" else at))


def test_an_answer_is_no_answer_to_another_question(pair: Pair) -> None:
    """One of the holder's own side was given it; of the other side, the holder does not know yet."""
    task = ask(pair[0])
    pair[0].table.handle(AskEnded(route(pair[0]).id, 1, "given", own=True))
    turn(pair[0])
    assert not task.done()


def test_answer_is_none_to_question_that_follows(pair: Pair) -> None:
    """The holder, who did not know yet that the first is withdrawn, has not seen the second."""
    ask(pair[0]).cancel()
    turn(pair[0])
    pair[1].table.questions.answer(route(pair[1]), CONSOLE, gives=True)
    task = ask(pair[0], "third")
    assert not task.done()
    assert shown(pair[1]).asked_by


def test_holder_sees_time_in_which_answer_still_comes(pair: Pair) -> None:
    lease = route(pair[1]).arming.lease
    assert lease is not None
    lease.round_trip = 0.5
    ask(pair[0])
    assert shown(pair[1]).goes_in == pytest.approx(ASKED_FOR - 0.5, abs=0.1)


def test_only_the_holders_side_answers(pair: Pair) -> None:
    """A peer cannot give what an operator of this side holds."""
    task = ask(pair[1])
    for own in (False, True):
        pair[1].table.handle(AskEnded(route(pair[1]).id, 1, "given", own=own))
        turn(pair[0])
    assert not task.done()


@both
@pytest.mark.parametrize(
    ("why", "goes_over"),
    [
        (Disarmed.DEADMAN, True),
        (Disarmed.CONSOLE_GONE, True),
        (Disarmed.OPERATOR, False),
        (Disarmed.LEASE, False),
        (Disarmed.RELOADED, False),
    ],
)
def test_unanswered_question_succeeds_only_without_holder(why: Disarmed, goes_over: bool, at: int, pair: Pair) -> None:
    task = ask(pair[at])
    pair[1].table.arming.disarm(route(pair[1]), why)
    hear_all(pair)
    turn(pair[0])
    if goes_over:
        task.result()
    else:
        assert says(problem(task), TakeOverText.DISARMED)


@both
def test_who_asks_no_longer_leaves_no_question(at: int, pair: Pair) -> None:
    task = ask(pair[at])
    task.cancel()
    turn(pair[0])
    hear_all(pair)
    assert all(not shown(side).asked_by for side in pair)
    with pytest.raises(LinkError):
        pair[1].table.questions.answer(route(pair[1]), CONSOLE, gives=True)


def test_only_the_holders_console_answers(pair: Pair) -> None:
    task = ask(pair[0])
    for side, console in ((pair[1], "another"), (pair[0], OTHER)):
        with pytest.raises(LinkError) as error:
            side.table.questions.answer(route(side), console, gives=True)
        assert says(str(error.value), TakeOverText.NOT_YOURS)
    assert not task.done()


def test_what_nobody_holds_needs_no_question(pair: Pair) -> None:
    pair[1].table.arming.disarm(route(pair[1]), Disarmed.OPERATOR)
    hear_all(pair)
    ask(pair[0]).result()


def test_one_asks_at_a_time_and_nobody_oneself(pair: Pair) -> None:
    assert says(problem(ask(pair[1], CONSOLE)), TakeOverText.HELD_HERE)
    ask(pair[1])
    assert says(problem(ask(pair[1], "third")), TakeOverText.ASKED_ALREADY)
    assert says(problem(ask(pair[0])), TakeOverText.ASKED_ALREADY)


def test_holders_side_asks_first_of_two(pair: Pair, loop: VirtualLoop) -> None:
    """The other one is kept, though both were asked before either side heard of the other's."""

    async def both() -> None:
        here, there = (
            asyncio.ensure_future(side.table.questions.ask(route(side), console))
            for side, console in ((pair[1], OTHER), (pair[0], "third"))
        )
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        hear_all(pair)
        with pytest.raises(LinkError) as error:
            await there
        assert says(str(error.value), TakeOverText.KEPT)
        pair[1].table.questions.answer(route(pair[1]), CONSOLE, gives=True)
        await here

    loop.run_until_complete(both())


def test_side_that_asks_repeatedly_is_ignored(pair: Pair) -> None:
    """The driver watches the robot, not questions."""
    for _ in range(int(_AT_ONCE)):
        ask(pair[0]).cancel()
        turn(pair[0])
        hear_all(pair)
    assert says(problem(ask(pair[0])), TakeOverText.KEPT)
    assert not shown(pair[1]).asked_by

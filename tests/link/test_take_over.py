"""An arming goes over to an operator who asks its holder, unless the holder keeps it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.link.test_arming import COMMANDS, CONSOLE, arm, let_time_pass, propose, route, turn
from tests.link.test_route_table import Pair, Side, hear_all
from tests.support.wording import says

from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.holder_questions import _AT_ONCE, TakeOverText
from rsb_bridge.model.by_hand import ASKED_FOR
from rsb_bridge.model.command_origin import acting
from rsb_bridge.route.arming import Disarmed

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.model.snapshot import ArmingSnapshot

OTHER = "bert's"


@pytest.fixture
def pair(loop: VirtualLoop, make_context: Callable[..., Context]) -> Pair:
    """A robot, which is the client, and a control PC, whose operator anna has armed the topic."""
    robot, pc = Side(make_context(), is_client=True), Side(make_context(role="server"), is_client=False)
    robot.other, pc.other = pc, robot
    propose(robot, COMMANDS)
    hear_all((robot, pc))
    arm(pc, loop).result()
    return robot, pc


def ask(side: Side, loop: VirtualLoop, console: str = OTHER) -> asyncio.Task[None]:
    async def asking() -> None:
        with acting("bert"):
            await side.table.questions.ask(route(side), console)

    task = loop.create_task(asking())
    turn(loop)
    hear_all((side, side.other))
    turn(loop)
    return task


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
def test_the_holder_sees_who_asks_and_how_long_it_takes(at: int, pair: Pair, loop: VirtualLoop) -> None:
    """So does whoever asks; the topic stays armed meanwhile."""
    task = ask(pair[at], loop)
    for side in {pair[at], pair[1]}:
        assert "bert" in shown(side).asked_by
        assert shown(side).goes_in == pytest.approx(ASKED_FOR, abs=0.1)
    let_time_pass(pair, loop, 4.0)
    assert shown(pair[1]).goes_in == pytest.approx(ASKED_FOR - 4.0, abs=0.3)
    assert all(shown(side).armed for side in pair)
    assert not task.done()
    task.cancel()
    turn(loop)


@both
def test_a_holder_who_gives_it_ends_the_wait_at_once(at: int, pair: Pair, loop: VirtualLoop) -> None:
    task = ask(pair[at], loop)
    pair[1].table.questions.answer(route(pair[1]), CONSOLE, gives=True)
    hear_all(pair)
    turn(loop)
    assert task.done()
    task.result()
    assert all(not shown(side).asked_by for side in pair)


@both
def test_a_holder_who_keeps_it_is_named(at: int, pair: Pair, loop: VirtualLoop) -> None:
    task = ask(pair[at], loop)
    pair[1].table.questions.answer(route(pair[1]), CONSOLE, gives=False)
    hear_all(pair)
    turn(loop)
    text = problem(task)
    assert says(text, TakeOverText.KEPT)
    assert "anna" in text
    assert all(shown(side).armed and not shown(side).asked_by for side in pair)


@both
def test_without_an_answer_it_goes_over(at: int, pair: Pair, loop: VirtualLoop) -> None:
    task = ask(pair[at], loop)
    began = loop.time()
    while not task.done():
        pair[1].table.arming.seen(CONSOLE, pressed=True)
        let_time_pass(pair, loop, 0.25)
    task.result()
    assert loop.time() - began == pytest.approx(ASKED_FOR, abs=0.5)


@both
def test_it_needs_no_answer_once_it_is_disarmed(at: int, pair: Pair, loop: VirtualLoop) -> None:
    task = ask(pair[at], loop)
    pair[1].table.arming.disarm(route(pair[1]), Disarmed.DEADMAN)
    hear_all(pair)
    turn(loop)
    task.result()


@both
def test_who_asks_no_longer_leaves_no_question(at: int, pair: Pair, loop: VirtualLoop) -> None:
    task = ask(pair[at], loop)
    task.cancel()
    turn(loop)
    hear_all(pair)
    assert all(not shown(side).asked_by for side in pair)
    with pytest.raises(LinkError):
        pair[1].table.questions.answer(route(pair[1]), CONSOLE, gives=True)


def test_only_the_holders_console_answers(pair: Pair, loop: VirtualLoop) -> None:
    task = ask(pair[0], loop)
    for side, console in ((pair[1], "another"), (pair[0], OTHER)):
        with pytest.raises(LinkError) as error:
            side.table.questions.answer(route(side), console, gives=True)
        assert says(str(error.value), TakeOverText.NOT_YOURS)
    assert not task.done()
    task.cancel()
    turn(loop)


def test_what_nobody_holds_needs_no_question(pair: Pair, loop: VirtualLoop) -> None:
    pair[1].table.arming.disarm(route(pair[1]), Disarmed.OPERATOR)
    hear_all(pair)
    ask(pair[0], loop).result()


def test_one_asks_at_a_time_and_nobody_oneself(pair: Pair, loop: VirtualLoop) -> None:
    assert says(problem(ask(pair[1], loop, CONSOLE)), TakeOverText.HELD_HERE)
    first = ask(pair[1], loop)
    assert says(problem(ask(pair[1], loop, "third")), TakeOverText.ASKED_ALREADY)
    assert says(problem(ask(pair[0], loop)), TakeOverText.KEPT)
    first.cancel()
    turn(loop)


def test_a_side_that_asks_again_and_again_is_not_heard(pair: Pair, loop: VirtualLoop) -> None:
    """Whoever drives watches the robot, not questions."""
    for _ in range(int(_AT_ONCE)):
        ask(pair[0], loop).cancel()
        turn(loop)
        hear_all(pair)
    assert says(problem(ask(pair[0], loop)), TakeOverText.KEPT)
    assert not shown(pair[1]).asked_by

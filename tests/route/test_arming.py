"""The table of an arming: every phase and every event, and what crosses in each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.route.gates_helpers import leased
from tests.route.loop_filter_helpers import FIRST, World, world
from tests.route.unpacking_helpers import OnePublisher, opened
from tests.support.offline import FakePeer

from rsb_bridge.ros.ros_interface import RawMessage
from rsb_bridge.route.arming import ANSWERED_WITHIN, TRANSITIONS, Arming, ArmingEvent, ArmingPhase, Disarmed
from rsb_bridge.route.lease import LASTS
from rsb_bridge.wire.framing import LEASED
from rsb_bridge.wire.headers import with_number

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.route.route import Route

__all__ = ["world"]
CONSOLE = "anna's"
HAPPEN: dict[ArmingEvent, Callable[[Arming, float], object]] = {
    ArmingEvent.OPEN: lambda arming, _: arming.opened(required=True, deadman=0.0),
    ArmingEvent.ASK: lambda arming, now: arming.ask("anna", CONSOLE, now, lambda: None),
    ArmingEvent.ARM_THERE: lambda arming, now: arming.arm_for_peer("bert", now),
    ArmingEvent.AGREE: lambda arming, now: arming.agreed(now),
    ArmingEvent.LIVE: lambda arming, _: arming.lives(),
    ArmingEvent.KEY: lambda arming, now: (
        arming.seen(CONSOLE, now, pressed=True) if arming.console else arming.pressed_there("bert", now)
    ),
    ArmingEvent.END: lambda arming, _: arming.end(Disarmed.OPERATOR),
}
HERE, THERE = (ArmingEvent.ASK, ArmingEvent.AGREE, ArmingEvent.LIVE), (ArmingEvent.ARM_THERE, ArmingEvent.LIVE)
WAYS: dict[ArmingPhase, list[tuple[ArmingEvent, ...]]] = {
    ArmingPhase.FREE: [()],
    ArmingPhase.ASKED: [HERE[:1]],
    ArmingPhase.BEGINS: [HERE[:2], THERE[:1]],
    ArmingPhase.ARMED: [HERE, THERE],
    ArmingPhase.SPENT: [(*HERE, ArmingEvent.END), (*THERE, ArmingEvent.END), (ArmingEvent.END,)],
}


@pytest.fixture(params=["out", "in"])
def cross(request: pytest.FixtureRequest, make_context: Callable[..., Context]) -> tuple[Route, Callable[[], int]]:
    """A route, and a function that gives it a message and returns how many have crossed."""
    if request.param == "out":
        made: World = request.getfixturevalue("world")

        def offer() -> int:
            made.path.offer([RawMessage(b"moves", made.context.stamps.now(), FIRST, lease=1)])
            return len(made.sent)

        return made.sender.route, offer
    ros = OnePublisher()
    receiver = opened(make_context(ros=ros), FakePeer(), "/cmd")

    def deliver() -> int:
        lease = receiver.route.arming.lease
        assert lease is not None
        receiver.deliver([(with_number(lease.number, b"moves"), receiver.route.context.stamps.now(), LEASED)])
        return len(ros.published.sizes)

    return receiver.route, deliver


@pytest.mark.parametrize("heard", [True, False], ids=["heard", "unheard"])
@pytest.mark.parametrize("event", ArmingEvent)
@pytest.mark.parametrize("way", [way for ways in WAYS.values() for way in ways], ids=lambda way: f"after {len(way)}")
def test_messages_cross_only_while_armed_and_heard(
    way: tuple[ArmingEvent, ...],
    event: ArmingEvent,
    heard: bool,
    cross: tuple[Route, Callable[[], int]],
    loop: VirtualLoop,
) -> None:
    route, pass_one = cross
    arming, now = route.arming, route.context.now
    arming.opened(required=True, deadman=0.0)
    leased(arming, route.context)
    for each in way:
        HAPPEN[each](arming, now())
    (before,) = (phase for phase, ways in WAYS.items() if way in ways)
    assert arming.phase is before
    if not heard:
        loop.jump(LASTS * 1.1)
    assert pass_one() == (before is ArmingPhase.ARMED and heard)
    HAPPEN[event](arming, now())
    after = TRANSITIONS[before].get(event, before)
    assert arming.phase is after
    passed = int(before is ArmingPhase.ARMED and heard)
    assert pass_one() == passed + (after is ArmingPhase.ARMED and heard)


def test_the_documented_table_is_the_one_that_holds() -> None:
    page = (Path(__file__).parents[2] / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = [[cell.strip(" `") for cell in line.split("|")[1:-1]] for line in page.splitlines()]
    start = 2 + rows.index(["phase", *(each.name for each in ArmingEvent)])
    documented = {
        (phase, event): cell
        for phase, *cells in rows[start : start + len(ArmingPhase)]
        for event, cell in zip(ArmingEvent, cells, strict=True)
    }
    for phase in ArmingPhase:
        for event in ArmingEvent:
            new = TRANSITIONS[phase].get(event)
            assert documented[phase.name, event] == ("" if new is None else new.name)


def test_an_agreement_after_its_time_arms_nothing() -> None:
    arming, answers = Arming(), []
    arming.opened(required=True, deadman=0.0)
    arming.ask("anna", CONSOLE, 0.0, lambda: answers.append(arming.phase))
    assert not arming.agreed(ANSWERED_WITHIN)
    arming.end(Disarmed.NO_ANSWER)
    assert answers == [ArmingPhase.SPENT]


@pytest.mark.parametrize("phase", [phase for phase in ArmingPhase if ArmingEvent.ASK not in TRANSITIONS[phase]])
def test_question_out_of_turn_is_answered_at_once(phase: ArmingPhase) -> None:
    answers: list[bool] = []
    for way in WAYS[phase]:
        answers.clear()
        arming = Arming()
        arming.opened(required=True, deadman=0.0)
        for each in way:
            HAPPEN[each](arming, 0.0)
        by, console = arming.by, arming.console
        arming.ask("carl", "carl's", 0.0, lambda: answers.append(True))
        assert (answers, arming.phase, arming.by, arming.console) == ([True], phase, by, console)

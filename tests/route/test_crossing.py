"""Whether messages may cross: of all reasons why not, the first in the enumeration's order counts."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.route.gates_helpers import leased
from tests.support.offline import half_of

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.blocking_rules import blocked
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.gates import NO_SAMPLE, armed_gate
from rsb_bridge.route.lease import LASTS
from rsb_bridge.route.lifecycle import RouteEvent
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

DEADMAN = 0.3
ARMINGS = {
    "needs none": Crossing.YES,
    "free": Crossing.DISARMED,
    "asked": Crossing.ASKED,
    "begins": Crossing.BEGINS,
    "armed": Crossing.YES,
    "unheard": Crossing.UNHEARD,
    "run out": Crossing.DISARMED,
    "spent": Crossing.DISARMED,
}


def bring(half: Sender | Receiver, arming: str, loop: VirtualLoop) -> None:
    """Bring a route's arming into a state."""
    if arming == "needs none":
        return
    found, now = half.route.arming, half.route.context.now
    found.demand(required=True, deadman=DEADMAN if arming == "run out" else 0.0)
    leased(found, half.route.context)
    if arming == "asked":
        found.ask("anna", "a console", now(), lambda: None)
    elif arming != "free":
        found.arm_for_peer("anna", now())
        if arming != "begins":
            found.lives()
    if arming == "spent":
        found.end(Disarmed.OPERATOR)
    if arming == "unheard":
        loop.jump(LASTS * 1.1)
    if arming == "run out":
        loop.jump(10 * DEADMAN)


@pytest.mark.parametrize("arming", ARMINGS)
@pytest.mark.parametrize("kind", [Sender, Receiver])
def test_the_first_reason_in_order_counts(
    kind: type[Sender | Receiver], arming: str, make_context: Callable[..., Context], loop: VirtualLoop
) -> None:
    for loops, paused, settles, is_open in product([False, True], repeat=4):
        half: Any = half_of(kind, make_context(), Topic("/cmd", "transmit"))
        bring(half, arming, loop)
        half.route.notices.loop = "round" if loops else ""
        half.route.pausing.paused = paused
        if settles:
            half.route.settling.begin(1, 1.0)
        if is_open:
            for event in (RouteEvent.OPEN, RouteEvent.ACCEPT):
                half.route.life.handle(event)
            half.carried.channel = SimpleNamespace(ready=True, trouble=lambda: None)
        armed = ARMINGS[arming]
        reasons = {armed}
        if loops:
            reasons.add(Crossing.LOOP)
        if armed.is_unarmed and (settles or (arming == "run out" and kind is Sender)):
            reasons.add(Crossing.DISARMING)
        if paused:
            reasons.add(Crossing.PAUSED)
        if not is_open:
            reasons.add(Crossing.NOT_OPEN)
        first = next(each for each in Crossing if each in reasons)
        assert half.route.crossing is first
        assert half.route.arming.crossing(half.route.context.now()) is armed, (
            "a pause or a loop says nothing of the arming"
        )
        refused = armed_gate(half.route.arming)(NO_SAMPLE, half.route.context.now())
        assert refused is {Crossing.YES: None, Crossing.UNHEARD: Refused.UNHEARD}.get(armed, Refused.DISARMED)
        verdict = blocked(half.facts, first)
        assert (verdict.state if verdict is not None else None) is STATES.get(first)


STATES = {
    Crossing.LOOP: State.DOWN,
    Crossing.DISARMING: State.DISARMING,
    Crossing.PAUSED: State.PAUSED,
    Crossing.DISARMED: State.DISARMED,
    Crossing.ASKED: State.DISARMED,
    Crossing.BEGINS: State.DISARMED,
}


def test_each_reason_holds_back_or_waits_or_flows() -> None:
    kinds = [(each.flows, each.is_held_back, each is Crossing.NOT_OPEN) for each in Crossing]
    assert [sum(kind) for kind in kinds] == [1] * len(Crossing)
    assert all(each.is_held_back for each in Crossing if each.is_unarmed)

"""A route that is refused for weeks is asked for again, and costs its link nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.offline import half_of

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.reason import Reason
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

SCAN = Topic("/scan", "transmit")


def test_refused_route_is_always_asked_for_again(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    context = make_context()
    sender = half_of(Sender, context, SCAN)
    pauses = []
    for number in range(3_000):
        sender.route.open(2 * number + 1)
        sender.route.refuse(EventCode.ROUTE_REFUSED, Reason("denied"))
        pauses.append(sender.route.reopening.retry_at - context.now())
        loop.jump(pauses[-1])
    assert pauses[:6] == [1.0, 2.0, 4.0, 8.0, 10.0, 10.0]
    assert max(pauses) < 10.001
    assert len(context.events.after(0)) == 1


@pytest.mark.parametrize("state", ["refused", "paused"])
def test_unsearched_publishers_are_not_called_missing(state: str, make_context: Callable[..., Context]) -> None:
    sender = half_of(Sender, make_context(), Topic("/scan", "transmit", paused=state == "paused"))
    sender.route.open(1)
    if state == "refused":
        sender.route.refuse(EventCode.ROUTE_REFUSED, Reason("denied"))
    (seen,) = [stage for stage in sender.route.snapshot().stages if stage.name == "publisher seen"]
    assert seen.done is None


@pytest.mark.parametrize("code", [EventCode.ROUTE_REFUSED, EventCode.ROUTE_TYPE_DIFFERS])
def test_refusal_stands_while_route_is_tried_again(
    code: EventCode, loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    """Each try is refused a moment later; nothing of it is seen, on the screen or in the log."""
    context = make_context()
    sender = half_of(Sender, context, SCAN)
    sender.route.open(1)
    sender.route.refuse(code, Reason("denied"))
    events = len(context.events.after(0))
    shown = set()
    for number in range(1, 8):
        for _ in range(10):
            loop.jump(1.0)
            sender.route.tick()
            shown.add((sender.route.snapshot().state, sender.route.snapshot().cause, sender.route.snapshot().reason))
        since = sender.route.snapshot().since
        sender.route.open(2 * number + 1)
        for accepted in (False, True):
            loop.jump(0.5)
            if accepted:
                sender.route.on_accepted()
            sender.route.tick()
            shown.add((sender.route.snapshot().state, sender.route.snapshot().cause, sender.route.snapshot().reason))
        assert sender.route.snapshot().since == since
        sender.route.refuse(code, Reason("denied"))
    assert shown == {(State.DOWN, Cause.REFUSED, "denied")}
    assert len(context.events.after(0)) == events


def test_refusal_is_over_once_later_opening_goes_on(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    context = make_context()
    sender = half_of(Sender, context, SCAN)
    sender.route.open(1)
    sender.route.refuse(EventCode.ROUTE_REFUSED, Reason("denied"))
    loop.jump(1.0)
    sender.route.open(3)
    sender.route.on_accepted()
    loop.jump(6.0)  # nobody publishes, so it goes no further
    sender.route.tick()
    assert sender.route.snapshot().state is State.WAITING
    sender.route.close("the link is down")
    sender.route.open(5)
    assert sender.route.snapshot().state is State.WAITING

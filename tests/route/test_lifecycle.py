"""The table of a route's life."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_bridge.model.reason import Reason
from rsb_bridge.route.lifecycle import TRANSITIONS, Lifecycle, RouteEvent, RoutePhase

THERE = (RouteEvent.OPEN, RouteEvent.ACCEPT, RouteEvent.DESCRIBE, RouteEvent.READY)


def in_phase(phase: RoutePhase) -> Lifecycle:
    life = Lifecycle()
    for event in THERE:
        if life.phase is phase:
            break
        life.handle(event)
    assert life.phase is phase
    return life


@pytest.mark.parametrize("phase", RoutePhase)
def test_every_phase_can_be_reached_refused_and_closed(phase: RoutePhase) -> None:
    life = in_phase(phase)
    assert life.handle(RouteEvent.REFUSE, Reason("no such type"))
    assert (life.phase, life.refusal, life.accepted) == (RoutePhase.CLOSED, Reason("no such type"), False)
    life = in_phase(phase)
    assert life.handle(RouteEvent.CLOSE)
    assert life.phase is RoutePhase.CLOSED


def test_new_type_is_described_before_messages_flow_again() -> None:
    life, phases = in_phase(RoutePhase.READY), []
    for event in (RouteEvent.DESCRIBE, RouteEvent.READY):
        assert life.handle(event)
        phases.append(life.phase)
    assert phases == [RoutePhase.DESCRIBED, RoutePhase.READY]


@pytest.mark.parametrize(
    ("phase", "event"),
    [
        (RoutePhase.CLOSED, RouteEvent.ACCEPT),
        (RoutePhase.PROPOSED, RouteEvent.DESCRIBE),
        (RoutePhase.ACCEPTED, RouteEvent.READY),
        (RoutePhase.READY, RouteEvent.ACCEPT),
        (RoutePhase.CLOSED, RouteEvent.READY),
    ],
)
def test_what_peer_says_out_of_order_changes_nothing(phase: RoutePhase, event: RouteEvent) -> None:
    life = in_phase(phase)
    assert not life.handle(event)
    assert life.phase is phase


@given(st.lists(st.sampled_from(RouteEvent)))
def test_whatever_happens_the_way_is_gone_in_order(events: list[RouteEvent]) -> None:
    life = Lifecycle()
    since_open: list[RouteEvent] = []
    for event in events:
        if life.handle(event):
            since_open = [event] if event is RouteEvent.OPEN else [*since_open, event]
        if life.phase is RoutePhase.READY:
            assert since_open[:2] == [RouteEvent.OPEN, RouteEvent.ACCEPT]
            assert since_open[-1] is RouteEvent.READY
            assert RouteEvent.DESCRIBE in since_open
        assert bool(life.refusal) <= (not life.accepted)
    assert set(TRANSITIONS) == set(RoutePhase)

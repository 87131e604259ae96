"""The table of a route's life."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_bridge.route.lifecycle import TRANSITIONS, Event, Lifecycle, Phase

THERE = (Event.OPEN, Event.ACCEPT, Event.DESCRIBE, Event.READY)


def in_phase(phase: Phase) -> Lifecycle:
    life = Lifecycle()
    if phase is Phase.REFUSED:
        life.take(Event.REFUSE, "no")
        return life
    for event in THERE:
        if life.phase is phase:
            break
        life.take(event)
    assert life.phase is phase
    return life


def test_the_way_to_messages() -> None:
    life = Lifecycle()
    phases = [life.phase]
    for event in THERE:
        assert not life.ready
        assert life.take(event)
        phases.append(life.phase)
    assert phases == [Phase.CLOSED, Phase.PROPOSED, Phase.ACCEPTED, Phase.DESCRIBED, Phase.READY]
    assert life.ready


@pytest.mark.parametrize("phase", Phase)
def test_every_phase_can_be_reached_refused_and_closed(phase: Phase) -> None:
    life = in_phase(phase)
    assert life.take(Event.REFUSE, "no such type")
    assert (life.phase, life.refusal, life.accepted) == (Phase.REFUSED, "no such type", False)
    life = in_phase(phase)
    assert life.take(Event.CLOSE)
    assert life.phase is (Phase.REFUSED if phase is Phase.REFUSED else Phase.CLOSED)


def test_a_new_type_is_described_before_messages_flow_again() -> None:
    life = in_phase(Phase.READY)
    assert life.take(Event.DESCRIBE)
    assert not life.ready
    assert life.take(Event.READY)
    assert life.ready


@pytest.mark.parametrize(
    ("phase", "event"),
    [
        (Phase.CLOSED, Event.ACCEPT),
        (Phase.PROPOSED, Event.DESCRIBE),
        (Phase.ACCEPTED, Event.READY),
        (Phase.READY, Event.ACCEPT),
        (Phase.REFUSED, Event.READY),
    ],
)
def test_what_a_peer_says_out_of_order_changes_nothing(phase: Phase, event: Event) -> None:
    life = in_phase(phase)
    assert not life.take(event)
    assert life.phase is phase


@given(st.lists(st.sampled_from(Event)))
def test_whatever_happens_the_way_is_gone_in_order(events: list[Event]) -> None:
    life = Lifecycle()
    since_open: list[Event] = []
    for event in events:
        if life.take(event):
            since_open = [event] if event is Event.OPEN else [*since_open, event]
        if life.ready:
            assert since_open[:2] == [Event.OPEN, Event.ACCEPT]
            assert since_open[-1] is Event.READY
            assert Event.DESCRIBE in since_open
        assert bool(life.refusal) <= (not life.accepted)
    assert set(TRANSITIONS) == set(Phase)

"""The search for the highest lossless rate, on a simulated link: no clock, no network."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_extras.bench.suite import CLOSE, Found, highest_lossless
from rsb_extras.bench.tests.simulated import SimulatedLink


def search(link: SimulatedLink, *, first: float = 5000.0, size: int = 2500) -> Found:
    return highest_lossless(lambda rate: link.send(rate, 1.0, size), first=first, most=link.most(size))


@given(capacity=st.floats(3.0, 1e6), first=st.floats(1.0, 1e6))
def test_it_finds_capacity_to_tenth_wherever_it_begins(capacity: float, first: float) -> None:
    link = SimulatedLink(1e12, capacity)
    found = search(link, first=first)
    assert found.limit == "loss"
    assert found.best is not None
    assert found.best.lossless
    assert capacity / CLOSE <= found.best.rate <= capacity
    assert len(link.tried) < 80


def test_a_sender_that_makes_no_more_ends_it() -> None:
    found = search(SimulatedLink(1e12, 1e9, sender=12_000.0))
    assert found.limit == "sender"
    assert found.best is not None
    assert found.best.rate == 12_000.0


def test_nothing_above_the_peer_s_leave_is_tried() -> None:
    link = SimulatedLink(1e12, 1e9, leave=7000.0)
    found = search(link)
    assert found.limit == "leave"
    assert max(link.tried) == 7000.0


def test_one_loss_is_tried_again() -> None:
    link = SimulatedLink(1e12, 1e9, leave=100.0)
    losses = iter([True])

    def trial(rate: float):  # type: ignore[no-untyped-def]
        run = link.send(rate, 1.0, 100)
        return type(run)(100, run.sent, run.sent - 1, rate, 0, 0) if next(losses, False) else run

    assert highest_lossless(trial, first=100.0, most=100.0).limit == "leave"


@pytest.mark.parametrize("trials", [1, 3])
def test_search_ends_when_time_is_up(trials: int) -> None:
    link = SimulatedLink(1e12, 1e9)
    found = highest_lossless(
        lambda rate: link.send(rate, 1.0, 100), first=10.0, goes_on=lambda: len(link.tried) < trials
    )
    assert found.limit == "time"
    assert len(link.tried) == trials
    assert found.best is not None


def test_a_link_that_carries_nothing_has_no_rate() -> None:
    assert search(SimulatedLink(1.0, 0.1)) == (None, "loss")

"""Delays between attempts, for as many attempts as there may be."""

from __future__ import annotations

from random import Random

from rsb_bridge.model.budgets import Backoff


def test_delays_double_up_to_the_longest() -> None:
    backoff = Backoff(0.5, 10.0)
    assert [backoff.next() for _ in range(7)] == [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]
    backoff.reset()
    assert backoff.next() == 0.5


def test_it_goes_on_for_ever() -> None:
    backoff = Backoff(0.5, 10.0)
    for _ in range(100_000):
        assert backoff.next() <= 10.0


def test_one_delay_may_be_limited_further() -> None:
    backoff = Backoff(0.5, 10.0)
    assert [backoff.next(1.25) for _ in range(4)] == [0.5, 1.0, 1.25, 1.25]
    assert backoff.next() == 8.0


def test_jitter_varies_each_delay_by_its_share() -> None:
    backoff = Backoff(10.0, 10.0, Random(1), jitter=0.2)
    delays = [backoff.next() for _ in range(1000)]
    assert 8.0 <= min(delays) < 8.1
    assert 11.9 < max(delays) <= 12.0

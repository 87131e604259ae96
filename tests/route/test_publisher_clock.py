"""The age of messages by stamps of clocks that may be wrong."""

from __future__ import annotations

import pytest

from rsb_bridge.route.age import PublisherClocks

S = 1_000_000_000
NOW = 1_800_000_000 * S
GID = b"publisher"
HOUR = 3600 * S


def test_a_right_clock_is_believed() -> None:
    clocks = PublisherClocks()
    clocks.since = NOW - 60 * S
    for age in (0, S // 10, 8 * S, 59 * S):
        assert clocks.born(NOW - age, NOW, GID) == NOW - age
    assert len(clocks) == 0


def test_unstamped_message_ages_from_taking() -> None:
    assert PublisherClocks().born(0, NOW, GID) == NOW


@pytest.mark.parametrize("ahead", [60 * 10**6, 10 * S, HOUR])
def test_fast_clock_counts_from_taking(ahead: int) -> None:
    clocks = PublisherClocks()
    assert clocks.born(NOW + ahead, NOW, GID) == NOW
    assert clocks.born(NOW + S + ahead, NOW + S, GID) == pytest.approx(NOW + S, abs=10**6)


@pytest.mark.parametrize("offset", [-HOUR, -10 * S, 10 * S, HOUR])
def test_held_message_ages_despite_wrong_clock(offset: int) -> None:
    clocks = PublisherClocks()
    clocks.since = NOW - S
    for each in range(10):
        assert clocks.born(NOW + each * S + offset, NOW + each * S, GID) >= NOW + each * S - 10**7
    taken = NOW + 18 * S  # frozen for 8 s, then all at once
    ages = [taken - clocks.born(NOW + each * S + offset, taken, GID) for each in range(10, 19)]
    assert ages == pytest.approx([(18 - each) * S for each in range(10, 19)], abs=10**7)


def test_slow_clock_is_known_by_early_stamps() -> None:
    clocks = PublisherClocks()
    clocks.since = NOW
    assert clocks.born(NOW + S - 60 * S, NOW + S, GID) == NOW + S


def test_latched_message_is_as_old_as_stamped() -> None:
    clocks = PublisherClocks()
    clocks.since = None
    assert clocks.born(NOW - 5 * HOUR, NOW, GID) == NOW - 5 * HOUR


def test_clock_that_is_set_right_is_believed_again() -> None:
    clocks = PublisherClocks()
    clocks.since = NOW
    clocks.born(NOW - HOUR, NOW, GID)
    assert len(clocks) == 1
    assert clocks.born(NOW + S, NOW + S, GID) == NOW + S
    assert len(clocks) == 0
    assert clocks.born(NOW + 2 * S, NOW + 5 * S, GID) == NOW + 2 * S


def test_old_stamp_proves_nothing_after_step() -> None:
    clocks = PublisherClocks()
    clocks.since = NOW
    clocks.forget()
    assert clocks.born(NOW - 60 * S, NOW + S, GID) == NOW - 60 * S


def test_a_wrong_clock_may_drift() -> None:
    clocks = PublisherClocks()
    clocks.since = NOW
    for minute in range(600):
        taken = NOW + minute * 60 * S
        source = NOW - HOUR + int(minute * 60 * S * (1 - 2e-4))
        assert taken - clocks.born(source, taken, GID) < 10**8


def test_the_table_of_publishers_is_bounded() -> None:
    clocks = PublisherClocks()
    for number in range(5000):
        clocks.born(NOW + HOUR, NOW, number.to_bytes(16, "big"))
    assert len(clocks) == 1024

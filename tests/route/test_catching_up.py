"""Late messages are published at a pace that a subscription with the default depth keeps up with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from rsb_bridge.route.catching_up import AT_FIRST, EVERY, FASTER, LIVE_WITHIN, CatchUp

if TYPE_CHECKING:
    from rsb_bridge.wire.framing import Message


class Late:
    """The late messages of a topic of some rate (Hz), and how many of them are published."""

    def __init__(self, rate: float, known: float | None = None) -> None:
        self._rate = rate
        self.known = rate if known is None else known
        self._catch_up = CatchUp()
        self._published = 0

    def at(self, now: float) -> int:
        """Publish as many as may be at a time; return how many."""
        numbers = range(self._published, self._published + 1000)
        messages: list[Message] = [(b"", int(1e9 * number / self._rate), 0) for number in numbers]
        allowed = self._catch_up.allowed(messages, now, self.known)
        self._published += allowed
        return allowed

    def over(self, seconds: float, since: float = 0.0, every: float = EVERY) -> int:
        return sum(self.at(since + step * every) for step in range(1, round(seconds / every) + 1))


def test_one_is_published_at_once() -> None:
    late = Late(10.0)
    assert [late.at(now) for now in (0.0, 0.0, EVERY, 5.0)] == [1, 0, 1, 1]


@pytest.mark.parametrize("seconds", [1.0, 10.0])
def test_pace_grows_with_time(seconds: float) -> None:
    late = Late(10.0)
    assert late.over(seconds) == pytest.approx(AT_FIRST * seconds + FASTER * seconds**2 / 2, rel=0.05)
    assert late.over(1.0, since=60.0) == pytest.approx(AT_FIRST + FASTER / 2, rel=0.05)


def test_fast_topic_catches_up_at_twice_its_rate() -> None:
    assert Late(5000.0).over(10.0) == pytest.approx(100_000, rel=0.05)


def test_rate_that_is_not_known_is_told_by_stamps() -> None:
    late = Late(200.0, known=0.0)
    assert late.over(0.5) == pytest.approx(AT_FIRST / 2, rel=0.2)
    late.over(1.0, since=0.5)
    assert late.over(1.0, since=1.5) == pytest.approx(400, rel=0.05)


def test_pace_does_not_drive_itself_up() -> None:
    """What is published late counts in the topic's rate, too."""
    late = Late(400.0)
    count = late.at(0.0)
    late.known = 5_000.0
    assert count + late.over(1.0) == pytest.approx(800, rel=0.05)


@pytest.mark.parametrize("known", [400.0, 0.0])
def test_a_busy_machine_catches_up_with_the_topic(known: float) -> None:
    """Its timers are late."""
    late = Late(400.0, known)
    late.over(10.0, every=5 * EVERY)
    assert late.over(2.0, since=10.0, every=5 * EVERY) >= 400.0 * 2 * 1.4


@pytest.mark.parametrize("count", [1, 20, 5000])
@pytest.mark.parametrize("late_by", [0.0, 0.05])
def test_state_is_published_evenly_within_a_moment(count: int, late_by: float) -> None:
    """Also where timers are late."""
    left: list[Message] = [(b"", int(1e9 * number / 50), 0) for number in range(count)]
    catch_up, now, most = CatchUp(), 7.0, 0
    while left:
        allowed = catch_up.allowed(left, now, 50.0, LIVE_WITHIN)
        most = max(most, allowed)
        left, now = left[allowed:], now + EVERY + late_by
    assert now - 7.0 <= LIVE_WITHIN + 2 * (EVERY + late_by)
    assert most <= 1 + count * (EVERY + late_by) / LIVE_WITHIN * 2


def test_state_that_comes_one_by_one_is_spread() -> None:
    catch_up = CatchUp()
    assert sum(catch_up.allowed([(b"", 1, 0)], 7.0, 50.0, LIVE_WITHIN) for _ in range(100)) <= 2


def test_state_behind_moment_is_published_at_once() -> None:
    catch_up = CatchUp()
    late: list[Message] = [(b"", 1, 0)] * 100
    for step in range(100):
        allowed = catch_up.allowed(late, step * EVERY, 50.0, LIVE_WITHIN)
    assert allowed == len(late)


def test_a_burst_is_no_rate() -> None:
    burst: list[Message] = [(b"", 7, 0)] * 300
    catch_up = CatchUp()
    assert sum(catch_up.allowed(burst, step * EVERY, 0.0) for step in range(100)) == pytest.approx(AT_FIRST, rel=0.3)

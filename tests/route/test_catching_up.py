"""Late messages are published at a pace that a subscription with the default depth keeps up with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from rsb_bridge.route.catching_up import AT_FIRST, EVERY, FASTER, CatchUp

if TYPE_CHECKING:
    from rsb_bridge.wire.framing import Message


class Late:
    """The late messages of a topic of some rate (Hz), and how many of them are published."""

    def __init__(self, rate: float, count: int = 1_000_000) -> None:
        self._rate = rate
        self._count = count
        self._catch_up = CatchUp()
        self.published = 0

    def at(self, now: float) -> int:
        """Publish as many as may be at a time; return how many."""
        numbers = range(self.published, min(self.published + 200, self._count))
        messages: list[Message] = [(b"", int(1e9 * number / self._rate), 0) for number in numbers]
        allowed = self._catch_up.allowed(messages, now)
        self.published += allowed
        return allowed

    def in_(self, seconds: float, since: float = 0.0, every: float = EVERY) -> int:
        return sum(self.at(since + step * every) for step in range(1, round(seconds / every) + 1))


def test_one_is_published_at_once() -> None:
    late = Late(10.0)
    assert [late.at(now) for now in (0.0, 0.0, EVERY, 5.0)] == [1, 0, 1, 1]


@pytest.mark.parametrize("seconds", [1.0, 10.0])
def test_pace_grows_with_time(seconds: float) -> None:
    late = Late(10.0)
    assert late.in_(seconds) == pytest.approx(AT_FIRST * seconds + FASTER * seconds**2 / 2, rel=0.05)
    assert late.in_(1.0, since=60.0) == pytest.approx(AT_FIRST + FASTER / 2, rel=0.05)


def test_fast_topic_catches_up_at_three_times_its_rate() -> None:
    assert Late(5000.0).in_(10.0) == pytest.approx(150_000, rel=0.05)


def test_a_busy_machine_catches_up_with_the_topic() -> None:
    """Its timers are late."""
    assert Late(400.0).in_(2.0, every=5 * EVERY) >= 400.0 * 2 * 1.4


def test_messages_of_one_moment_come_together_as_they_were_published() -> None:
    burst: list[Message] = [(b"", 7, 0)] * 30
    assert CatchUp().allowed(burst, 0.0) == 30

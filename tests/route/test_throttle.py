"""A rate limit holds for all stamps."""

from __future__ import annotations

from random import Random

import pytest

from rsb_bridge.route.throttle import Throttle

S = 1_000_000_000


def passed(throttle: Throttle, stamps: list[int]) -> int:
    return sum(throttle.passes(stamp) for stamp in stamps)


def test_a_topic_just_above_the_limit_keeps_the_limit() -> None:
    """50 Hz throttled to 20 Hz gives 20, not 16.7."""
    assert passed(Throttle(20.0), [number * S // 50 for number in range(500)]) == 200


@pytest.mark.parametrize("back", [1, S // 10, S, 10 * S, 3600 * S])
def test_stamps_that_go_back_do_not_end_the_limit(back: int) -> None:
    """Two publishers' stamps may cross, and a clock may be set."""
    throttle = Throttle(2.0)
    start = 10_000 * S
    assert throttle.passes(start)
    throttle.passes(start - back)
    stamps = [start - back + number * S // 5 for number in range(1, 301)]
    assert 115 <= passed(throttle, stamps) <= 121


def test_stamps_of_two_publishers_that_cross() -> None:
    random = Random(1)
    stamps = [10_000 * S + number * S // 20 - random.randrange(S // 10) for number in range(1200)]
    assert 115 <= passed(Throttle(2.0), stamps) <= 121

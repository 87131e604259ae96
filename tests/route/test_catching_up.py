"""Late messages are published at a pace that a subscription with the default depth keeps up with."""

from __future__ import annotations

import pytest

from rsb_bridge.route.catching_up import AT_FIRST, EVERY, FASTER, CatchUp

_MANY = 1 << 30


def published(catch_up: CatchUp, seconds: float, rate: float, since: float = 0.0) -> int:
    """Return how many messages are published in so many seconds, when as many as may be are at each step."""
    return sum(catch_up.allowed(_MANY, since + step * EVERY, rate) for step in range(1, round(seconds / EVERY) + 1))


def test_one_is_published_at_once() -> None:
    catch_up = CatchUp()
    assert catch_up.allowed(600, 0.0, 0.0) == 1
    assert catch_up.allowed(600, 0.0, 0.0) == 0
    assert catch_up.allowed(600, EVERY, 0.0) == 1
    assert catch_up.allowed(600, 5.0, 0.0) == 1


@pytest.mark.parametrize("seconds", [1.0, 10.0])
def test_pace_grows_with_time(seconds: float) -> None:
    expected = AT_FIRST * seconds + FASTER * seconds**2 / 2
    catch_up = CatchUp()
    assert published(catch_up, seconds, 10.0) == pytest.approx(expected, rel=0.05)
    assert published(catch_up, 1.0, 10.0, since=60.0) == pytest.approx(AT_FIRST + FASTER / 2, rel=0.05)


def test_fast_topic_catches_up_at_twice_its_rate() -> None:
    assert published(CatchUp(), 10.0, 5000.0) == pytest.approx(100_000, rel=0.05)


def test_pace_does_not_drive_itself_up() -> None:
    """What is published late counts in the topic's rate, too."""
    catch_up = CatchUp()
    count = catch_up.allowed(_MANY, 0.0, 400.0)
    count += sum(catch_up.allowed(_MANY, step * EVERY, 5_000.0) for step in range(1, 101))
    assert count == pytest.approx(800, rel=0.05)


def test_a_busy_machine_catches_up_with_the_topic() -> None:
    """Its timers are late."""
    catch_up = CatchUp()
    assert sum(catch_up.allowed(_MANY, 5 * step * EVERY, 400.0) for step in range(40)) >= 400.0 * 2 * 1.4

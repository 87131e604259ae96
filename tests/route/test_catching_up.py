"""Late messages are published at a pace that a subscription with the default depth keeps up with."""

from __future__ import annotations

from rsb_bridge.route.catching_up import AT_ONCE, EVERY, CatchUp


def published(catch_up: CatchUp, seconds: float, rate: float, waiting: int = 1 << 30) -> int:
    """Return how many messages are published in so many seconds, when as many as may be are at each step."""
    return sum(catch_up.allowed(waiting, step * EVERY, rate) for step in range(1, round(seconds / EVERY) + 1))


def test_few_are_published_at_once() -> None:
    catch_up = CatchUp(0.0)
    assert catch_up.allowed(600, 0.0, 0.0) == 2 * AT_ONCE
    assert catch_up.allowed(600, 0.0, 0.0) == 0
    assert AT_ONCE - 1 <= catch_up.allowed(600, EVERY, 0.0) <= AT_ONCE
    assert catch_up.allowed(3, 1.0, 0.0) == 3


def test_a_busy_machine_catches_up() -> None:
    """Its timers fire late."""
    catch_up = CatchUp(0.0)
    assert sum(catch_up.allowed(1 << 30, 2 * step * EVERY, 0.0) for step in range(1, 501)) >= 0.95 * 5_000


def test_a_fast_topic_catches_up_at_twice_its_rate() -> None:
    slow, fast = published(CatchUp(0.0), 10.0, 10.0), published(CatchUp(0.0), 10.0, 5000.0)
    assert 0.95 * 5_000 <= slow <= 1.05 * 5_000
    assert 0.95 * 100_000 <= fast <= 1.05 * 100_000

"""The clock of stamps: nobody sets it, and it is sure of wall stamps only while nobody has just set the wall clock."""

from __future__ import annotations

import pytest

from rsb_bridge.model.clock import Clock, StampClock, shifted
from rsb_bridge.model.demands import ARMED, effective_max_age

S = 1_000_000_000


class SetClock(Clock):
    def __init__(self) -> None:
        self.boot = 1000.0
        self.offset = 1_800_000_000.0

    def time_ns(self) -> int:
        return int((self.boot + self.offset) * 1e9)

    def steady(self) -> float:
        return self.boot


@pytest.mark.parametrize("step", [-3600.0, -8.0, -0.1, 0.1, 10.0, 86_400.0])
def test_a_step_changes_no_time_and_is_noticed(step: float) -> None:
    wall = SetClock()
    clock = StampClock(wall)
    clock.compare()
    before = clock.now()
    assert before == pytest.approx(wall.time_ns(), abs=10**6)
    assert clock.is_sure
    wall.offset += step
    wall.boot += 1.0
    clock.compare()
    assert clock.now() - before == pytest.approx(S, abs=10**4)
    assert (clock.is_sure, clock.steps) == (False, 1)
    assert wall.time_ns() + clock.shift == pytest.approx(clock.now(), abs=10**6)
    wall.boot += 5.0
    clock.compare()
    assert not clock.is_sure
    wall.boot += 6.0
    clock.compare()
    assert (clock.is_sure, clock.steps) == (True, 1)


def test_a_step_during_a_freeze_is_noticed() -> None:
    wall = SetClock()
    clock = StampClock(wall)
    wall.boot += 8.0
    wall.offset -= 8.0
    clock.compare()
    assert not clock.is_sure


def test_drift_is_no_step() -> None:
    wall = SetClock()
    clock = StampClock(wall)
    for _ in range(10_000):
        wall.boot += 1.0
        wall.offset += 50e-6
        clock.compare()
    assert clock.is_sure
    assert wall.time_ns() + clock.shift == pytest.approx(clock.now(), abs=2 * 10**6)


@pytest.mark.parametrize(
    ("demands", "armed", "expected"),
    [
        ((None, None), False, 0.0),
        ((None, None), True, ARMED),
        ((0.5, None), False, 0.5),
        ((0.5, 2.0), True, 0.5),
        ((0.0, 2.0), False, 2.0),
        ((0.0, None), True, 0.0),
        ((5.0, None), True, 5.0),
    ],
)
def test_the_smallest_limit_holds(demands: tuple[float | None, ...], armed: bool, expected: float) -> None:
    assert effective_max_age(demands, armed=armed) == expected
    assert effective_max_age(reversed(demands), armed=armed) == expected


def test_stamp_from_before_setting_clock_stays_time() -> None:
    """A robot without a battery clock begins in 1970, and has its clock set while messages are on their way here."""
    wall = SetClock()
    wall.offset = 0.0
    clock = StampClock(wall)
    taken = wall.time_ns()
    wall.offset = 1_800_000_000.0
    clock.compare()
    assert shifted(taken, clock.shift) == 0
    assert shifted(wall.time_ns(), clock.shift) == pytest.approx(clock.now(), abs=10**6)

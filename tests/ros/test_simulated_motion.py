"""The demo's robot follows commands for a moment, stays in its room, and returns to its path."""

from __future__ import annotations

import math

import pytest
from geometry_msgs.msg import Twist

from rsb_bridge.ros.simulation import Motion, is_free

STEP = 0.05
RADIUS, MARGIN = 2.0, 0.35


class Drive:
    def __init__(self) -> None:
        self.now = 100.0
        self.motion = Motion(lambda: self.now)

    def wait(self, seconds: float) -> tuple[float, float, float]:
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            x, y, _ = self.motion.pose()
            assert is_free(x, y, MARGIN)
        return self.motion.pose()

    def command(self, forward: float, turn: float = 0.0) -> None:
        twist = Twist()
        twist.linear.x, twist.angular.z = forward, turn
        self.motion.command(twist)

    def drive(self, forward: float, turn: float, seconds: float) -> tuple[float, float, float]:
        for _ in range(round(seconds * 10)):
            self.command(forward, turn)
            self.wait(0.1)
        return self.motion.pose()


@pytest.fixture
def robot() -> Drive:
    return Drive()


def radius(pose: tuple[float, float, float]) -> float:
    return math.hypot(*pose[:2])


def test_it_drives_in_a_circle(robot: Drive) -> None:
    poses = [robot.wait(1.0) for _ in range(40)]
    assert all(abs(radius(pose) - RADIUS) < 0.2 for pose in poses)
    assert {(x > 0, y > 0) for x, y, _ in poses} == {(a, b) for a in (True, False) for b in (True, False)}


@pytest.mark.parametrize(("forward", "turn"), [(0.4, 0.0), (-0.4, 0.0), (0.0, 0.5), (0.0, -0.5)])
def test_a_command_counts_for_half_a_second(robot: Drive, forward: float, turn: float) -> None:
    x, y, heading = robot.wait(1.0)
    robot.command(forward, turn)
    robot.wait(0.45)
    x2, y2, heading2 = robot.wait(1.0)
    along = (x2 - x) * math.cos(heading) + (y2 - y) * math.sin(heading)
    assert along == pytest.approx(0.45 * forward, abs=abs(forward) * STEP + 1e-9)
    assert math.remainder(heading2 - heading, math.tau) == pytest.approx(0.45 * turn, abs=abs(turn) * STEP + 1e-9)
    assert robot.wait(5.0) == (x2, y2, heading2)


def test_new_command_takes_place_of_last_one(robot: Drive) -> None:
    robot.command(1.0)
    robot.wait(0.1)
    robot.command(0.0)
    stopped = robot.motion.pose()
    assert robot.wait(0.4) == stopped


@pytest.mark.parametrize("forward", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("turns", [False, True])
def test_a_velocity_that_is_none_is_ignored(robot: Drive, forward: float, turns: bool) -> None:
    robot.command(*((0.0, forward) if turns else (forward, 0.0)))
    assert abs(radius(robot.wait(40.0)) - RADIUS) < 0.2


@pytest.mark.parametrize("turn", [0.0, 0.3, -0.3, 2.0])
@pytest.mark.parametrize("forward", [1.0, 100.0, -3.0])
def test_it_stays_in_its_room(robot: Drive, forward: float, turn: float) -> None:
    robot.drive(forward, turn, 30.0)


@pytest.mark.parametrize("place", [(-5.85, 4.2), (7.1, 4.8), (-7.5, -3.3), (6.2, 2.9), (-7.5, -5.5), (0.0, 0.0)])
def test_it_goes_back_to_its_circle_from_anywhere(robot: Drive, place: tuple[float, float]) -> None:
    """Boxes between the two do not hold it."""
    robot.motion._x, robot.motion._y = place
    robot.command(0.0)
    assert robot.wait(9.5)[:2] == place
    assert abs(radius(robot.wait(50.0)) - RADIUS) < 0.2

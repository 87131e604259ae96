"""The demo's robot drives through its rooms, goes to goals, follows commands for a moment, and hits nothing."""

from __future__ import annotations

import math

import pytest
from geometry_msgs.msg import Twist

from rsb_extras.demo.path_planning import plan
from rsb_extras.demo.robot_motion import RESTS, Motion
from rsb_extras.demo.rooms import ROOMS, TOUR, Waypoint, is_free

STEP = 0.05
KITCHEN, OFFICE = Waypoint(-1.0, 3.0, 1.0), Waypoint(4.0, 2.5, 0.0)
ROUND = 250.0
"""s for which the robot takes at the most to visit all places."""


class Drive:
    def __init__(self, start: Waypoint = TOUR[0]) -> None:
        self.now = 100.0
        self.motion = Motion(lambda: self.now, start)

    def wait(self, seconds: float) -> tuple[float, float, float]:
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            x, y, _ = self.motion.pose()
            assert is_free(x, y)
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

    def comes_to(self, place: Waypoint, seconds: float) -> bool:
        for _ in range(round(seconds)):
            x, y, heading = self.wait(1.0)
            turned = abs(math.remainder(heading - place.heading, math.tau))
            if math.dist((x, y), place[:2]) < 0.2 and turned < 0.1:
                return True
        return False


@pytest.fixture
def robot() -> Drive:
    return Drive()


def test_robot_visits_all_rooms(robot: Drive) -> None:
    poses = [robot.wait(1.0) for _ in range(round(ROUND))]
    seen = {room for room in ROOMS for x, y, _ in poses if room.left < x < room.right and room.bottom < y < room.top}
    assert seen == set(ROOMS)


def test_robot_rests_at_its_dock(robot: Drive) -> None:
    docked = 0
    for _ in range(round(ROUND)):
        robot.wait(1.0)
        docked += robot.motion.is_docked
    assert docked == pytest.approx(RESTS, abs=1.5)


@pytest.mark.parametrize("start", TOUR)
@pytest.mark.parametrize("goal", TOUR)
def test_path_leads_through_free_space(start: Waypoint, goal: Waypoint) -> None:
    path = plan(start[:2], goal[:2])
    assert all(is_free(x, y) for x, y in path)
    assert (tuple(path[0]), tuple(path[-1])) == (start[:2], goal[:2])


def test_speed_limits_its_own_motion(robot: Drive) -> None:
    robot.motion.speed = 0.1
    x, y, _ = robot.motion.pose()
    assert 0.5 < math.dist((x, y), robot.wait(10.0)[:2]) <= 1.0


def test_new_goal_replaces_one_under_way(robot: Drive) -> None:
    robot.motion.go(KITCHEN, decided=1.0)
    robot.wait(3.0)
    robot.motion.go(OFFICE, decided=2.0)
    assert robot.comes_to(OFFICE, 60.0)


def test_older_goal_waits_until_robot_rests(robot: Drive) -> None:
    """A desk repeats its goal. An operator's goal comes first, and then the desk's again."""
    robot.motion.go(KITCHEN, decided=2.0)
    for _ in range(60):
        robot.motion.go(OFFICE, decided=1.0)
        if robot.comes_to(KITCHEN, 1.0):
            break
    else:
        pytest.fail("the robot does not come to the operator's goal")
    for _ in range(60):
        robot.motion.go(OFFICE, decided=1.0)
        if robot.comes_to(OFFICE, 1.0):
            return
    pytest.fail("the robot does not come to the desk's goal")


@pytest.mark.parametrize("wall", [(0.0, 1.2), (-7.2, 5.0), (30.0, 0.0), (-1000.0, -1e9)])
def test_goal_in_wall_leads_beside_it(robot: Drive, wall: tuple[float, float]) -> None:
    robot.motion.go(Waypoint(*wall, 0.0), decided=1.0)
    robot.wait(1.0)
    end = robot.motion.path[-1]
    assert is_free(*end)
    robot.wait(60.0)


@pytest.mark.parametrize(
    "goal", [Waypoint(math.nan, 0.0, 0.0), Waypoint(0.0, math.inf, 0.0), Waypoint(0.0, 0.0, math.nan)]
)
def test_goal_of_no_numbers_is_ignored(robot: Drive, goal: Waypoint) -> None:
    robot.motion.go(goal, decided=1.0)
    robot.wait(1.0)
    assert robot.motion.goal == TOUR[1]


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
    assert robot.comes_to(TOUR[1], 60.0)


@pytest.mark.parametrize("turn", [0.0, 0.3, -0.3, 2.0])
@pytest.mark.parametrize("forward", [1.0, 100.0, -3.0])
def test_it_stays_in_its_room(robot: Drive, forward: float, turn: float) -> None:
    robot.drive(forward, turn, 30.0)


def test_driven_robot_stops_before_wall() -> None:
    robot = Drive(Waypoint(6.0, 0.0, 0.0))
    assert robot.drive(1.0, 0.0, 5.0) == pytest.approx((7.97 - 0.3, 0.0, 0.0), abs=0.11)
    assert robot.motion.velocity == (0.0, 0.0)


@pytest.mark.parametrize("place", [(-3.05, 4.9), (7.3, 4.9), (-4.8, -4.8), (1.2, -5.4), (-7.5, -2.0), (7.5, -0.8)])
def test_it_goes_on_from_anywhere(place: tuple[float, float]) -> None:
    """Furniture between it and its goal does not hold it."""
    robot = Drive(Waypoint(*place, 0.0))
    robot.motion.go(TOUR[1], decided=1.0)
    robot.command(0.0)
    assert robot.wait(9.5)[:2] == place
    assert robot.comes_to(robot.motion.goal, 90.0)

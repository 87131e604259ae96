"""The motion of the simulated robot: it goes round its rooms, to goals, or by commands, and stops at obstacles."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

import numpy as np

from rsb_extras.demo.path_planning import STEP, plan
from rsb_extras.demo.rooms import DOCK, TOUR, Waypoint, is_free

if TYPE_CHECKING:
    from collections.abc import Callable

    from geometry_msgs.msg import Twist

    from rsb_extras.demo.rooms import Floats

SPEED, TOP_SPEED = 0.5, 1.0  # m/s
_TOP_TURN = 1.2  # rad/s
_COMMAND_LASTS, _WAITS = 0.5, 10.0
"""s for which a velocity counts, and after which the robot goes on by itself."""
RESTS = 8.0
"""s at a goal, until it goes on with its tour."""
_ASKED_LASTS = 2.0
"""s for which a goal counts that came while the robot was busy with a later one: who still wants it repeats it."""
_AHEAD = 6
"""Poses of its path by which it looks ahead."""
_THERE, _AT, _TURNED = 0.1, 0.5, 0.05
"""m within which it has reached a place, m within which it is still there, and rad to its heading there."""


class Motion:
    """The pose of the robot.

    Attributes:
        speed: m/s, of its own.
        velocity: m/s and rad/s now.
        wheels: m that its left and its right wheel have rolled.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic, start: Waypoint = TOUR[0]) -> None:
        self._now = now
        self.speed = SPEED
        self.velocity = 0.0, 0.0
        self.wheels = [0.0, 0.0]
        self._x, self._y, self._heading = start
        self._commanded_velocity, self._commanded = (0.0, 0.0), -math.inf
        self._at = now()
        self._tour = 0
        self._goal = start
        self._decided = -math.inf
        self._asked, self._asked_at = start, -math.inf
        self._path: Floats = np.empty((0, 2))
        self._reached: float | None = self._at - RESTS

    def command(self, twist: Twist) -> None:
        """Take a velocity, unless it is infinite or no number."""
        forward, turn = twist.linear.x, twist.angular.z
        if math.isfinite(forward) and math.isfinite(turn):
            self.pose()
            self._commanded_velocity, self._commanded = (forward, turn), self._at

    def go(self, goal: Waypoint, decided: float) -> None:
        """Take a goal, unless the robot is on its way to one that was decided on later (s): it is an old one, repeated.

        Coordinates that are infinite or no number are ignored.
        """
        if not all(map(math.isfinite, goal)):
            return
        self._asked, self._asked_at = goal, self._now()
        if decided > self._decided and goal != self._goal:
            self._decided = decided
            self._start(goal)

    @property
    def path(self) -> Floats:
        """The rest of its path to its goal, a row for each x and y."""
        return self._path

    @property
    def goal(self) -> Waypoint:
        """The place that it goes to, or has reached."""
        return self._goal

    @property
    def is_docked(self) -> bool:
        """Whether it rests at its dock."""
        return self._reached is not None and self._is_at(DOCK)

    def pose(self) -> tuple[float, float, float]:
        """Return where the robot is now: x and y in m, and its heading in rad."""
        now = self._now()
        # A process that was stopped makes no step through a wall: only the end of a step is checked.
        elapsed, self._at = min(0.2, now - self._at), now
        forward, turn = self._wanted(now)
        # No further than half its own size, however fast it is commanded.
        step = max(-0.2, min(0.2, forward * elapsed))
        self._heading = math.remainder(self._heading + turn * elapsed, math.tau)
        before = self._x, self._y
        x, y = self._x + step * math.cos(self._heading), self._y + step * math.sin(self._heading)
        for place in ((x, y), (x, self._y), (self._x, y)):  # it slides along an obstacle
            if is_free(*place):
                self._x, self._y = place
                break
        if elapsed > 0:
            rolled = math.copysign(math.dist(before, (self._x, self._y)), step)
            self.velocity = rolled / elapsed, turn
            for wheel, side in enumerate((-1, 1)):
                self.wheels[wheel] += rolled + side * turn * elapsed * 0.2
        return self._x, self._y, self._heading

    def _wanted(self, now: float) -> tuple[float, float]:
        since = now - self._commanded
        if since < _COMMAND_LASTS:
            return self._commanded_velocity
        if since < _WAITS:
            return 0.0, 0.0
        if self._commanded > -math.inf:  # it has been driven anywhere
            self._commanded = -math.inf
            self._start(self._goal)
        if self._reached is not None and now - self._reached > RESTS:
            self._go_on(now)
        return self._follow(now)

    def _go_on(self, now: float) -> None:
        if now - self._asked_at < _ASKED_LASTS and not self._is_at(self._asked):
            self._start(self._asked)
            return
        self._tour = (self._tour + 1) % len(TOUR)
        self._start(TOUR[self._tour])

    def _start(self, goal: Waypoint) -> None:
        self._goal, self._reached = goal, None
        self._path = plan((self._x, self._y), goal[:2])

    def _follow(self, now: float) -> tuple[float, float]:
        if not len(self._path):
            wrong = math.remainder(self._goal.heading - self._heading, math.tau)
            if self._reached is None and abs(wrong) < _TURNED:
                self._reached = now
            return 0.0, self._turn(wrong) if self._reached is None else 0.0
        far = np.hypot(*(self._path[: 3 * _AHEAD] - (self._x, self._y)).T)
        self._path = self._path[int(far.argmin()) :]
        left = math.dist(self._path[-1], (self._x, self._y))
        if left < _THERE and len(self._path) <= _AHEAD:
            self._path = self._path[:0]
            return 0.0, 0.0
        x, y = self._path[min(_AHEAD, len(self._path) - 1)]
        wrong = math.remainder(math.atan2(y - self._y, x - self._x) - self._heading, math.tau)
        slower = min(1.0, 0.3 + left) if len(self._path) * STEP < 1.0 else 1.0
        return self.speed * slower * max(0.0, math.cos(wrong)) ** 3, self._turn(wrong)

    def _turn(self, wrong: float) -> float:
        return max(-_TOP_TURN, min(_TOP_TURN, 2.5 * wrong))

    def _is_at(self, place: Waypoint) -> bool:
        return math.dist(place[:2], (self._x, self._y)) < _AT

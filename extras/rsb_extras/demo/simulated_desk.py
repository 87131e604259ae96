"""The operators' side of the demo: a desk that sends the robot from room to room, and a fleet's listener."""

from __future__ import annotations

import contextlib
import itertools
import math
import time
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rcl_interfaces.srv import GetParameters
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, LaserScan
from std_msgs.msg import String
from std_srvs.srv import SetBool

from rsb_bridge.feature_api import RosError
from rsb_extras.demo.robot_frames import FrameListener
from rsb_extras.demo.rooms import TOUR
from rsb_extras.demo.simulated_node import CALL_EVERY, LATCHED, SimulatedNode

if TYPE_CHECKING:
    from collections.abc import Iterable

_GOAL_RATE = 1.0  # Hz
_THERE = 0.4
"""m from a goal at which the robot is there."""
_STAYS = 4.0
"""s that the robot stays there: shorter than `robot_motion.RESTS`, after which it goes on by itself."""


class Desk(SimulatedNode):
    """Listens to the robot, sends it from room to room, has its light blink, and looks at its speed."""

    def __init__(self, domain_id: int) -> None:
        super().__init__(domain_id, "simulated_desk")
        self._places = itertools.cycle((*TOUR[1:], TOUR[0]))
        self._place, self._decided = next(self._places), self._stamp()
        self._moved_at = time.monotonic()
        self._counts(LaserScan, "/scan", qos_profile_sensor_data)
        self._counts(Odometry, "/odom", 10, self._see)
        self._counts(OccupancyGrid, "/map", LATCHED)
        self._counts(BatteryState, "/battery_state", 10)
        self._counts(Path, "/plan", 10)
        self._frames: FrameListener | None = None
        with contextlib.suppress(RosError, RuntimeError):  # as the robot
            self._frames = FrameListener(self._node)
        self._publishes(PoseStamped, "/goal_pose", 10, _GOAL_RATE, self._goal)
        self._calls(SetBool, "/set_light", lambda t: SetBool.Request(data=int(t / CALL_EVERY) % 2 == 0))
        self._calls(GetParameters, "/simulated_robot/get_parameters", lambda _: GetParameters.Request(names=["speed"]))

    def close(self) -> None:
        if self._frames is not None:
            self._frames.close()
        super().close()

    def _see(self, odometry: Odometry) -> None:
        """Send it to the next place once it has stayed at this one."""
        seen, start = odometry.pose.pose.position, TOUR[0]
        at = start.x + seen.x, start.y + seen.y  # the heading is 0 there
        now, velocity = time.monotonic(), odometry.twist.twist
        if velocity.linear.x or velocity.angular.z or math.dist(at, self._place[:2]) > _THERE:
            self._moved_at = now
        elif now - self._moved_at > _STAYS:
            self._place, self._decided = next(self._places), self._stamp()

    def _goal(self, _: float) -> PoseStamped:
        """Return the place that it goes to, with the time at which that was decided: so a repetition is none."""
        goal = PoseStamped()
        goal.header.stamp, goal.header.frame_id = self._decided, "map"
        goal.pose.position.x, goal.pose.position.y = self._place[:2]
        goal.pose.orientation.z, goal.pose.orientation.w = (
            math.sin(self._place.heading / 2),
            math.cos(self._place.heading / 2),
        )
        return goal


class FleetListener(SimulatedNode):
    """The control side of a fleet: subscribes to its robots' topics."""

    def __init__(self, domain_id: int, topics: Iterable[str]) -> None:
        super().__init__(domain_id, "simulated_operators_desk")
        for topic in topics:
            kind: Any = BatteryState if topic.endswith("/battery_state") else String
            self._counts(kind, topic, 10)

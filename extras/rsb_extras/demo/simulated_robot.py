"""The demo's robot: it drives through its rooms, and publishes what robots publish."""

from __future__ import annotations

import array
import contextlib
import math
import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point32, PolygonStamped, PoseStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, Image, Imu, JointState, LaserScan
from std_srvs.srv import SetBool

from rsb_bridge.feature_api import RosError
from rsb_extras.demo.robot_frames import Frame, FrameBroadcaster
from rsb_extras.demo.robot_motion import SPEED, TOP_SPEED, Motion
from rsb_extras.demo.room_camera import EYE, room_picture
from rsb_extras.demo.rooms import (
    LASER_HEIGHT,
    RADIUS,
    RESOLUTION,
    SIDE,
    TOUR,
    Waypoint,
    cell_of,
    costs,
    measured_ranges,
    occupancy,
)
from rsb_extras.demo.simulated_node import LATCHED, SimulatedNode
from rsb_extras.demo.textures import surfaces

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

_SCAN_RATE, _ODOM_RATE, _BATTERY_RATE, _CAMERA_RATE = 10.0, 50.0, 1.0, 10.0
_FRAME_RATE, _IMU_RATE, _JOINT_RATE, _COSTMAP_RATE, _SLOW_RATE = 25.0, 25.0, 10.0, 2.0, 1.0
"""Hz."""
_BEAMS, _REACH = 360, 20.0
_LASER_AHEAD = 0.1
"""m from the robot's middle."""
_IMAGE_WIDTH, _IMAGE_HEIGHT = 640, 480
_PLANNED = 2
"""Poses of its path to one that is published, as each takes 76 bytes."""
_LOCAL_SIDE = 64
"""Cells of the rolling costmap's side."""
_WHEEL = 0.1
"""m: radius."""
_CHARGE, _USED, _CHARGED, _LOW = 0.82, 0.0005, 0.02, 0.25
"""Charge of the battery at first, what it loses in 1 s, what it gets in 1 s at the dock, and what is low."""
_WARM_EVERY, _WARM_FOR, _WARM = 60.0, 15.0, 70.0
"""s between two times at which a motor gets warm, s for which it is, and °C."""


class SimulatedRobot(SimulatedNode):
    """Drives through rooms: scan, odometry, a latched map, the battery, a camera, and what navigation shows.

    It takes goals and velocities. It has a light, switched by a service, and a parameter: its speed.
    """

    def __init__(self, domain_id: int) -> None:
        super().__init__(domain_id, "simulated_robot", parameters=True)
        within = FloatingPointRange(from_value=0.0, to_value=TOP_SPEED)
        about = ParameterDescriptor(description="m/s", floating_point_range=[within])
        self._node.declare_parameter("speed", SPEED, about)
        self._node.create_service(SetBool, "/set_light", self._set_light)
        self._lit = False
        self._motion = Motion()
        self._charge, self._charged_at = _CHARGE, 0.0
        self._painting: threading.Thread | None = None
        self._publishes(LaserScan, "/scan", qos_profile_sensor_data, _SCAN_RATE, self._scan)
        self._publishes(Odometry, "/odom", 10, _ODOM_RATE, self._odometry)
        self._publishes(OccupancyGrid, "/map", LATCHED, 0, lambda _: self._grid(occupancy()))
        self._publishes(OccupancyGrid, "/global_costmap/costmap", LATCHED, 0, lambda _: self._grid(costs()))
        self._publishes(BatteryState, "/battery_state", 10, _BATTERY_RATE, self._battery)
        # Reliable: the fragments of so large a message overrun a socket's buffer, and 4 of 10 pictures got lost.
        self._shows(Image, "/camera/image_raw", 1, _CAMERA_RATE, self._image)
        self._shows(OccupancyGrid, "/local_costmap/costmap", 10, _COSTMAP_RATE, self._local_costmap)
        self._shows(Path, "/plan", 10, _SLOW_RATE, self._plan)
        self._shows(PolygonStamped, "/footprint", 10, _COSTMAP_RATE, self._footprint)
        self._shows(Imu, "/imu", qos_profile_sensor_data, _IMU_RATE, self._imu)
        self._shows(JointState, "/joint_states", 10, _JOINT_RATE, self._joints)
        self._shows(DiagnosticArray, "/diagnostics", 10, _SLOW_RATE, self._diagnostics)
        self._counts(PoseStamped, "/goal_pose", 10, self._go)
        self._counts(Twist, "/cmd_vel", 10, self._motion.command)
        fixed = (
            Frame("base_link", "laser", x=_LASER_AHEAD, z=LASER_HEIGHT),
            Frame("base_link", "camera", z=EYE),
        )
        self._frames: FrameBroadcaster | None = None
        with contextlib.suppress(RosError, RuntimeError):  # without the package tf2_msgs in a ROS that needs it
            self._frames = frames = FrameBroadcaster(self._node, fixed)
            self.every(1 / _FRAME_RATE, lambda: frames.publish(self._moving_frames))

    def close(self) -> None:
        if self._frames is not None:
            self._frames.close()
        super().close()

    def _moving_frames(self) -> Iterator[Frame]:
        # Odometry begins where the robot does.
        yield Frame("map", "odom", TOUR[0].x, TOUR[0].y, heading=TOUR[0].heading)
        x, y, heading = self._in_odom()
        yield Frame("odom", "base_link", x, y, heading=heading)

    def _in_odom(self) -> tuple[float, float, float]:
        x, y, heading = self._motion.pose()
        x, y, turned = x - TOUR[0].x, y - TOUR[0].y, -TOUR[0].heading
        cos, sin = math.cos(turned), math.sin(turned)
        return cos * x - sin * y, sin * x + cos * y, heading + turned

    def _go(self, goal: PoseStamped) -> None:
        if goal.header.frame_id.removeprefix("/") not in {"map", ""}:
            return
        position, turn, stamp = goal.pose.position, goal.pose.orientation, goal.header.stamp
        heading = 2 * math.atan2(turn.z, turn.w)
        decided = stamp.sec + stamp.nanosec / 1e9
        self._motion.go(Waypoint(position.x, position.y, heading), decided or time.time())

    def _scan(self, _: float) -> LaserScan:
        scan = LaserScan(angle_min=-math.pi, angle_max=math.pi, angle_increment=2 * math.pi / _BEAMS)
        scan.header.stamp, scan.header.frame_id = self._stamp(), "laser"
        scan.time_increment, scan.scan_time, scan.range_min, scan.range_max = 0.0, 1 / _SCAN_RATE, 0.1, _REACH
        x, y, heading = self._motion.pose()
        angles = heading + scan.angle_min + np.arange(_BEAMS) * scan.angle_increment
        ahead = _LASER_AHEAD * math.cos(heading), _LASER_AHEAD * math.sin(heading)
        scan.ranges = measured_ranges(x + ahead[0], y + ahead[1], angles).astype(np.float32)
        scan.intensities = [100.0] * _BEAMS
        return scan

    def _odometry(self, _: float) -> Odometry:
        odometry = Odometry(child_frame_id="base_link")
        odometry.header.stamp, odometry.header.frame_id = self._stamp(), "odom"
        self._motion.speed = self._node.get_parameter("speed").value
        x, y, heading = self._in_odom()
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = x, y
        odometry.pose.pose.orientation.z = math.sin(heading / 2)
        odometry.pose.pose.orientation.w = math.cos(heading / 2)
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = self._motion.velocity
        return odometry

    def _grid(self, cells: NDArray[np.int8], row: int = 0, column: int = 0) -> OccupancyGrid:
        """Return a part of the map that begins at a cell of it."""
        grid = OccupancyGrid()
        grid.header.stamp, grid.header.frame_id = self._stamp(), "map"
        grid.info.resolution, (grid.info.height, grid.info.width) = RESOLUTION, cells.shape
        grid.info.origin.position.x = (column - SIDE // 2) * RESOLUTION
        grid.info.origin.position.y = (row - SIDE // 2) * RESOLUTION
        grid.data = array.array("b", cells.tobytes())
        return grid

    def _local_costmap(self) -> OccupancyGrid:
        row, column = (each - _LOCAL_SIDE // 2 for each in cell_of(*self._motion.pose()[:2]))
        row, column = (max(0, min(SIDE - _LOCAL_SIDE, each)) for each in (row, column))
        return self._grid(costs()[row : row + _LOCAL_SIDE, column : column + _LOCAL_SIDE], row, column)

    def _plan(self) -> Path:
        path = Path()
        path.header.stamp, path.header.frame_id = self._stamp(), "map"
        for x, y in self._motion.path[::-_PLANNED][::-1].tolist():
            pose = PoseStamped(header=path.header)
            pose.pose.position.x, pose.pose.position.y = x, y
            path.poses.append(pose)
        return path

    def _footprint(self) -> PolygonStamped:
        footprint = PolygonStamped()
        footprint.header.stamp, footprint.header.frame_id = self._stamp(), "base_link"
        corners = (math.tau * corner / 12 for corner in range(12))
        footprint.polygon.points = [Point32(x=RADIUS * math.cos(at), y=RADIUS * math.sin(at)) for at in corners]
        return footprint

    def _imu(self) -> Imu:
        imu = Imu()
        imu.header.stamp, imu.header.frame_id = self._stamp(), "base_link"
        heading = self._in_odom()[2]
        imu.orientation.z, imu.orientation.w = math.sin(heading / 2), math.cos(heading / 2)
        forward, turn = self._motion.velocity
        imu.angular_velocity.z = turn
        imu.linear_acceleration.y, imu.linear_acceleration.z = forward * turn, 9.81
        return imu

    def _joints(self) -> JointState:
        self._motion.pose()
        forward, turn = self._motion.velocity
        joints = JointState(name=["left_wheel", "right_wheel"])
        joints.header.stamp = self._stamp()
        joints.position = [rolled / _WHEEL for rolled in self._motion.wheels]
        joints.velocity = [(forward + side * turn * 0.2) / _WHEEL for side in (-1, 1)]
        return joints

    def _battery(self, t: float) -> BatteryState:
        passed, self._charged_at = t - self._charged_at, t
        self._charge += passed * (_CHARGED if self._motion.is_docked else -_USED)
        self._charge = max(0.05, min(1.0, self._charge))
        battery = BatteryState(voltage=21 + 4 * self._charge, percentage=self._charge, present=True)
        battery.header.stamp = self._stamp()
        battery.current = 4.0 if self._motion.is_docked else -1.5
        battery.power_supply_status = (
            BatteryState.POWER_SUPPLY_STATUS_CHARGING
            if self._motion.is_docked
            else BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
        )
        return battery

    def _diagnostics(self) -> DiagnosticArray:
        t = time.monotonic() - self._began
        warm = _WARM if t % _WARM_EVERY > _WARM_EVERY - _WARM_FOR else 41.0
        goal = self._motion.goal
        found = DiagnosticArray()
        found.header.stamp = self._stamp()
        found.status = [
            _status("base: left motor", "warm" if warm >= _WARM else "", temperature=f"{warm:.0f} °C"),
            _status("base: right motor", temperature="40 °C"),
            _status("base: battery", "low" if self._charge < _LOW else "", charge=f"{self._charge:.0%}"),
            _status("sensors: laser", rate=f"{_SCAN_RATE:g} Hz", beams=str(_BEAMS)),
            _status("sensors: camera", size=f"{_IMAGE_WIDTH}x{_IMAGE_HEIGHT}"),
            _status("navigation: planner", goal=f"{goal.x:.1f}, {goal.y:.1f}", poses=str(len(self._motion.path))),
        ]
        return found

    def _image(self) -> Image | None:
        if self._painting is None:
            # Beside the executor: it takes half a second, in which nothing else would be published.
            self._painting = threading.Thread(target=surfaces, daemon=True)
            self._painting.start()
        if self._painting.is_alive():
            return None
        image = Image(width=_IMAGE_WIDTH, height=_IMAGE_HEIGHT, encoding="rgb8", step=3 * _IMAGE_WIDTH)
        image.header.stamp, image.header.frame_id = self._stamp(), "camera"
        goal = self._motion.goal[:2] if len(self._motion.path) else None
        picture = room_picture(*self._motion.pose(), _IMAGE_WIDTH, _IMAGE_HEIGHT, goal)
        image.data = array.array("B", picture.tobytes())
        return image

    def _set_light(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        was, self._lit = self._lit, request.data
        response.success = True
        response.message = f"the light is {'on' if self._lit else 'off'}{' already' if was == self._lit else ''}"
        return response


def _status(name: str, warning: str = "", **values: Any) -> DiagnosticStatus:
    level = DiagnosticStatus.WARN if warning else DiagnosticStatus.OK
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(level=level, name=name, message=warning or "OK", hardware_id="simulated", values=pairs)

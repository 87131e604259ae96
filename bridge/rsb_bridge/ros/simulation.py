"""The demo's simulated robot, its room, and its desk: real topics, about the sizes of the thesis's table 3.1.

Run as ``python -m rsb_bridge.ros.simulation robot|desk|listener DOMAIN [TOPIC...]``: it prints a JSON line of message
counts by topic every second, and ends with its standard input, so that it never outlives its starter. A line of its
standard input is a topic that it stops publishing. The listener subscribes to topics of simulated robots.
"""

from __future__ import annotations

import argparse
import array
import json
import math
import select
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, Image, LaserScan
from std_msgs.msg import String
from std_srvs.srv import SetBool

from rsb_bridge.ros.self_test import ARGUMENTS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SCAN_RATE, ODOM_RATE, BATTERY_RATE, GOAL_RATE, CAMERA_RATE = 10.0, 50.0, 1.0, 1.0, 10.0
"""Hz."""
_BEAMS = 360
_MAP_SIDE, _MAP_RESOLUTION = 384, 0.05  # cells, m
_IMAGE_WIDTH, _IMAGE_HEIGHT = 320, 240
_CIRCLE, _TURNS = 2.0, 0.2
"""m, and rad/s: the robot's way around the middle of its room."""
_MARGIN = 0.35
"""m: the robot's radius."""
_COMMAND_LASTS, _WAITS = 0.5, 10.0
"""s for which a velocity counts, and after which the robot goes back to its course."""
_CALL_EVERY = 2.0  # s
_SPEED, _TOP_SPEED = 0.2, 1.0  # m/s
_LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


_WALL, _BOX, _CRATE, _DOOR = (178, 172, 160), (196, 92, 60), (70, 118, 176), (120, 150, 80)
_LEFT, _RIGHT, _BOTTOM, _TOP = -8.0, 8.0, -6.0, 6.0
_BOXES = (
    (3.5, 2.5, 5.0, 4.0, _BOX),
    (-6.0, -4.5, -4.0, -3.0, _CRATE),
    (-5.0, 3.0, -4.2, 3.8, _DOOR),
    (4.5, -3.5, 5.1, -2.9, _BOX),
)
"""Left, bottom, right and top in m, and colour."""
_EYE, _HEIGHT = 0.6, 2.4
"""m: of the camera, and of the walls."""
_FIELD = 0.9
"""Half of the camera's field of view, as a tangent."""
_TILE = 1.0
_OCCUPIED, _UNKNOWN = 100, -1


def _edges(left: float, bottom: float, right: float, top: float) -> list[tuple[float, float, float, float]]:
    return [
        (left, bottom, right, bottom),
        (right, bottom, right, top),
        (right, top, left, top),
        (left, top, left, bottom),
    ]


_SEGMENTS = np.array([*_edges(_LEFT, _BOTTOM, _RIGHT, _TOP), *(e for box in _BOXES for e in _edges(*box[:4]))])
_COLOURS = np.array([_WALL] * 4 + [box[4] for box in _BOXES for _ in range(4)], dtype=float)
_SHADES = np.array([0.9, 0.75, 1.0, 0.65] * (1 + len(_BOXES)))


class Simulation:
    """A node that publishes and subscribes, and counts both.

    Attributes:
        muted: topics that are not published any more, though their publishers stay.
    """

    def __init__(self, domain_id: int, name: str, *, parameters: bool = False) -> None:
        self.published: dict[str, int] = {}
        self.muted: set[str] = set()
        self.received: dict[str, int] = {}
        self._context = Context()
        self._context.init(ARGUMENTS, domain_id=domain_id)
        self._node = Node(name, context=self._context, enable_rosout=False, start_parameter_services=parameters)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._began = time.monotonic()

    def spin_once(self, timeout: float) -> None:
        """Handle one message or timer, or wait for up to `timeout` s."""
        self._executor.spin_once(timeout)

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.shutdown()

    def _publishes(self, kind: type, topic: str, qos: Any, rate: float, make: Callable[[float], Any]) -> None:
        publisher = self._node.create_publisher(kind, topic, qos)
        self.published[topic] = 0

        def publish() -> None:
            if topic in self.muted:
                return
            publisher.publish(make(time.monotonic() - self._began))
            self.published[topic] += 1

        if rate:
            self._node.create_timer(1 / rate, publish)
        else:
            publish()

    def _counts(self, kind: type, topic: str, qos: Any, take: Callable[[Any], None] | None = None) -> None:
        self.received[topic] = 0

        def count(message: Any) -> None:
            self.received[topic] += 1
            if take is not None:
                take(message)

        self._node.create_subscription(kind, topic, count, qos)

    def _calls(self, kind: Any, service: str, make: Callable[[float], Any]) -> None:
        client = self._node.create_client(kind, service)
        pending: list[Any] = []

        def call() -> None:
            while pending:  # an answer that has not come by now does not matter any more
                client.remove_pending_request(pending.pop())
            if client.service_is_ready():
                pending.append(client.call_async(make(time.monotonic() - self._began)))

        self._node.create_timer(_CALL_EVERY, call)

    def _stamp(self) -> Any:
        return self._node.get_clock().now().to_msg()


def is_free(x: float, y: float, margin: float) -> bool:
    """Whether a robot fits at a place in m: no wall and no box is nearer than `margin` m."""
    if not (_LEFT + margin < x < _RIGHT - margin and _BOTTOM + margin < y < _TOP - margin):
        return False
    boxes = (box[:4] for box in _BOXES)
    return not any(a - margin < x < c + margin and b - margin < y < d + margin for a, b, c, d in boxes)


def _cast(x: float, y: float, directions: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return the distance at which each ray hits, in lengths of its direction, and the segment that it hits."""
    start, across = _SEGMENTS[:, :2] - (x, y), _SEGMENTS[:, 2:] - _SEGMENTS[:, :2]
    turned = directions[:, None, 0] * across[None, :, 1] - directions[:, None, 1] * across[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (start[:, 0] * across[:, 1] - start[:, 1] * across[:, 0]) / turned
        part = (start[None, :, 0] * directions[:, None, 1] - start[None, :, 1] * directions[:, None, 0]) / turned
    hit = np.where((along > 1e-6) & (part >= 0) & (part <= 1), along, np.inf)
    return hit.min(axis=1), hit.argmin(axis=1)


def room_ranges(x: float, y: float, heading: float, angles: Floats) -> Floats:
    """Return the distances in m that a laser scanner measures.

    Args:
        x: m.
        y: m.
        heading: rad.
        angles: rad, of the beams to the heading.
    """
    turned = heading + angles
    return _cast(x, y, np.stack([np.cos(turned), np.sin(turned)], axis=1))[0]


def room_image(x: float, y: float, heading: float, width: int, height: int) -> bytes:
    """Return what a camera sees, as rgb8, row by row.

    Args:
        x: m.
        y: m.
        heading: rad.
    """
    ahead = np.array([np.cos(heading), np.sin(heading)])
    right = np.array([np.sin(heading), -np.cos(heading)])
    across = np.linspace(-_FIELD, _FIELD, width)
    rays = ahead + across[:, None] * right
    depth, segment = _cast(x, y, rays)
    focal = width / 2 / _FIELD
    rows = np.arange(height)[:, None] - height / 2 + 0.5
    picture = np.empty((height, width, 3))
    below = np.maximum(rows, 0.5)
    floor_x, floor_y = x + rays[:, 0] * _EYE * focal / below, y + rays[:, 1] * _EYE * focal / below
    tiles = (np.floor(floor_x / _TILE) + np.floor(floor_y / _TILE)) % 2
    fog = np.clip(1.2 - _EYE * focal / below / 12, 0.25, 1)
    picture[:] = ((80 + 45 * tiles) * fog)[:, :, None] * (1.0, 0.97, 0.9)
    picture[: height // 2] = (np.linspace(210, 150, height)[: height // 2, None] * np.ones(width))[:, :, None]
    is_wall = (rows < _EYE * focal / depth) & (rows > -(_HEIGHT - _EYE) * focal / depth)
    light = _SHADES[segment] * np.clip(1.25 - depth / 12, 0.2, 1)
    picture = np.where(is_wall[:, :, None], (_COLOURS[segment] * light[:, None])[None], picture)
    return picture.clip(0, 255).astype(np.uint8).tobytes()


def room_grid(side: int, resolution: float) -> list[int]:
    """Return a square map around the origin: 0 free, 100 occupied, -1 unknown.

    Args:
        side: cells.
        resolution: m a cell.
    """
    at = (np.arange(side) + 0.5 - side / 2) * resolution
    column, row = np.meshgrid(at, at)
    cells = np.full((side, side), _UNKNOWN)
    margin = 2 * resolution
    cells[(column > _LEFT - margin) & (column < _RIGHT + margin) & (row > _BOTTOM - margin) & (row < _TOP + margin)] = (
        100
    )
    cells[(column > _LEFT) & (column < _RIGHT) & (row > _BOTTOM) & (row < _TOP)] = 0
    for left, bottom, right, top, _ in _BOXES:
        cells[(column > left) & (column < right) & (row > bottom) & (row < top)] = _OCCUPIED
    values: list[int] = cells.ravel().tolist()
    return values


class Motion:
    """The place of the robot: it drives in a circle, or by commands."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._x, self._y, self._heading = _CIRCLE, 0.0, math.pi / 2
        self._velocity = 0.0, 0.0
        self._commanded = -math.inf
        self._at = now()

    def command(self, twist: Twist) -> None:
        """Take a velocity, unless it is infinite or no number."""
        forward, turn = twist.linear.x, twist.angular.z
        if math.isfinite(forward) and math.isfinite(turn):
            self.pose()
            self._velocity, self._commanded = (forward, turn), self._at

    def pose(self) -> tuple[float, float, float]:
        """Return where the robot is now: x and y in m, and its heading in rad."""
        now = self._now()
        # A process that was stopped makes no step through a wall: only the end of a step is checked.
        elapsed, self._at = min(0.2, now - self._at), now
        forward, turn = self._wanted(now)
        self._heading = math.remainder(self._heading + turn * elapsed, math.tau)
        x = self._x + forward * elapsed * math.cos(self._heading)
        y = self._y + forward * elapsed * math.sin(self._heading)
        for place in ((x, y), (x, self._y), (self._x, y)):  # it slides along an obstacle
            if is_free(*place, _MARGIN):
                self._x, self._y = place
                break
        return self._x, self._y, self._heading

    def _wanted(self, now: float) -> tuple[float, float]:
        since = now - self._commanded
        if since < _COMMAND_LASTS:
            return self._velocity
        if since < _WAITS:
            return 0.0, 0.0
        ahead = math.atan2(self._y, self._x) + 0.4
        target_x, target_y = _CIRCLE * math.cos(ahead), _CIRCLE * math.sin(ahead)
        wrong = math.remainder(math.atan2(target_y - self._y, target_x - self._x) - self._heading, math.tau)
        return _CIRCLE * _TURNS * max(0.0, math.cos(wrong)), max(-1.0, min(1.0, 2 * wrong))


class SimulatedRobot(Simulation):
    """Drives a circle in a room: scan, odometry, a latched map, the battery, a camera; takes goals.

    It has a light, switched by a service, and a parameter: its speed.
    """

    def __init__(self, domain_id: int) -> None:
        super().__init__(domain_id, "simulated_robot", parameters=True)
        within = FloatingPointRange(from_value=0.0, to_value=_TOP_SPEED)
        about = ParameterDescriptor(description="m/s", floating_point_range=[within])
        self._node.declare_parameter("speed", _SPEED, about)
        self._node.create_service(SetBool, "/set_light", self._set_light)
        self._lit = False
        self._motion = Motion()
        self._publishes(LaserScan, "/scan", qos_profile_sensor_data, SCAN_RATE, self._scan)
        self._publishes(Odometry, "/odom", 10, ODOM_RATE, self._odometry)
        self._publishes(OccupancyGrid, "/map", _LATCHED, 0, self._map)
        self._publishes(BatteryState, "/battery_state", 10, BATTERY_RATE, self._battery)
        self._publishes_images("/camera/image_raw")
        self._counts(PoseStamped, "/goal_pose", 10)
        self._counts(Twist, "/cmd_vel", 10, self._motion.command)

    def _scan(self, _: float) -> LaserScan:
        scan = LaserScan(angle_min=-math.pi, angle_max=math.pi, angle_increment=2 * math.pi / _BEAMS)
        scan.header.stamp, scan.header.frame_id = self._stamp(), "base_link"
        scan.time_increment, scan.scan_time, scan.range_min, scan.range_max = 0.0, 1 / SCAN_RATE, 0.1, 12.0
        angles = scan.angle_min + np.arange(_BEAMS) * scan.angle_increment
        scan.ranges = room_ranges(*self._motion.pose(), angles).astype(np.float32)
        scan.intensities = [100.0] * _BEAMS
        return scan

    def _odometry(self, _: float) -> Odometry:
        odometry = Odometry(child_frame_id="base_link")
        odometry.header.stamp, odometry.header.frame_id = self._stamp(), "map"
        x, y, heading = self._motion.pose()
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = x, y
        odometry.pose.pose.orientation.z = math.sin(heading / 2)
        odometry.pose.pose.orientation.w = math.cos(heading / 2)
        odometry.twist.twist.linear.x = self._node.get_parameter("speed").value
        return odometry

    def _map(self, _: float) -> OccupancyGrid:
        grid = OccupancyGrid()
        grid.header.stamp, grid.header.frame_id = self._stamp(), "map"
        grid.info.resolution, grid.info.width, grid.info.height = _MAP_RESOLUTION, _MAP_SIDE, _MAP_SIDE
        grid.info.origin.position.x = grid.info.origin.position.y = -_MAP_SIDE * _MAP_RESOLUTION / 2
        grid.data = room_grid(_MAP_SIDE, _MAP_RESOLUTION)
        return grid

    def _battery(self, t: float) -> BatteryState:
        charge = 1 - t / 7200 % 1
        battery = BatteryState(voltage=21 + 4 * charge, percentage=charge, present=True)
        battery.header.stamp = self._stamp()
        battery.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
        return battery

    def _publishes_images(self, topic: str) -> None:
        """Publish what a camera sees, while anybody subscribes: images are large."""
        publisher = self._node.create_publisher(Image, topic, qos_profile_sensor_data)

        def publish() -> None:
            if publisher.get_subscription_count():
                publisher.publish(self._image())

        self._node.create_timer(1 / CAMERA_RATE, publish)

    def _image(self) -> Image:
        image = Image(width=_IMAGE_WIDTH, height=_IMAGE_HEIGHT, encoding="rgb8", step=3 * _IMAGE_WIDTH)
        image.header.stamp, image.header.frame_id = self._stamp(), "camera"
        image.data = array.array("B", room_image(*self._motion.pose(), _IMAGE_WIDTH, _IMAGE_HEIGHT))
        return image

    def _set_light(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        was, self._lit = self._lit, request.data
        response.success = True
        response.message = f"the light is {'on' if self._lit else 'off'}{' already' if was == self._lit else ''}"
        return response


class Desk(Simulation):
    """The control PC's side: listens to the robot, sends it goals, has its light blink, and looks at its speed."""

    def __init__(self, domain_id: int) -> None:
        super().__init__(domain_id, "simulated_desk")
        self._counts(LaserScan, "/scan", qos_profile_sensor_data)
        self._counts(Odometry, "/odom", 10)
        self._counts(OccupancyGrid, "/map", _LATCHED)
        self._counts(BatteryState, "/battery_state", 10)
        self._publishes(PoseStamped, "/goal_pose", 10, GOAL_RATE, self._goal)
        self._calls(SetBool, "/set_light", lambda t: SetBool.Request(data=int(t / _CALL_EVERY) % 2 == 0))
        self._calls(GetParameters, "/simulated_robot/get_parameters", lambda _: GetParameters.Request(names=["speed"]))

    def _goal(self, t: float) -> PoseStamped:
        goal = PoseStamped()
        goal.header.stamp, goal.header.frame_id = self._stamp(), "map"
        goal.pose.position.x = math.cos(t / 20)
        goal.pose.orientation.w = 1.0
        return goal


class FleetListener(Simulation):
    """The control side of a fleet: subscribes to its robots' topics."""

    def __init__(self, domain_id: int, topics: Iterable[str]) -> None:
        super().__init__(domain_id, "simulated_operators_desk")
        for topic in topics:
            self._counts(BatteryState if topic.endswith("/battery_state") else String, topic, 10)


def main() -> None:
    """Simulate until standard input ends."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("robot", "desk", "listener"))
    parser.add_argument("domain", type=int)
    parser.add_argument("topics", nargs="*")
    arguments = parser.parse_args()
    simulation = _part(arguments.part, arguments.domain, arguments.topics)
    next_line = 0.0
    while True:
        if select.select([sys.stdin], [], [], 0)[0]:
            line = sys.stdin.readline()
            if not line:
                break
            simulation.muted.add(line.strip())
        simulation.spin_once(0.1)
        if time.monotonic() >= next_line:
            next_line = time.monotonic() + 1.0
            _report(simulation)
    _report(simulation)
    simulation.close()


def _part(name: str, domain: int, topics: Sequence[str]) -> Simulation:
    if name == "listener":
        return FleetListener(domain, topics)
    return SimulatedRobot(domain) if name == "robot" else Desk(domain)


def _report(simulation: Simulation) -> None:
    sys.stdout.write(json.dumps({"published": simulation.published, "received": simulation.received}) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()

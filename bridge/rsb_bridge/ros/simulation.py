"""A simulated robot and the desk it talks to, for the demo: real topics, about the sizes of the thesis's table 3.1.

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
import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import BatteryState, Image, LaserScan
from std_msgs.msg import String
from std_srvs.srv import SetBool

from rsb_bridge.ros import simulated_room

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

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
        rclpy.init(context=self._context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
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
        rclpy.shutdown(context=self._context)

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
            if simulated_room.is_free(*place, _MARGIN):
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
        scan.ranges = simulated_room.ranges(*self._motion.pose(), angles).astype(np.float32)
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
        grid.data = simulated_room.grid(_MAP_SIDE, _MAP_RESOLUTION)
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
        image.data = array.array("B", simulated_room.image(*self._motion.pose(), _IMAGE_WIDTH, _IMAGE_HEIGHT))
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

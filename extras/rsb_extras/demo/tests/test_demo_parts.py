"""The demo's robot and desk, as processes of their own."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from nav_msgs.msg import Path as Plan
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image, LaserScan
from tests.support.domain import BEST_EFFORT, LATCHED, RELIABLE
from tests.support.waiting import eventually

from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import read_description
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_extras.demo.demo_session import SimulatedPart
from rsb_extras.demo.rooms import TOUR, is_free

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.support.domain import Domain

    from rsb_bridge.ros.node import RosNode

TFMESSAGE = "tf2_msgs/msg/TFMessage"


@pytest.fixture
def part(robot: Domain, tmp_path: Path) -> Iterator[SimulatedPart]:
    part = SimulatedPart.start("robot", robot.id, tmp_path)
    yield part
    part.stop()


def newest(robot: Domain, topic: str, kind: Any, qos: Any = RELIABLE) -> Callable[[], Any]:
    """Return a function that returns the newest message of a topic, once there is one."""
    listener = robot.listener(topic, kind, qos)

    def take() -> Any:
        eventually(lambda: listener.payloads, what=topic)
        return deserialize_message(listener.payloads[-1], kind)

    return take


def test_robot_publishes_without_home(robot: Domain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under a service manager, or with ``env -i``, ROS has no folder for its log."""
    for name in ("HOME", "ROS_HOME", "ROS_LOG_DIR"):
        monkeypatch.delenv(name, raising=False)
    part = SimulatedPart.start("robot", robot.id, tmp_path)
    try:
        eventually(lambda: part.published.get("/odom"), what="published")
    finally:
        part.stop()
    assert [each.name for each in tmp_path.iterdir()] == ["robot.log"], "no log of ROS"


@pytest.mark.usefixtures("part")
def test_frames_lay_scan_on_map(robot: Domain, open_node: Callable[..., RosNode]) -> None:
    """The robot stands at first. Where a wheel lacks the type of frames, the robot describes it."""
    node = open_node(robot.id, "rsb_viewer")
    drive = robot.publisher("/cmd_vel", Twist)
    frames: dict[str, tuple[str, float, float, float]] = {}
    eventually(lambda: node.publishers("/tf") and node.publishers("/tf_static"), what="frames")
    type_hash = node.publishers("/tf")[0].type_hash
    text = eventually(
        lambda: node.ask_description("/robot_state_publisher", TFMESSAGE, type_hash, lambda: True), what="a description"
    )
    description = read_description(text, type_hash)

    def take(batch: Any) -> None:
        for sample in batch:
            transforms: Any = decode(description, sample.payload).message["transforms"]
            for each in transforms.shown:
                place, turn = each["transform"]["translation"], each["transform"]["rotation"]
                heading = 2 * math.atan2(turn["z"], turn["w"])
                frames[each["child_frame_id"]] = each["header"]["frame_id"], place["x"], place["y"], heading

    for topic, qos in (("/tf", Qos()), ("/tf_static", Qos(durability="transient_local"))):
        node.subscribe(TopicSpec(topic, TFMESSAGE, type_hash, qos), take, "link")
    odometry = newest(robot, "/odom", Odometry)
    scans = newest(robot, "/scan", LaserScan, BEST_EFFORT)

    def stands() -> bool:
        drive.publish(Twist())
        velocity = odometry().twist.twist
        return not velocity.linear.x and not velocity.angular.z and frames.keys() >= {"odom", "base_link", "laser"}

    eventually(stands, what="a robot that stands")
    stamp = scans().header.stamp
    eventually(lambda: drive.publish(Twist()) or scans().header.stamp != stamp, what="another scan")
    frames.pop("base_link")
    eventually(lambda: drive.publish(Twist()) or "base_link" in frames, what="another pose")
    scan, grid = scans(), newest(robot, "/map", OccupancyGrid, LATCHED)()
    angles = scan.angle_min + np.arange(len(scan.ranges)) * scan.angle_increment
    x, y = np.array(scan.ranges) * np.cos(angles), np.array(scan.ranges) * np.sin(angles)
    frame = scan.header.frame_id
    while frame != grid.header.frame_id:
        frame, left, up, heading = frames[frame]
        x, y = left + math.cos(heading) * x - math.sin(heading) * y, up + math.sin(heading) * x + math.cos(heading) * y
    cells = np.array(grid.data).reshape(grid.info.height, grid.info.width)
    columns = ((x - grid.info.origin.position.x) / grid.info.resolution).astype(int)
    rows = ((y - grid.info.origin.position.y) / grid.info.resolution).astype(int)
    assert all(
        (cells[row - 1 : row + 2, column - 1 : column + 2] == 100).any()
        for row, column in zip(rows, columns, strict=True)
    )


@pytest.mark.usefixtures("part")
def test_goal_leads_robot_there(robot: Domain) -> None:
    odometry, plans = newest(robot, "/odom", Odometry), newest(robot, "/plan", Plan)
    goal = PoseStamped()
    goal.header.frame_id = "map"
    goal.pose.position.x, goal.pose.position.y, goal.pose.orientation.w = -4.6, -0.2, 1.0
    sends = robot.publisher("/goal_pose", PoseStamped)

    def is_there() -> bool:
        goal.header.stamp = robot.node.get_clock().now().to_msg()
        sends.publish(goal)
        at = odometry().pose.pose.position
        return math.dist((TOUR[0].x + at.x, TOUR[0].y + at.y), (-4.6, -0.2)) < 0.2

    def leads_there() -> bool:
        is_there()
        poses = plans().poses
        return bool(poses) and math.dist((poses[-1].pose.position.x, poses[-1].pose.position.y), (-4.6, -0.2)) < 0.05

    eventually(leads_there, what="a path to the goal")
    eventually(is_there, what="the goal")


@pytest.mark.usefixtures("part")
def test_camera_pictures_come_while_wanted(robot: Domain) -> None:
    image = newest(robot, "/camera/image_raw", Image)()
    assert (image.encoding, image.header.frame_id, len(image.data)) == ("rgb8", "camera", image.step * image.height)
    assert np.array(image.data).std() > 20


@pytest.mark.usefixtures("part")
def test_velocity_drives_robot_up_to_wall(robot: Domain) -> None:
    """Backwards, as the wall behind it is near."""
    odometry, drives = newest(robot, "/odom", Odometry), robot.publisher("/cmd_vel", Twist)
    back = Twist()
    back.linear.x = -1.0
    seen = []

    def stops() -> bool:
        drives.publish(back)
        at, velocity = odometry().pose.pose.position, odometry().twist.twist
        seen.append((TOUR[0].x + at.x, TOUR[0].y + at.y))
        return seen[-1][0] < TOUR[0].x - 0.5 and not velocity.linear.x

    eventually(stops, what="a robot that stands at a wall")
    assert all(is_free(x, y, 0.29) for x, y in seen)

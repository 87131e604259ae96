"""What may move a robot, by type and by name."""

from __future__ import annotations

import pytest

from rsb_bridge.cdr.known_types import DRIVING_TYPES
from rsb_bridge.model.motion import NAMES_OF_MOTION, may_move

TYPES = (
    *DRIVING_TYPES,
    *("JointTrajectory", "trajectory_msgs/msg/JointTrajectory", "control_msgs/msg/JointJog", "Twist"),
    *("actuator_msgs/msg/Actuators", "mavros_msgs/msg/PositionTarget", "px4_msgs/msg/TrajectorySetpoint"),
)
NAMES = (
    *NAMES_OF_MOTION,
    *("/forward_position_controller/commands", "/gripper/command", "/robot1/cmd_pose", "/cmd", "/base_cmd", "/joy"),
    *("/mavros/setpoint_velocity/cmd_vel_unstamped", "/fmu/in/trajectory_setpoint", "/cmd*"),
)


@pytest.mark.parametrize("type_name", sorted(TYPES))
def test_type_of_command_may_move(type_name: str) -> None:
    assert may_move(type_name, "/any", "/name")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("type_name", ["", "auto", "std_msgs/msg/Float64MultiArray"])
def test_name_of_command_may_move(name: str, type_name: str) -> None:
    assert may_move(type_name, name, "/other")
    assert may_move(type_name, "/other", name)


@pytest.mark.parametrize(
    ("type_name", "name"),
    [
        *(("auto", name) for name in ("/scan", "/joystick_state", "/tf", "/joint_states", "/commanded", "/rosout")),
        *((name, "/x") for name in ("std_msgs/msg/String", "px4_msgs/msg/VehicleCommandAck", "nav_msgs/msg/Odometry")),
        ("sensor_msgs/msg/JoyFeedback", "/joy/set_feedback"),
    ],
)
def test_other_topics_move_nothing(type_name: str, name: str) -> None:
    assert not may_move(type_name, name)

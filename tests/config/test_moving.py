"""Topics that are taken for commands that move a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from rsb_bridge.config.advice import moves_a_robot, with_late_commands
from rsb_bridge.config.session_file import load_file
from rsb_bridge.model.session import Client, Session, Topic

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    "topic",
    [
        Topic("/cmd_vel", "receive"),
        Topic("/robot1/cmd_pose", "receive"),
        Topic("/cmd*", "receive"),
        Topic("/base", "receive", "geometry_msgs/msg/TwistStamped"),
        Topic("/base", "receive", "Twist"),
        Topic("/arm", "receive", "trajectory_msgs/msg/JointTrajectory"),
        Topic("/arm", "receive", "control_msgs/msg/JointJog"),
        Topic("/car", "receive", "ackermann_msgs/msg/AckermannDrive"),
        Topic("/a", "receive", remote_topic="/cmd_vel"),
        Topic("/forward_position_controller/commands", "receive"),
    ],
)
def test_commands_move_a_robot(topic: Topic) -> None:
    assert moves_a_robot(topic)


@pytest.mark.parametrize(
    "topic",
    [Topic("/scan", "receive"), Topic("/map", "transmit", "OccupancyGrid"), Topic("/cmd", "receive", kind="service")],
)
def test_other_topics_move_nothing(topic: Topic) -> None:
    assert not moves_a_robot(topic)


def test_topics_with_late_commands_are_named() -> None:
    clients = (
        Client("robot1", topics=(Topic("/cmd_a", "receive"), Topic("/cmd_b", "receive", max_age=0.0))),
        Client("robot2", topics=(Topic("/scan", "receive", max_age=0.0), Topic("/joy", "receive", keep=60.0))),
    )
    topics = Topic("/cmd_c", "receive", max_age=1.0), Topic("/cmd_*", "receive", max_age=0.0)
    server = Session(name="pc", role="server", server_ip="127.0.0.1", server_port=1, clients=clients)
    assert list(with_late_commands(server)) == ["/cmd_b", "/joy"]
    client = Session(name="robot1", role="client", server_ip="127.0.0.1", topics=topics)
    assert list(with_late_commands(client)) == ["/cmd_*"]


def test_topic_that_another_line_limits_is_not_named() -> None:
    topics = (Topic("/cmd_b", "receive", max_age=0.0), Topic("/*_b", "receive", max_age=0.5))
    session = Session(name="robot1", role="client", server_ip="127.0.0.1", topics=topics)
    assert not list(with_late_commands(session))


def test_none_is_word_for_any_age(tmp_path: Path) -> None:
    """In a file and from an operator; 0 is the same."""
    file = tmp_path / "robot.yaml"
    file.write_text(
        "name: r\nrole: client\nserver_ip: 10.0.0.1\nserver_port: 5\nuse_encryption: false\ntopics:\n"
        "  - {topic: /cmd_a, direction: receive, max_age: none}\n"
        "  - {topic: /cmd_b, direction: receive, max_age: 0}\n"
    )
    session = load_file(file).session
    assert [each.max_age for each in session.topics] == [0.0, 0.0]
    assert list(with_late_commands(session)) == ["/cmd_a", "/cmd_b"]

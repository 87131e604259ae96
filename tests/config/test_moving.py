"""Topics that are taken for commands that move a robot."""

from __future__ import annotations

import pytest

from rsb_bridge.config.advice import moves_a_robot, without_max_age
from rsb_bridge.model.session import Client, Session, Topic


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


def test_only_topics_that_say_nothing_are_named() -> None:
    session = Session(
        name="pc",
        role="server",
        server_ip="127.0.0.1",
        server_port=1,
        clients=(Client("robot1", topics=(Topic("/cmd_a", "receive"), Topic("/cmd_b", "receive", max_age=0.0))),),
        topics=(Topic("/cmd_c", "receive", max_age=1.0), Topic("/cmd_d", "receive", arm=True)),
    )
    assert list(without_max_age(session)) == ["/cmd_a"]


def test_topic_that_another_line_limits_is_not_named() -> None:
    topics = (Topic("/cmd_a", "receive"), Topic("/cmd_b", "receive"), Topic("/*_b", "receive", max_age=0.5))
    session = Session(name="robot1", role="client", server_ip="127.0.0.1", topics=topics, armed=("/cmd_a",))
    assert not list(without_max_age(session))

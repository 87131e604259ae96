"""Topics by which a robot moves, as far as their names and types tell."""

from __future__ import annotations

import fnmatch
from typing import TYPE_CHECKING

from rsb_bridge.model.demands import Demands, demand_on_entry, sources_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.session import Session, Topic

_TYPES = frozenset(
    {
        "Twist", "TwistStamped", "JointTrajectory", "JointJog", "AckermannDrive", "AckermannDriveStamped",
        "ActuatorControls", "AttitudeTarget", "PositionTarget", "Thruster", "MultiDOFJointTrajectory",
    }
)  # fmt: skip
"""Names of message types, of any package."""
_NAMES = ("cmd*", "*_cmd", "*_cmd_vel", "joint_trajectory", "joint_command*", "*_command", "*_commands", "servo_*")
"""Last parts of names."""


def moves_a_robot(topic: Topic) -> bool:
    """Whether messages of a topic's entry are commands that move a robot, most likely."""
    if topic.kind != "topic":
        return False
    if topic.type.rpartition("/")[2] in _TYPES:
        return True
    names = {each.rpartition("/")[2] for each in (topic.topic, topic.remote_topic or "")}
    return any(fnmatch.fnmatchcase(name, pattern) for name in names for pattern in _NAMES)


def without_max_age(session: Session) -> Iterator[str]:
    """Yield the names of a session's topics that move a robot and whose messages may be of any age."""
    demands = Demands(sources_of(session))
    own = [(None, topic) for topic in session.topics]
    of_clients = [(client, topic) for client in session.clients for topic in client.topics]
    for client, topic in (*own, *of_clients):
        is_limited = topic.max_age is not None or topic.arm
        if not (is_limited or topic.is_pattern):
            is_limited = demand_on_entry(demands, session, client, topic).max_age is not None
        if not is_limited and moves_a_robot(topic):
            yield topic.topic

"""What may move a robot, by type and by name: the one place that decides it, for warnings, waiting and ages alike.

Of such a topic only the newest message waits, and none is published late (`rsb_bridge.route.age`). Whether a message is
a *velocity*, which limits may reduce and which has a rest, is a narrower question: it needs the fields of a known type
(`rsb_bridge.cdr.known_types.DRIVING_TYPES`).
"""

from __future__ import annotations

import re
from fnmatch import translate
from functools import lru_cache
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

LATEST = 0.5
"""s: the greatest age of a message that may move a robot, beyond the usual delay of its link. Bases with a timeout stop
by themselves after as long (``cmd_vel_timeout`` of ros2_control's diff_drive_controller)."""
SLOWEST = 0.5
"""s: the longest usual delay that counts. By a geostationary satellite, messages take 0.3 s; a link that takes longer
than these two together carries nothing that may move a robot."""
_TYPES = (
    "Twist", "TwistStamped", "Joy", "JointTrajectory", "MultiDOFJointTrajectory", "JointJog", "Thruster",
    "AckermannDrive", "AckermannDriveStamped",
    "Actuators", "ActuatorControls", "ActuatorControl", "ActuatorMotors", "ActuatorServos",
    "AttitudeTarget", "PositionTarget", "GlobalPositionTarget", "ManualControl", "OverrideRCIn", "Thrust",  # mavros
    "*Setpoint", "*Command", "*Commands", "*Cmd",
)  # fmt: skip
"""Names of message types, of any package."""
_NAMES = (
    "cmd*", "*_cmd", "*_cmds", "*_cmd_vel", "command", "commands", "*_command", "*_commands", "joint_trajectory",
    "joint_command*", "servo_*", "joy", "actuators", "setpoint_*", "*_setpoint",
)  # fmt: skip
"""Last parts of names."""


def _last_part(patterns: Iterable[str]) -> re.Pattern[str]:
    """Return what matches a name whose last part, behind any ``/``, is one of the patterns."""
    parts = [translate(each).replace(".*", "[^/]*") for each in patterns]
    return re.compile(f"(?:.*/)?(?:{'|'.join(parts)})")


_IS_TYPE, _IS_NAME = _last_part(_TYPES), _last_part(_NAMES)
NAMES_OF_MOTION: Final = ("/cmd_vel", "/joint_trajectory", "/joint_command", "/joy", "/controller/commands")
"""Usual names of topics that move a robot."""


@lru_cache(4096)
def may_move(type_name: str, *names: str) -> bool:
    """Whether messages are commands that may move a robot, most likely.

    Args:
        type_name: ``pkg/msg/Name`` or ``Name``, or an empty string or ``auto`` while it is unknown.
        names: of the topic, on either side.
    """
    return any((_IS_TYPE.match(type_name), *map(_IS_NAME.match, names)))

"""Which middleware (rmw) implementation ROS uses. Looked up without loading ROS.

rcl checks the implementation while it is being loaded, and a wrong one ends the process with exit code 102
(rcl/rmw_implementation_identifier_check.c). So it has to be checked before.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_VARIABLES = ("RMW_IMPLEMENTATION", "RCL_ASSERT_RMW_ID_MATCHES")
_INDEX = "share/ament_index/resource_index"
_NOT_ONE = "rmw_implementation"  # it is listed too, and loads one of the others


def check_middleware(environment: Mapping[str, str]) -> None:
    """Check that the middleware implementation that the environment asks for is installed.

    Args:
        environment: the process's environment variables.

    Raises:
        RosError: it is not; the message says which are.
    """
    prefixes = [*environment.get("AMENT_PREFIX_PATH", "").split(":"), sys.prefix]
    installed = installed_middlewares(Path(prefix) for prefix in prefixes if prefix)
    if not installed:
        return  # an installation without an index: rcl will say what is wrong, if anything is
    for variable in _VARIABLES:
        wanted = environment.get(variable, "")
        if wanted and wanted not in installed:
            raise RosError(
                f"{variable} is {wanted}, which is not installed (installed: {', '.join(sorted(installed))}): "
                f"unset {variable}, or install ros-jazzy-{wanted.replace('_', '-')}"
            )


def installed_middlewares(prefixes: Iterable[Path]) -> set[str]:
    """The middleware implementations that these installation prefixes have, by the ament index."""
    found = {entry.name for prefix in prefixes for entry in prefix.glob(f"{_INDEX}/rmw_typesupport*/*")}
    return found - {_NOT_ONE}

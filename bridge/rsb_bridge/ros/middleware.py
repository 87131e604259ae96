"""The check that the middleware (rmw) implementation that ROS will use is installed. It does not load ROS.

rcl checks the implementation while it is being loaded, and a wrong one ends the process with exit code 102
(rcl/rmw_implementation_identifier_check.c). So it has to be checked before.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.distribution import package_of
from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from collections.abc import Mapping

_VARIABLES = ("RMW_IMPLEMENTATION", "RCL_ASSERT_RMW_ID_MATCHES")
_INDEX = "share/ament_index/resource_index"
_NOT_ONE = "rmw_implementation"  # it is listed too, and loads one of the others


class MiddlewareProblem(Wording):
    """The reasons why ROS can't use a middleware."""

    NOT_INSTALLED = (
        "{variable} is {wanted}, which is not installed (installed: {installed}): unset {variable}, or install "
        "{package}"
    )


def check_middleware(environment: Mapping[str, str]) -> None:
    """Check that the middleware implementation that the environment asks for is installed.

    Raises:
        RosError: it is not installed; the message lists the installed ones.
    """
    prefixes = [*environment.get("AMENT_PREFIX_PATH", "").split(":"), sys.prefix]
    indexes = (Path(prefix).glob(f"{_INDEX}/rmw_typesupport*/*") for prefix in prefixes if prefix)
    installed = {entry.name for index in indexes for entry in index} - {_NOT_ONE}
    if not installed:
        return  # an installation without an index: rcl itself reports a missing implementation
    for variable in _VARIABLES:
        wanted = environment.get(variable, "")
        if wanted and wanted not in installed:
            raise RosError(
                MiddlewareProblem.NOT_INSTALLED(
                    variable=variable,
                    wanted=wanted,
                    installed=", ".join(sorted(installed)),
                    package=package_of(wanted),
                )
            )

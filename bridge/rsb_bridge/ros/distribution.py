"""Finds the ROS 2 that is installed here: its distribution, and the middleware (rmw).

This module does not load ROS, and checks what would end the process that does.
"""

from __future__ import annotations

import os
import sys
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from collections.abc import Mapping

DEFAULT: Final = "jazzy"
"""The distribution that texts name where none is installed."""
_BY_RCLPY = {"3.3": "humble", "7.1": "jazzy", "9.1": "kilted"}
"""Distributions by their version of rclpy."""
_VARIABLES = ("RMW_IMPLEMENTATION", "RCL_ASSERT_RMW_ID_MATCHES")
_BOOTSTRAPPED = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
_LIBRARIES = "ros_rclpy.libs"
"""Folder of the libraries of rclpy's wheel, beside the package."""
_INDEX = "share/ament_index/resource_index"
SHARED = Path("/dev/shm")  # noqa: S108 -- where the C library has it
_LEAST_SHARED = 64 << 10
"""Bytes. With 4 kB free, the process ends; with 8 kB Fast DDS does without shared memory. A round figure above."""
_NOT_ONE = "rmw_implementation"  # it is listed too, and loads one of the others


@cache
def distribution() -> str:
    """Return the name of the distribution, in lower case, or an empty string if it is unknown."""
    if name := os.environ.get("ROS_DISTRO", ""):  # a setup file was sourced
        # It becomes a part of names of packages, which operators paste into a shell.
        return name if name.isidentifier() else ""
    return _BY_RCLPY.get(".".join(rclpy_version().split(".")[:2]), "")


@cache
def rclpy_version() -> str:
    """Return rclpy's version, or an empty string if it is not installed."""
    metadata = import_module("importlib.metadata")  # 1.5 MB, which most processes do without
    try:
        version: str = metadata.version("rclpy")
    except metadata.PackageNotFoundError:
        return ""
    return version


def described() -> str:
    """Return name and version as operators read them: ``ROS 2 Kilted (rclpy 9.1.2)``."""
    return f"ROS 2 {distribution().capitalize()} (rclpy {rclpy_version()})".replace("  ", " ")


def package_of(name: str) -> str:
    """Return the name under which systems install a ROS package: ``ros-jazzy-std-msgs``."""
    return f"ros-{distribution() or DEFAULT}-{name.replace('_', '-')}"


class MiddlewareProblem(Wording):
    """The reasons why ROS can't use a middleware."""

    NOT_INSTALLED = (
        "{variable} is {wanted}, which is not installed (installed: {installed}): unset {variable}, or install "
        "{package}"
    )


def check_middleware(environment: Mapping[str, str]) -> None:
    """Check that the middleware implementation that the environment asks for is installed.

    rcl checks it while it is being loaded, and a wrong one ends the process with exit code 102
    (rcl/rmw_implementation_identifier_check.c). So it has to be checked before.

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


class LibrariesProblem(Wording):
    """The reasons why this process would load the libraries of another ROS than its own."""

    OTHERS = (
        "ROS 2 of {ours} would load the libraries of {theirs}, from which it was started: start it by "
        "env -u LD_LIBRARY_PATH -u {variable} …"
    )


def check_libraries(environment: Mapping[str, str], prefix: Path = Path(sys.prefix)) -> None:
    """Check that this Python loads its own ROS's libraries, if that was installed as wheels.

    The wheels put their folders into ``LD_LIBRARY_PATH``, unless `_BOOTSTRAPPED` says that this was done. A child
    process of another environment's Python inherits both, and what it loads then fails with some missing symbol.

    Args:
        prefix: of this Python's environment.

    Raises:
        RosError: they are another environment's; the message names both.
    """
    # Resolved, as an environment may be made of links to another one's packages.
    ours = {each.resolve() for each in prefix.glob(f"lib/python*/site-packages/{_LIBRARIES}")}
    if not environment.get(_BOOTSTRAPPED) or not ours:
        return
    folders = [Path(each).resolve() for each in environment.get("LD_LIBRARY_PATH", "").split(":") if each]
    found = [each for each in folders if each.name == _LIBRARIES]
    if found and ours.isdisjoint(found):
        theirs = found[0].parents[3]  # …/lib/python3.11/site-packages
        raise RosError(LibrariesProblem.OTHERS(ours=prefix.resolve(), theirs=theirs, variable=_BOOTSTRAPPED))


class MemoryProblem(Wording):
    """The reasons why ROS would end the process while it is loaded."""

    SHARED_FULL = (
        "{folder} is full ({free} kB are free), which would end the process: make room there (rsb-console doctor names "
        "what killed nodes have left), or in a container give more (docker run --shm-size=512m)"
    )


def check_shared_memory(folder: Path = SHARED) -> None:
    """Check that shared memory has room; there may be none at all.

    The libraries of ROS, and lttng with them, write to it while they are loaded. On a full file system, the kernel
    answers with SIGBUS.

    Raises:
        RosError: it is full.
    """
    try:
        system = os.statvfs(folder)
    except OSError:
        return
    free = system.f_bavail * system.f_frsize
    if free < _LEAST_SHARED:
        raise RosError(MemoryProblem.SHARED_FULL(folder=folder, free=free // 1024))

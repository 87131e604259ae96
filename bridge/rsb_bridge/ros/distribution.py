"""The ROS 2 distribution that is installed here, for texts that name its packages. This module does not load ROS."""

from __future__ import annotations

import os
from functools import cache
from importlib import import_module
from typing import Final

DEFAULT: Final = "jazzy"
"""The distribution that texts name where none is installed."""
_BY_RCLPY = {"3.3": "humble", "7.1": "jazzy", "9.1": "kilted"}
"""Distributions by their version of rclpy."""


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
    metadata = import_module("importlib.metadata")  # 2 MB, which most processes do without
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

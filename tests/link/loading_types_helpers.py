"""Helpers of `test_loading_types` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from rsb_bridge.ros.no_ros import NoRos

if TYPE_CHECKING:
    from tests.support.virtual_time import VirtualLoop


TWIST = "geometry_msgs/msg/Twist"


class Loads(NoRos):
    """Notes which types are loaded, and where.

    Attributes:
        loaded: types, each with whether the loop had to wait.
    """

    def __init__(self, loop: VirtualLoop) -> None:
        super().__init__()
        self._loop = loop
        self.loaded: list[tuple[str, bool]] = []

    def installed_hash(self, type_name: str) -> str | None:
        self.loaded.append((type_name, not self._loop.in_thread))
        return None


@pytest.fixture
def ros(loop: VirtualLoop) -> Loads:
    return Loads(loop)

"""Helpers of `test_idle_routes` and others."""

from __future__ import annotations

from rsb_bridge.channel.channel import Counts
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import Endpoint


class Channel:
    """A channel that takes messages, and is not given any."""

    ready = True

    def close(self, reason: str) -> None:
        pass

    def counts(self) -> Counts:
        return Counts(newest=None)

    def datagrams(self, size: int) -> int:
        return 0

    def trouble(self) -> None:
        return None


TALKER = Endpoint("/talker", "std_msgs/msg/String", "", Qos(), b"gid")

"""Helpers of `test_goal_cancels` and others."""

from __future__ import annotations

from rsb_bridge.ros.ros_interface import RosError


class Client:
    """A client of a service of the action.

    Attributes:
        calls: what it was asked.
        ready: whether a call reaches the server.
    """

    def __init__(self) -> None:
        self.calls: list[bytes] = []
        self.ready = True

    def call(self, request: bytes) -> int:
        if not self.ready:
            raise RosError("no server")
        self.calls.append(request)
        return len(self.calls)

    def close(self) -> None: ...

"""ROS's C client library, rcl, as ctypes calls it, and what every endpoint made with it has in common."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import threading

    from rsb_bridge.ros.anytype import BorrowedType

# PyDLL keeps the GIL: the calls take about 1 µs, and giving it up each time would cost a whole switch interval whenever
# another thread is busy. rclpy has loaded the libraries; librcl's handle also finds what it depends on.
librcl = ctypes.PyDLL("librcl.so")
librcl_without_gil = ctypes.CDLL("librcl.so")
"""For calls that take long, as those that copy large messages do: other threads run meanwhile."""
reset_error = librcl.rcutils_reset_error


def reason_of(error: Exception) -> str:
    """An rcl error without the places in its source code."""
    return str(error).partition(", at ")[0]


class Handle:
    """An endpoint of rclpy's.

    Attributes:
        rclpy: itself.
        address: of what rcl has of it.
    """

    def __init__(self, rclpy: Any, borrowed: BorrowedType, entities: threading.RLock) -> None:
        """Hold one that was just created.

        Args:
            rclpy: itself.
            borrowed: its type.
            entities: held while its participant's endpoints are created or freed.
        """
        self.rclpy = rclpy
        self.address: int = rclpy.pointer
        self._borrowed = borrowed
        self._entities = entities

    def free(self) -> None:
        """To be called once."""
        with self._entities:
            self.rclpy.destroy_when_not_in_use()
        self._borrowed.give_back()

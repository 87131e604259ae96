"""Helpers of `test_latched` and others."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile

JOINS_LATE = QoSProfile(depth=5000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def latched(depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)

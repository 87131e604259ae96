"""The ROS side of an engine, with the topics that measure its links."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.ros.synthetic import with_synthetic

if TYPE_CHECKING:
    from rsb_bridge.model.clock import Clock
    from rsb_bridge.ros.api import RosInterface


def ros_side(ros: RosInterface | None, domain: int, name: str, clock: Clock) -> RosInterface:
    """The ROS side in a domain, not started yet.

    Args:
        ros: which; None: rclpy's.
        domain: to join.
        name: of the session.
        clock: the wall clock.
    """
    return with_synthetic(ros or _node(domain, name), clock.time_ns)


def _node(domain: int, name: str) -> RosInterface:
    from rsb_bridge.ros.node import RosNode  # noqa: PLC0415 -- only a running engine needs ROS

    return RosNode(domain, name)

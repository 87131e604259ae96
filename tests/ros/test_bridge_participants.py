"""Endpoints are known as a bridge's by its announcement, whenever that is found."""

from __future__ import annotations

import tracemalloc

import pytest

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.bridge_participants import PARTICIPANT, BridgeParticipants
from rsb_bridge.ros.ros_interface import Endpoint, RosError

BRIDGE = "/_rsb_robot1_0123abcd"


def endpoint(node: str, number: int) -> Endpoint:
    return Endpoint(node, "std_msgs/msg/String", "", Qos(), bytes(PARTICIPANT - 1) + bytes((1, 0, 0, 0, number)))


def test_failed_question_is_asked_again() -> None:
    """Until then, the endpoint of a node that another bridge mirrors counts as a node's, and its topic goes round."""
    found: list[Endpoint] = []
    version, fails = 1, False

    def announcers() -> list[Endpoint]:
        if fails:
            raise RosError("the graph cannot be read")
        return found

    participants = BridgeParticipants(announcers, lambda: version)
    mirrored = endpoint("/lidar", 1)
    assert participants.owned(mirrored) == mirrored
    found.append(endpoint(BRIDGE, 2))
    version, fails = 2, True
    with pytest.raises(RosError):
        participants.owned(mirrored)
    fails = False
    assert participants.owned(mirrored).node == BRIDGE


def test_own_endpoints_take_no_memory() -> None:
    """Over months, a bridge makes many, and not every middleware's ids begin with the participant's."""
    participants = BridgeParticipants(list, lambda: 1)
    tracemalloc.start()
    for number in range(10_000):
        participants.know(number.to_bytes(16, "little"), BRIDGE)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 100_000
    assert participants.owned(endpoint("/lidar", 1)._replace(gid=number.to_bytes(16, "little"))).node == BRIDGE

"""Helpers of `test_topic_verdict` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hypothesis import strategies as st
from tests.support.judged import topic_verdict

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.route.crossing import Crossing

if TYPE_CHECKING:
    from rsb_bridge.model.verdict import Verdict

NOW = 2e6
"""s."""


IMAGE = "sensor_msgs/msg/Image"
STRING, INT, TF = "std_msgs/msg/String", "std_msgs/msg/Int32", "tf2_msgs/msg/TFMessage"


RELIABLE, BEST_EFFORT, LATCHED = Qos(), Qos(reliability="best_effort"), Qos(durability="transient_local")


def endpoint(node: str, qos: Qos = RELIABLE, type_name: str = STRING, type_hash: str = "RIHS01_1") -> Endpoint:
    return Endpoint(node, type_name, type_hash, qos, node.encode())


TALKER = endpoint("/talker")


SENDER: dict[str, Any] = {
    "sends": True, "topic": "/chat", "domain": "2", "accepted": True, "crossing": Crossing.YES, "came": True,
    "endpoints": [TALKER], "described": True, "type_name": STRING, "qos": RELIABLE,
}  # fmt: skip


RECEIVER: dict[str, Any] = SENDER | {
    "sends": False, "topic": "/robot1/chat", "domain": "3", "endpoints": [endpoint("/rviz")],
}  # fmt: skip


def verdict_on(side: dict[str, Any], **changes: Any) -> Verdict:
    """Judge with some facts changed."""
    return topic_verdict(NOW, **(side | changes))


nodes = st.sampled_from(["", "/a", "/b", "/c", "/d", "/a/very/long/name"])


qos = st.sampled_from([RELIABLE, BEST_EFFORT, LATCHED, Qos(deadline=0.1)])


endpoints = st.lists(
    st.builds(endpoint, nodes, qos, st.sampled_from([STRING, INT]), st.sampled_from(["", "RIHS01_1", "RIHS01_2"])),
    max_size=6,
)

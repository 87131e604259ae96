"""Finding the topic that somebody may have meant, at a bounded cost."""

from __future__ import annotations

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_graph import SimilarTopics
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.ros.stand_in import NoRos


class _Graph(NoRos):
    def __init__(self, *published: str) -> None:
        self.published = published
        self.asked = 0

    def topics(self) -> dict[str, list[str]]:
        self.asked += 1
        return {topic: [] for topic in (*self.published, "/w_typ", "/rosout")}

    def publishers(self, topic: str) -> list[Endpoint]:
        return [Endpoint("/talker", "", "", Qos())] if topic in self.published else []


def test_only_what_is_published_and_alike_is_named() -> None:
    graph = _Graph("/w_typo", "/robot1/camera/image_raw", "/odom")
    for topic, similar in (
        ("/w_tpyo", "/w_typo"),
        ("/camera/image_raw", "/robot1/camera/image_raw"),
        ("/odom", ""),
        ("/battery_state", ""),
    ):
        assert SimilarTopics(graph, lambda: 0.0).of(topic) == similar


def test_one_search_a_second_whoever_asks() -> None:
    graph, now = _Graph("/topic0"), 0.0
    similar = SimilarTopics(graph, lambda: now)
    for step in range(100):
        now = step / 10
        for number in range(1, 50):
            similar.of(f"/topic{number}")
    assert graph.asked <= 10
    assert similar.of("/topic1") == "/topic0"

"""Suggestions for a name that nobody serves, or that nobody publishes, at a bounded cost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_graph import NameSuggester, SimilarTopics
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.ros.stand_in import NoRos

if TYPE_CHECKING:
    from rsb_bridge.model.session import Kind


class _Graph(NoRos):
    """One with an action /navigate, a node /dock_server with parameters, and a service /dock.

    Attributes:
        asked: how often for all services.
    """

    def __init__(self) -> None:
        self._served = {"/dock"}
        wholes: tuple[tuple[Kind, str], ...] = (("action", "/navigate"), ("parameters", "/dock_server"))
        for kind, name in wholes:
            self._served |= {name + lane.suffix for lane in LANES[kind] if not lane.is_topic}
        self.asked = 0

    def services(self) -> dict[str, list[str]]:
        self.asked += 1
        return {service: [] for service in (*self._served, "/dokc_called_only", "/_hidden")}

    def servers(self, service: str) -> list[Endpoint]:
        return [Endpoint("/node", "", "", Qos())] if service in self._served else []


@pytest.mark.parametrize(
    ("kind", "name", "words"),
    [
        ("service", "/dokc", "/dock?"),
        ("service", "/navigate", "under actions"),
        ("service", "/dock_server", "under parameters"),
        ("service", "/dokc_called_onyl", ""),
        ("service", "/scan", ""),
        ("action", "/navigat", "/navigate?"),
        ("action", "/dock", "under services"),
        ("parameters", "/dock_srver", "/dock_server?"),
        ("parameters", "/navigate", "under actions"),
    ],
)
def test_other_kinds_and_similar_names_are_suggested(kind: Kind, name: str, words: str) -> None:
    hint = NameSuggester(_Graph(), lambda: 0.0).of((kind, name))
    assert bool(hint) is bool(words)
    assert words in hint


def test_it_is_not_searched_for_at_each_question() -> None:
    graph = _Graph()
    meant = NameSuggester(graph, lambda: 0.0)
    found = [meant.of(("service", name)) for name in ("/dokc", "/dokc", "/navigate")]
    assert found == ["did you mean /dock?"] * 2 + [""]
    assert graph.asked == 1


class _Topics(NoRos):
    def __init__(self, *published: str) -> None:
        self.published = published
        self.asked = 0

    def topics(self) -> dict[str, list[str]]:
        self.asked += 1
        return {topic: [] for topic in (*self.published, "/w_typ", "/rosout")}

    def publishers(self, topic: str) -> list[Endpoint]:
        return [Endpoint("/talker", "", "", Qos())] if topic in self.published else []


def test_only_what_is_published_and_alike_is_named() -> None:
    graph = _Topics("/w_typo", "/robot1/camera/image_raw", "/odom")
    for topic, similar in (
        ("/w_tpyo", "/w_typo"),
        ("/camera/image_raw", "/robot1/camera/image_raw"),
        ("/odom", ""),
        ("/battery_state", ""),
    ):
        assert SimilarTopics(graph, lambda: 0.0).of(topic) == similar


def test_one_search_a_second_whoever_asks() -> None:
    graph, now = _Topics("/topic0"), 0.0
    similar = SimilarTopics(graph, lambda: now)
    for step in range(100):
        now = step / 10
        for number in range(1, 50):
            similar.of(f"/topic{number}")
    assert graph.asked <= 10
    assert similar.of("/topic1") == "/topic0"

"""What a side's ROS graph offers to bridge."""

from __future__ import annotations

import contextlib
import difflib
from typing import TYPE_CHECKING

from rsb_bridge.model.qos import match_publishers
from rsb_bridge.model.snapshot import TopicInfo
from rsb_bridge.model.sources import ANNOUNCEMENT_TOPIC
from rsb_bridge.ros.api import RosError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.ros.api import RosInterface

_OWN = ("/parameter_events", "/rosout", ANNOUNCEMENT_TOPIC)

_ASKED_EVERY = 1.0
"""s from one search to the next: each takes up to 20 ms among a thousand topics."""
_KNOWN_FOR = 10.0
"""s that an answer holds."""
_MOST_ANSWERS = 1000
_ALIKE = 0.7
_MOST_TOPICS = 2000
"""That are searched."""


class SimilarTopics:
    """Finds topics that are published under a similar name: somebody may have mistyped it.

    Args:
        ros: whose graph is searched.
        now: gives the time in s.
    """

    def __init__(self, ros: RosInterface, now: Callable[[], float]) -> None:
        self._ros = ros
        self._now = now
        self._answers: dict[str, tuple[str, float]] = {}
        self._asked_at = float("-inf")

    def of(self, topic: str) -> str:
        """The most similar one; empty: there is none, or it was not looked for yet, which takes its turn."""
        now = self._now()
        answer, at = self._answers.get(topic, ("", float("-inf")))
        if now - at < _KNOWN_FOR or now - self._asked_at < _ASKED_EVERY:
            return answer
        self._asked_at = now
        if len(self._answers) >= _MOST_ANSWERS:
            self._answers.clear()
        answer = ""
        with contextlib.suppress(RosError):
            names = sorted(self._ros.topics().keys() - {topic, *_OWN})[:_MOST_TOPICS]
            close = difflib.get_close_matches(topic, names, cutoff=_ALIKE)
            answer = next((name for name in close if self._ros.publishers(name)), "")
        self._answers[topic] = (answer, now)
        return answer


def topics_of(ros: RosInterface) -> list[TopicInfo]:
    """Every topic of the graph, by name; what each node has anyway is left out. Takes about 50 µs a topic."""
    found = []
    for topic in sorted(ros.topics()):
        if topic in _OWN:
            continue
        publishers, subscriptions = ros.publishers(topic), ros.subscriptions(topic)
        endpoints = publishers or subscriptions
        if not endpoints:
            continue
        types = {(e.type_name, e.type_hash) for e in endpoints}
        type_name, type_hash = types.pop() if len(types) == 1 else ("", "")
        qos = match_publishers([e.qos for e in publishers]) if publishers else None
        found.append(TopicInfo(topic, type_name, type_hash, qos, len(publishers), len(subscriptions)))
    return found


def type_hint(ros: RosInterface, topic: str) -> tuple[str, str]:
    """The type that a topic's endpoints have here, and its hash; both empty where there is none, or not one."""
    types = {(e.type_name, e.type_hash) for e in (*ros.publishers(topic), *ros.subscriptions(topic))}
    return types.pop() if len(types) == 1 else ("", "")

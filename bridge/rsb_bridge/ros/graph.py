"""What a side's ROS graph offers to bridge."""

from __future__ import annotations

import contextlib
import difflib
from typing import TYPE_CHECKING, Generic, TypeVar

from rsb_bridge.model.qos import match_publishers
from rsb_bridge.model.snapshot import TopicInfo
from rsb_bridge.model.sources import OF_EVERY_NODE
from rsb_bridge.ros.api import RosError

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Sequence

    from rsb_bridge.ros.api import Endpoint, RosInterface

Asked = TypeVar("Asked", bound="Hashable")

_ASKED_EVERY = 1.0
"""s from one search to the next: each takes up to 20 ms among a thousand topics."""
_KNOWN_FOR = 10.0
"""s that an answer holds."""
_MOST_ANSWERS = 1000
_ALIKE = 0.7
_MOST_NAMES = 2000
"""That are searched."""


class Searches(Generic[Asked]):
    """Searches of the graph that take their turn, and whose answers are kept for a while.

    Args:
        search: what is looked for by; may raise `RosError`.
        now: gives the time in s.
    """

    def __init__(self, search: Callable[[Asked], str], now: Callable[[], float]) -> None:
        self._search = search
        self._now = now
        self._answers: dict[Asked, tuple[str, float]] = {}
        self._asked_at = float("-inf")

    def of(self, asked: Asked) -> str:
        """What was found; empty: nothing, or it was not looked for yet."""
        now = self._now()
        answer, at = self._answers.get(asked, ("", float("-inf")))
        if now - at < _KNOWN_FOR or now - self._asked_at < _ASKED_EVERY:
            return answer
        self._asked_at = now
        if len(self._answers) >= _MOST_ANSWERS:
            self._answers.clear()
        answer = ""
        with contextlib.suppress(RosError):
            answer = self._search(asked)
        self._answers[asked] = (answer, now)
        return answer


class SimilarTopics:
    """Finds topics that are published under a similar name: somebody may have mistyped it.

    Args:
        ros: whose graph is searched.
        now: gives the time in s.
    """

    def __init__(self, ros: RosInterface, now: Callable[[], float]) -> None:
        self._ros = ros
        self._searches = Searches(self._search, now)

    def of(self, topic: str) -> str:
        """The most similar one; empty: there is none, or it was not looked for yet, which takes its turn."""
        return self._searches.of(topic)

    def _search(self, topic: str) -> str:
        return most_similar(topic, self._ros.topics().keys() - {topic, *OF_EVERY_NODE}, self._ros.publishers)


def most_similar(name: str, names: Iterable[str], ends: Callable[[str], Sequence[Endpoint]]) -> str:
    """The most similar of names, of those that have ends; empty: none is similar."""
    close = difflib.get_close_matches(name, sorted(names)[:_MOST_NAMES], cutoff=_ALIKE)
    return next((each for each in close if ends(each)), "")


def topics_of(ros: RosInterface) -> list[TopicInfo]:
    """Every topic of the graph, by name; what each node has anyway is left out. Takes about 50 µs a topic."""
    found = []
    for topic in sorted(ros.topics()):
        if topic in OF_EVERY_NODE:
            continue
        publishers, subscriptions = ros.publishers(topic), ros.subscriptions(topic)
        endpoints = publishers or subscriptions
        if not endpoints:
            continue
        type_name, type_hash = agreed_type(endpoints)
        qos = match_publishers([e.qos for e in publishers]) if publishers else None
        found.append(TopicInfo(topic, type_name, type_hash, qos, len(publishers), len(subscriptions)))
    return found


def type_hint(ros: RosInterface, topic: str) -> tuple[str, str]:
    """The type that a topic's endpoints have here, and its hash; both empty where there is none, or not one."""
    return agreed_type([*ros.publishers(topic), *ros.subscriptions(topic)])


def agreed_type(endpoints: Iterable[Endpoint]) -> tuple[str, str]:
    """The type of all endpoints, and its hash; both empty where there is none, or not one."""
    types = {(each.type_name, each.type_hash) for each in endpoints}
    return types.pop() if len(types) == 1 else ("", "")

"""The ROS graph of a side: the topics, services, actions and nodes that it offers, and names that are alike."""

from __future__ import annotations

import contextlib
import difflib
from typing import TYPE_CHECKING, Generic, TypeVar

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.patterns import is_hidden
from rsb_bridge.model.qos import match_publishers
from rsb_bridge.model.snapshot import TopicInfo
from rsb_bridge.model.sources import OF_EVERY_NODE
from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence

    from rsb_bridge.model.session import Kind
    from rsb_bridge.ros.ros_interface import Endpoint, RosInterface

Asked = TypeVar("Asked", bound="Hashable")

_ASKED_EVERY = 1.0
"""s from one search to the next: each takes up to 20 ms among a thousand topics."""
_KNOWN_FOR = 10.0
"""s that an answer holds."""
_MOST_ANSWERS = 1000
_ALIKE = 0.7
_MOST_NAMES = 2000
"""That are searched."""
CALLED: tuple[Kind, ...] = tuple(kind for kind, lanes in LANES.items() if lanes)
WHOLES: tuple[Kind, ...] = tuple(kind for kind in CALLED if len(LANES[kind]) > 1)
"""Those that consist of several services."""
MOST_ENTRIES = 2000
"""Of one kind, in one list: each costs two questions to the middleware, some 50 µs each."""
_OF_EVERY_NODE = "type_description_interfaces/srv/GetTypeDescription"
_OTHER: dict[Kind, str] = {
    "service": "a service: list it under services",
    "action": "an action: list it under actions",
    "parameters": "a node: list it under parameters",
}


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


def graph_of(ros: RosInterface, kinds: Collection[Kind]) -> list[TopicInfo]:
    """Every topic of the graph, and what else there is of the kinds that are asked for, by kind and name.

    The topics of an action that is in the list are left out.

    Args:
        ros: whose graph.
        kinds: as in `called_in`.

    Raises:
        RosError: the node is not running.
    """
    called = called_in(ros, kinds)
    actions = (entry.topic for entry in called if entry.kind == "action")
    parts = {action + lane.suffix for action in actions for lane in LANES["action"]}
    return [*(topic for topic in topics_of(ros) if topic.topic not in parts), *called]


def called_in(ros: RosInterface, kinds: Collection[Kind]) -> list[TopicInfo]:
    """What can be called in the graph, by kind and name; of each kind the first `MOST_ENTRIES`.

    What belongs to an action or to a node's parameters is no service of its own, whatever kinds are asked for, and what
    each node has anyway, or ``ros2 service list`` hides, is left out.

    Args:
        ros: whose graph.
        kinds: those of `rsb_bridge.model.session.Kind` that are asked for; topics are not found here.

    Raises:
        RosError: the node is not running.
    """
    services = ros.services()
    names: dict[Kind, dict[str, str]] = {kind: dict(_wholes(kind, services)) for kind in WHOLES}
    parts = {part for kind in WHOLES for whole in names[kind] for part in _services_of(kind, whole)}
    alone = (name for name, types in services.items() if name not in parts and _OF_EVERY_NODE not in types)
    names["service"] = dict.fromkeys(alone, "")
    return [
        entry
        for kind in sorted(names.keys() & set(kinds))
        for name in sorted(name for name in names[kind] if not is_hidden(name))[:MOST_ENTRIES]
        if (entry := _entry(ros, kind, name, names[kind][name])) is not None
    ]


def _services_of(kind: Kind, whole: str) -> Iterator[str]:
    """Of its topics there is no service: that of parameters has the suffix of none, and so the node's own name."""
    return (whole + lane.suffix for lane in LANES[kind] if not lane.is_topic)


def _wholes(kind: Kind, services: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, str]]:
    """The actions with their types, or the nodes with parameters.

    Whoever has the first service of one has the others: rclcpp and rclpy make them together, on either side.
    """
    lead = LANES[kind][0]
    for name, types in services.items():
        whole = name.removesuffix(lead.suffix)
        if len(types) != 1 or whole in (name, ""):
            continue
        if lead.type_name and types[0] == lead.type_name:
            yield whole, ""
        elif lead.type_suffix and "/action/" in types[0] and types[0].endswith(lead.type_suffix):
            yield whole, types[0].removesuffix(lead.type_suffix)


def _entry(ros: RosInterface, kind: Kind, name: str, type_name: str) -> TopicInfo | None:
    """One line of the list; None: whoever had it has just gone."""
    service = name + LANES[kind][0].suffix
    servers, callers = ros.servers(service), ros.callers(service)
    if not servers and not callers:
        return None
    type_hash = ""
    if kind == "service":
        type_name, type_hash = agreed_type(servers or callers)
    return TopicInfo(name, type_name, type_hash, None, len(servers), len(callers), kind)


class Meant:
    """Looks for what has the name and is of another kind, or has a similar name.

    Args:
        ros: whose graph is searched.
        now: gives the time in s.
    """

    def __init__(self, ros: RosInterface, now: Callable[[], float]) -> None:
        self._ros = ros
        self._searches = Searches(self._search, now)

    def by(self, kind: Kind, name: str) -> str:
        """A hint for an operator; empty: there is none, or nobody has looked yet, which takes its turn."""
        return self._searches.of((kind, name))

    def _search(self, asked: tuple[Kind, str]) -> str:
        kind, name = asked
        services = self._ros.services()
        for other in CALLED:
            if other != kind and name + _lead(other) in services and self._ros.servers(name + _lead(other)):
                return f"{name} is {_OTHER[other]}"
        suffix = _lead(kind)
        names = {each.removesuffix(suffix) for each in services if each.endswith(suffix)} - {name, ""}
        visible = (each for each in names if not is_hidden(each))
        similar = most_similar(name, visible, lambda each: self._ros.servers(each + suffix))
        return f"did you mean {similar}?" if similar else ""


def _lead(kind: Kind) -> str:
    """What the first service of a kind has behind the name."""
    return LANES[kind][0].suffix

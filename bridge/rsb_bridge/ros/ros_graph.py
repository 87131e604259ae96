"""The ROS graph of a side: its topics, services, actions and nodes, and similar names."""

from __future__ import annotations

import contextlib
import difflib
from functools import partial
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.names import OF_EVERY_NODE, is_bridge
from rsb_bridge.model.patterns import Pattern, is_hidden
from rsb_bridge.model.qos import match_publishers
from rsb_bridge.model.snapshot import TopicInfo
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.tasks import in_slices

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence

    from rsb_bridge.model.session import Kind
    from rsb_bridge.ros.ros_interface import Endpoint, RosInterface

Asked = TypeVar("Asked", bound="Hashable")

_ASKED_EVERY = 1.0
"""Seconds between two searches: each takes up to 20 ms among a thousand topics, in slices."""
_KNOWN_FOR = 10.0
"""Seconds that an answer is kept. A round figure."""
_MOST_ANSWERS = 1000
"""A round figure: beyond it all are forgotten, and searched for again."""
_ALIKE = 0.7
"""Ratio of `difflib` from which on names are alike. A round figure; the default is 0.6."""
_MOST_NAMES = 2000
"""Names that a search compares. A round figure: other programs may put any number into the graph."""
_COMPARED_AT_ONCE = 50
"""Names, in half a millisecond."""
_NAMESPACES = 3
"""Namespaces that a pattern may have too many. A round figure: the other side may ask, with a pattern of any length."""
_PLAIN = "std_msgs/"
"""The package of types that tell nothing of what a topic is."""
CALLED: tuple[Kind, ...] = tuple(kind for kind, lanes in LANES.items() if lanes)
WHOLES: tuple[Kind, ...] = tuple(kind for kind in CALLED if len(LANES[kind]) > 1)
"""Kinds that consist of several services."""
MOST_ENTRIES = 2000
"""Entries of one kind in a list: each costs two questions to the middleware, of some 50 µs."""
_OF_EVERY_NODE = "type_description_interfaces/srv/GetTypeDescription"
_OTHER: dict[Kind, str] = {
    "service": "a service: list it under services",
    "action": "an action: list it under actions",
    "parameters": "a node: list it under parameters",
}


class Searches(Generic[Asked]):
    """Searches of the graph, one at a time and in slices of a loop, whose answers are kept for a while."""

    def __init__(self, ros: RosInterface, loop: asyncio.AbstractEventLoop) -> None:
        self._ros = ros
        self._loop = loop
        self._answers: dict[Asked, tuple[str, float]] = {}
        self._asked_at = float("-inf")
        self._search: asyncio.Task[None] | None = None

    def of(self, asked: Asked, changed: Callable[[], None]) -> str:
        """Return the answer, or an empty string if nothing was found yet.

        Args:
            changed: is called if a search that this question begins has another answer.
        """
        now = self._loop.time()
        answer, at = self._answers.get(asked, ("", float("-inf")))
        if now - at >= _KNOWN_FOR and now - self._asked_at >= _ASKED_EVERY and self._search is None:
            self._asked_at = now
            self._search = self._loop.create_task(self._find(asked, changed))
        return answer

    async def _find(self, asked: Asked, changed: Callable[[], None]) -> None:
        answer = ""
        try:
            with contextlib.suppress(RosError):  # a hint is worth no error
                answer = await self._answer(asked)
        finally:
            self._search = None
        if len(self._answers) >= _MOST_ANSWERS:
            self._answers.clear()
        before, _ = self._answers.get(asked, ("", 0.0))
        self._answers[asked] = (answer, self._asked_at)
        if answer != before:
            changed()

    async def _answer(self, asked: Asked) -> str:
        """Search; may raise `RosError`."""
        raise NotImplementedError


class Sought(NamedTuple):
    """A topic that nobody publishes.

    Attributes:
        type_name: that it has or should have, or empty if unknown.
        nodes: that have published it, or none.
    """

    topic: str
    type_name: str = ""
    nodes: frozenset[str] = frozenset()


class SimilarTopics(Searches[Sought]):
    """Finds a published topic that may be meant: of a similar name, in another namespace, or of the same type.

    If the nodes are known that have published the sought one, only what these publish is found.
    """

    async def _answer(self, asked: Sought) -> str:
        topics = self._ros.topics()
        names = sorted(topics.keys() - {asked.topic, *OF_EVERY_NODE})[:_MOST_NAMES]

        def ends(name: str) -> list[Endpoint]:
            return [each for each in self._ros.publishers(name) if not asked.nodes or each.node in asked.nodes]

        if similar := await most_similar(asked.topic, names, ends):
            return similar
        elsewhere = [name for name in names if _is_within(asked.topic, name)]
        same_type = [name for name in names if asked.type_name in topics[name] and not is_hidden(name)]
        if not asked.nodes and asked.type_name.startswith(_PLAIN):
            same_type = []
        for close in (elsewhere, same_type):
            # Of several, nobody knows which.
            if len(close) <= _COMPARED_AT_ONCE and len(published := [name for name in close if ends(name)]) == 1:
                return published[0]
        return ""


class Meant(NamedTuple):
    """A pattern that matches nothing.

    Attributes:
        matching: whether a name that it matches is sought, too: in the graph that it does not follow.
    """

    kind: Kind
    pattern: str
    matching: bool


class MeantNames(Searches[Meant]):
    """Finds a published topic, or a name that is provided, that a pattern may mean."""

    async def _answer(self, asked: Meant) -> str:
        return await name_meant(self._ros, asked, lambda _: True)


async def name_meant(ros: RosInterface, asked: Meant, may: Callable[[str], bool]) -> str:
    """Return a name of the pattern's kind that nodes besides bridges publish or provide, or an empty string.

    The pattern matches it, or may mean it.

    Args:
        may: whether a name may be returned.

    Raises:
        RosError: the node is not running.
    """
    pattern, alike = Pattern(asked.pattern), _alike_patterns(asked.pattern)
    ends = ros.publishers if asked.kind == "topic" else partial(_providers, ros, asked.kind)
    found: dict[bool, str] = {}  # by whether it matches

    def look(name: str) -> None:
        matches = pattern.match(name) is not None
        fits = (
            asked.matching
            if matches
            else any(each.match(name) is not None for each in alike) or _is_alike(asked.pattern, name)
        )
        if fits and matches not in found and any(not is_bridge(each.node) for each in ends(name)):
            found[matches] = name

    if any(map(_is_literal, _segments(asked.pattern))):  # else it means anything
        present = ros.topics() if asked.kind == "topic" else _names_called(ros)[asked.kind]
        names = (each for each in present if not is_hidden(each) and each not in OF_EVERY_NODE and may(each))
        await in_slices(sorted(names)[:_MOST_NAMES], look)
    return found.get(True) or found.get(False, "")


def _segments(name: str) -> list[str]:
    return name.split("/")[1:]


def _is_literal(segment: str) -> bool:
    return "*" not in segment


def _alike_patterns(pattern: str) -> list[Pattern]:
    """Return a pattern in any namespace, and out of its own ones."""
    segments = _segments(pattern)
    outer = next((at for at, each in enumerate(segments) if not _is_literal(each)), len(segments))
    inner = [segments[at:] for at in range(1, min(outer, _NAMESPACES + 1)) if any(map(_is_literal, segments[at:]))]
    return [Pattern("/" + "/".join(each)) for each in (["**", *segments], *inner) if each[:2] != ["**", "**"]]


def _is_alike(pattern: str, name: str) -> bool:
    """Whether a pattern would match a name if similar segments were equal ones."""
    wanted, has = _segments(pattern), _segments(name)
    if "**" in wanted:  # which takes as many segments as are left, and one at least at the end
        at, left = wanted.index("**"), len(has) - len(wanted) + 1
        wanted[at : at + 1] = ["*"] * (max(left, 1) if at == len(wanted) - 1 else left)
    if len(wanted) != len(has):
        return False
    pairs = [pair for pair in zip(wanted, has, strict=True) if pair[0] not in ("*", pair[1])]
    return bool(pairs) and all(are_alike(f"/{one.replace('*', '')}", f"/{other}") for one, other in pairs)


def _is_within(name: str, other: str) -> bool:
    """Whether one is the other in a namespace: ``/scan`` and ``/robot1/scan``."""
    return name.endswith(other) or other.endswith(name)


def are_alike(name: str, other: str) -> bool:
    """Whether one name may be written in place of the other."""
    return _is_within(name, other) or bool(difflib.get_close_matches(name, [other], cutoff=_ALIKE))


def is_mistyped(name: str, other: str) -> bool:
    """Whether `other` may be meant by `name`: it is similar without their common namespace, or in another one."""
    here, there = name.split("/"), other.split("/")
    pairs = enumerate(zip(here, there, strict=False))
    common = next((at for at, (one, another) in pairs if one != another), 1)
    return are_alike("/" + "/".join(here[common:]), "/" + "/".join(there[common:]))


async def most_similar(name: str, names: Iterable[str], ends: Callable[[str], Sequence[Endpoint]]) -> str:
    """Return the most similar name that has endpoints, or an empty string."""
    compared, close = sorted(names)[:_MOST_NAMES], list[str]()

    def compare(first: int) -> None:
        some = compared[first : first + _COMPARED_AT_ONCE]
        close.extend(difflib.get_close_matches(name, some, cutoff=_ALIKE))

    await in_slices(range(0, len(compared), _COMPARED_AT_ONCE), compare, at_once=1)
    return next((each for each in difflib.get_close_matches(name, close, cutoff=_ALIKE) if ends(each)), "")


def topics_of(ros: RosInterface) -> list[TopicInfo]:
    """Return the graph's topics by name, without the topics of every node. Takes about 50 µs a topic."""
    found = []
    for topic in sorted(ros.topics()):
        if topic in OF_EVERY_NODE:
            continue
        publishers, subscriptions = ros.publishers(topic), ros.subscriptions(topic)
        endpoints = publishers or subscriptions
        if not endpoints:  # they are our own, or have just gone
            continue
        type_name, type_hash = agreed_type(endpoints)
        qos = match_publishers([e.qos for e in publishers]) if publishers else None
        found.append(TopicInfo(topic, type_name, type_hash, qos, len(publishers), len(subscriptions)))
    return found


def agreed_type(endpoints: Iterable[Endpoint]) -> tuple[str, str]:
    """Return the common type of endpoints and its hash, or empty strings if they disagree or are missing."""
    types = {(each.type_name, each.type_hash) for each in endpoints}
    return types.pop() if len(types) == 1 else ("", "")


def graph_of(ros: RosInterface, kinds: Collection[Kind]) -> list[TopicInfo]:
    """Return the graph's topics and its entries of the given kinds, by kind and name.

    Topics of a listed action are left out.

    Args:
        kinds: as in `called_in`.

    Raises:
        RosError: the node is not running.
    """
    called = called_in(ros, kinds)
    actions = (entry.topic for entry in called if entry.kind == "action")
    parts = {action + lane.suffix for action in actions for lane in LANES["action"]}
    return [*(topic for topic in topics_of(ros) if topic.topic not in parts), *called]


def called_in(ros: RosInterface, kinds: Collection[Kind]) -> list[TopicInfo]:
    """Return the graph's services, actions and nodes with parameters; of each kind the first `MOST_ENTRIES` by name.

    Services of an action or of a node's parameters are not listed as services, nor are services of every node and
    services that ``ros2 service list`` hides.

    Args:
        kinds: the kinds to list; topics are ignored.

    Raises:
        RosError: the node is not running.
    """
    names = _names_called(ros)
    return [
        entry
        for kind in sorted(names.keys() & set(kinds))
        for name in sorted(name for name in names[kind] if not is_hidden(name))[:MOST_ENTRIES]
        if (entry := _entry(ros, kind, name, names[kind][name])) is not None
    ]


def _names_called(ros: RosInterface) -> dict[Kind, dict[str, str]]:
    """Return the names of `called_in` by kind, hidden ones too, each with its type or an empty string."""
    services = ros.services()
    names: dict[Kind, dict[str, str]] = {kind: dict(_wholes(kind, services)) for kind in WHOLES}
    parts = {name + each.suffix for kind in WHOLES for name in names[kind] for each in LANES[kind] if not each.is_topic}
    alone = (name for name, types in services.items() if name not in parts and _OF_EVERY_NODE not in types)
    return {**names, "service": dict.fromkeys(alone, "")}


def _providers(ros: RosInterface, kind: Kind, name: str) -> Sequence[Endpoint]:
    return ros.servers(name + _lead(kind))


def _wholes(kind: Kind, services: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, str]]:
    """Yield the actions with their types, or the nodes with parameters.

    A node with the first service has the others too: rclcpp and rclpy make them together, on either side.
    """
    lead = LANES[kind][0]
    for name, types in services.items():
        whole = name.removesuffix(lead.suffix)
        # Nodes that disagree about a type make no action together: what they have stays a list of services.
        if len(types) != 1 or whole in (name, ""):
            continue
        if lead.type_name and types[0] == lead.type_name:
            yield whole, ""
        elif lead.type_suffix and "/action/" in types[0] and types[0].endswith(lead.type_suffix):
            yield whole, types[0].removesuffix(lead.type_suffix)


def _entry(ros: RosInterface, kind: Kind, name: str, type_name: str) -> TopicInfo | None:
    """Return an entry of the list, or None if its nodes have just gone."""
    servers, callers = _providers(ros, kind, name), ros.callers(name + _lead(kind))
    if not servers and not callers:
        return None
    type_hash = ""
    if kind == "service":
        type_name, type_hash = agreed_type(servers or callers)
    return TopicInfo(name, type_name, type_hash, None, len(servers), len(callers), kind)


class NameSuggester(Searches["tuple[Kind, str]"]):
    """Finds an entry of the same name but another kind, or of a similar name, as a hint for an operator."""

    async def _answer(self, asked: tuple[Kind, str]) -> str:
        kind, name = asked
        services = self._ros.services()
        for other in CALLED:
            if other != kind and name + _lead(other) in services and _providers(self._ros, other, name):
                return f"{name} is {_OTHER[other]}"
        suffix = _lead(kind)
        names = {each.removesuffix(suffix) for each in services if each.endswith(suffix)} - {name, ""}
        visible = (each for each in names if not is_hidden(each))
        similar = await most_similar(name, visible, partial(_providers, self._ros, kind))
        return f"did you mean {similar}?" if similar else ""


def _lead(kind: Kind) -> str:
    """Return the suffix of a kind's first service."""
    return LANES[kind][0].suffix

"""Pairs of topics of two recordings: by name, by a prefix that one side adds, or as the user says."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

from rsb_bridge.feature_api import Wording
from rsb_extras.audit.unanswered import SERVICE_EVENTS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rsb_bridge.model.patterns import Pattern
    from rsb_extras.audit.recorded import ReadRecording, TopicRows

PairedBy = Literal["name", "prefix", "option"]
_Key: TypeAlias = tuple[str, str]
"""Name and type of a topic."""
_Topics: TypeAlias = "dict[_Key, TopicRows]"


class PairText(Wording):
    """Reasons why topics cannot be paired as the user says."""

    NOT_IN_NEAR = "--pair {near}={far}: {path} has no topic {near}"
    NOT_IN_FAR = "--pair {near}={far}: {path} has no topic {far}"
    TYPES = "--pair {near}={far}: their types are {near_type} and {far_type}"
    NO_TOPIC = "{option} {pattern}: the recordings have no such topic"


class PairError(ValueError):
    """Topics cannot be paired as the user says; the message says why."""


class TopicPair(NamedTuple):
    near: TopicRows
    far: TopicRows
    by: PairedBy


class Paired(NamedTuple):
    """All topics of two recordings: those that belong together, and those that only one side has."""

    pairs: list[TopicPair]
    only_near: list[TopicRows]
    only_far: list[TopicRows]


def is_named(patterns: Iterable[Pattern], *names: str) -> bool:
    """Whether any of a topic's names matches any of the patterns."""
    return any(pattern.match(name) is not None for pattern in patterns for name in names)


def pair_topics(
    near: ReadRecording, far: ReadRecording, named: Iterable[tuple[str, str]], patterns: Sequence[Pattern]
) -> Paired:
    """Pair topics of the same type. Events of services are left out: each side has its own.

    Args:
        named: names of near and far topics that belong together.
        patterns: the topics that count, by their names on either side; without any, all do.

    Raises:
        PairError: a named topic is not there, or has another type.
    """
    left, right = (
        {key: topic for key, topic in side.topics.items() if not topic.name.endswith(SERVICE_EVENTS)}
        for side in (near, far)
    )
    pairs = [TopicPair(*_named(a, b, left, right, near, far), "option") for a, b in named]
    for pair in pairs:
        left.pop((pair.near.name, pair.near.type_name), None)
        right.pop((pair.far.name, pair.far.type_name), None)
    pairs += [TopicPair(left.pop(key), right.pop(key), "name") for key in sorted(left.keys() & right.keys())]
    pairs += [TopicPair(left.pop(a), right.pop(b), "prefix") for a, b in _by_prefix(left, right)]

    def counts(*names: str) -> bool:
        return not patterns or is_named(patterns, *names)

    return Paired(
        sorted(
            (pair for pair in pairs if pair.by == "option" or counts(pair.near.name, pair.far.name)),
            key=lambda pair: pair.near.name,
        ),
        [topic for topic in left.values() if counts(topic.name)],
        [topic for topic in right.values() if counts(topic.name)],
    )


def _named(
    near_name: str, far_name: str, left: _Topics, right: _Topics, near: ReadRecording, far: ReadRecording
) -> tuple[TopicRows, TopicRows]:
    ones = {topic.type_name: topic for topic in left.values() if topic.name == near_name}
    others = {topic.type_name: topic for topic in right.values() if topic.name == far_name}
    if not ones:
        raise PairError(PairText.NOT_IN_NEAR(near=near_name, far=far_name, path=near.path))
    if not others:
        raise PairError(PairText.NOT_IN_FAR(near=near_name, far=far_name, path=far.path))
    if not (common := sorted(ones.keys() & others.keys())):
        types = {"near_type": ", ".join(sorted(ones)), "far_type": ", ".join(sorted(others))}
        raise PairError(PairText.TYPES(near=near_name, far=far_name, **types))
    return ones[common[0]], others[common[0]]


def _by_prefix(left: _Topics, right: _Topics) -> Iterator[tuple[_Key, _Key]]:
    """Yield topics whose names differ by a prefix of either side. The most frequent prefix wins; of two such none."""
    found: dict[tuple[bool, str], list[tuple[_Key, _Key]]] = {}
    for a, near_type in left:
        for b, far_type in right:
            if near_type == far_type and (a.endswith(b) or b.endswith(a)):
                prefix = (True, b[: -len(a)]) if len(b) > len(a) else (False, a[: -len(b)])
                found.setdefault(prefix, []).append(((a, near_type), (b, far_type)))
    taken: tuple[set[_Key], set[_Key]] = set(), set()
    for prefix in sorted(found, key=lambda each: (-len(found[each]), each)):
        rivals = [
            pair
            for other, pairs in found.items()
            if len(pairs) == len(found[prefix]) and other != prefix
            for pair in pairs
        ]
        of_rivals = {a for a, _ in rivals}, {b for _, b in rivals}
        for pair in [each for each in found[prefix] if each[0] not in taken[0] and each[1] not in taken[1]]:
            if pair[0] not in of_rivals[0] and pair[1] not in of_rivals[1]:
                yield pair
                taken[0].add(pair[0])
                taken[1].add(pair[1])

"""Which topics of two recordings belong together: by name, by a prefix that one side adds, or as the user says."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Literal, NamedTuple

from rsb_bridge.model.wording import Wording
from rsb_extras.audit.unanswered import SERVICE_EVENTS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rsb_bridge.model.patterns import Pattern
    from rsb_extras.audit.recorded import ReadRecording, TopicRows

PairedBy = Literal["name", "prefix", "option"]


class PairText(Wording):
    """Reasons why topics cannot be paired as the user says."""

    NOT_IN_NEAR = "--pair {near}={far}: {path} has no topic {near}"
    NOT_IN_FAR = "--pair {near}={far}: {path} has no topic {far}"
    TYPES = "--pair {near}={far}: their types are {near_type} and {far_type}"
    NO_TOPIC = "--topic {pattern}: neither recording has such a topic"


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
    left = {topic.name: topic for topic in near.topics.values() if not topic.name.endswith(SERVICE_EVENTS)}
    right = {topic.name: topic for topic in far.topics.values() if not topic.name.endswith(SERVICE_EVENTS)}
    pairs = [TopicPair(*_named(a, b, left, right, near, far), "option") for a, b in named]
    for pair in pairs:
        left.pop(pair.near.name, None)
        right.pop(pair.far.name, None)
    same = [name for name, topic in left.items() if name in right and right[name].type_name == topic.type_name]
    pairs += [TopicPair(left.pop(name), right.pop(name), "name") for name in same]
    pairs += [TopicPair(left.pop(a), right.pop(b), "prefix") for a, b in _by_prefix(left, right)]

    def counts(*names: str) -> bool:
        return not patterns or any(pattern.match(name) is not None for name in names for pattern in patterns)

    return Paired(
        sorted(
            (pair for pair in pairs if pair.by == "option" or counts(pair.near.name, pair.far.name)),
            key=lambda pair: pair.near.name,
        ),
        [topic for topic in left.values() if counts(topic.name)],
        [topic for topic in right.values() if counts(topic.name)],
    )


def _named(
    a: str,
    b: str,
    left: dict[str, TopicRows],
    right: dict[str, TopicRows],
    near: ReadRecording,
    far: ReadRecording,
) -> tuple[TopicRows, TopicRows]:
    if a not in left:
        raise PairError(PairText.NOT_IN_NEAR(near=a, far=b, path=near.path))
    if b not in right:
        raise PairError(PairText.NOT_IN_FAR(near=a, far=b, path=far.path))
    types = left[a].type_name, right[b].type_name
    if types[0] != types[1]:
        raise PairError(PairText.TYPES(near=a, far=b, near_type=types[0], far_type=types[1]))
    return left[a], right[b]


def _by_prefix(left: dict[str, TopicRows], right: dict[str, TopicRows]) -> Iterator[tuple[str, str]]:
    """Yield names that differ by a prefix of either side. The most frequent prefix wins; of two such none does."""
    found: dict[tuple[bool, str], list[tuple[str, str]]] = {}
    for a, one in left.items():
        for b, other in right.items():
            if one.type_name == other.type_name and (a.endswith(b) or b.endswith(a)):
                prefix = (True, b[: -len(a)]) if len(b) > len(a) else (False, a[: -len(b)])
                found.setdefault(prefix, []).append((a, b))
    taken: set[str] = set()
    for prefix in sorted(found, key=lambda each: (-len(found[each]), each)):
        free = [(a, b) for a, b in found[prefix] if f"<{a}" not in taken and f">{b}" not in taken]
        rivals = Counter(
            side
            for other, names in found.items()
            if len(names) == len(found[prefix]) and other != prefix
            for a, b in names
            for side in (f"<{a}", f">{b}")
        )
        for a, b in free:
            if not rivals[f"<{a}"] and not rivals[f">{b}"]:
                yield a, b
                taken |= {f"<{a}", f">{b}"}

"""The rules of several entries of one link: how many patterns it may have, and what two entries may not both bridge."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.file_form import LISTS, NOUNS, locations
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.names import is_topic_name
from rsb_bridge.model.patterns import PATTERNS_PER_LINK
from rsb_bridge.model.session import Kind, Problem, Topic
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence


class OverlapMistake(Wording):
    """An entry that bridges what another one bridges."""

    OTHER_PROVIDER = (
        "{name} is listed already, with provider: {provider}: only one side can answer; keep the entry of "
        "the side whose node answers"
    )
    BRIDGED_ALREADY = "{service} is bridged already, with {noun} {name}: keep one of the two"


def too_many_patterns(topics: Sequence[Topic]) -> Iterator[Problem]:
    """Yield a problem for each pattern beyond a link's limit."""
    patterns = [here for topic, here in zip(topics, locations(topics), strict=True) if topic.is_pattern]
    for here in patterns[PATTERNS_PER_LINK:]:
        message = f"{len(patterns)} patterns, and at most {PATTERNS_PER_LINK} are allowed: use fewer, wider ones"
        yield Problem(here, message)


def service_names(kind: Kind, name: str) -> list[str]:
    """Return the full names of the services that are bridged with a service, an action or a node's parameters."""
    return [f"{name}{lane.suffix}" for lane in LANES[kind] if not lane.is_topic]


def overlap(topic: Topic, others: Iterable[Topic]) -> str:
    """Return the reason why an entry cannot be bridged together with others of the link, or an empty string."""
    names = set(service_names(topic.kind, topic.topic))
    if not names:
        return ""
    # What overlaps among the others is not this entry's fault.
    related = [other for other in others if not names.isdisjoint(service_names(other.kind, other.topic))]
    return next((f"{topic.topic}: {problem.message}" for problem in overlaps([*related, topic])), "")


def overlaps(topics: Sequence[Topic]) -> Iterator[Problem]:
    """Yield the entries of one link that bridge a service which another one bridges."""
    first: dict[str, int] = {}
    for at, (topic, here) in enumerate(zip(topics, locations(topics), strict=True)):
        if topic.kind == "topic" or not is_topic_name(topic.topic):
            continue
        name, other = next(
            ((name, first[name]) for name in service_names(topic.kind, topic.topic) if name in first), ("", at)
        )
        first |= dict.fromkeys(service_names(topic.kind, topic.topic), at)
        if other == at or topics[other].identity == topic.identity:
            continue
        if topics[other].kind == topic.kind:
            message = OverlapMistake.OTHER_PROVIDER(name=topic.topic, provider=topics[other].provider)
        else:
            noun = NOUNS[LISTS[topics[other].kind]]
            message = OverlapMistake.BRIDGED_ALREADY(service=name, noun=noun, name=topics[other].topic)
        yield Problem(here, message)

"""The rules of an entry whose name is a pattern."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from rsb_bridge.config.decoding import join, show
from rsb_bridge.config.file_form import key_of, locations
from rsb_bridge.model.limits import TOPIC_LENGTH
from rsb_bridge.model.names import is_topic_name
from rsb_bridge.model.patterns import (
    EXCEPTIONS_PER_PATTERN,
    PATTERNS_PER_LINK,
    Pattern,
    is_hidden,
    is_pattern,
    is_valid,
)
from rsb_bridge.model.session import Problem

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.transports import TransportTraits

_FORM: Final = "/part/part, where * stands for characters of one part, and ** as a whole part for any number of them"


def pattern_problems(topic: Topic, location: str, transport: type[TransportTraits]) -> Iterator[Problem]:
    """Mistakes in a pattern by itself.

    Args:
        topic: whose name is a pattern.
        location: of it.
        transport: what carries it.
    """
    remote_key = key_of(topic.kind, "remote_topic")
    found = list(form_problems(topic.topic, join(location, key_of(topic.kind, "topic"))))
    if topic.remote_topic is not None:
        found += form_problems(topic.remote_topic, join(location, remote_key))
    yield from found
    if topic.remote_topic is not None and not found:
        ours, theirs = Pattern(topic.topic).wildcards, Pattern(topic.remote_topic).wildcards
        if ours != theirs:
            message = (
                f"{show(topic.remote_topic)} has {_wildcards(theirs)}, and {show(topic.topic)} has {_wildcards(ours)}: "
                "give both the same, in the same order"
            )
            yield Problem(join(location, remote_key), message)
    if topic.port is not None and not transport.multiplexed:
        message = (
            f"each that matches would need a {transport.port_kind} of its own: leave port out, and they share the "
            "link's"
        )
        yield Problem(join(location, "port"), message)


def exception_problems(topic: Topic, location: str) -> Iterator[Problem]:
    """Mistakes in what a pattern leaves out."""
    location = join(location, "except")
    if topic.excepts and not topic.is_pattern:
        yield Problem(location, f"{show(topic.topic)} is one name, of which nothing can be left out: leave except out")
    elif len(topic.excepts) > EXCEPTIONS_PER_PATTERN:
        message = f"{len(topic.excepts)} entries, and at most {EXCEPTIONS_PER_PATTERN} are allowed: use patterns in it"
        yield Problem(location, message)
    else:
        for at, name in enumerate(topic.excepts):
            yield from form_problems(name, join(location, at), hidden=True)


def too_many_patterns(topics: Sequence[Topic], where: str) -> Iterator[Problem]:
    """Patterns beyond those that one link may have.

    Args:
        topics: of the link.
        where: the location of the session or client that lists them.
    """
    patterns = [here for topic, here in zip(topics, locations(topics), strict=True) if topic.is_pattern]
    for here in patterns[PATTERNS_PER_LINK:]:
        message = f"{len(patterns)} patterns, and at most {PATTERNS_PER_LINK} are allowed: use fewer, wider ones"
        yield Problem(join(where, here) if where else here, message)


def form_problems(text: str, location: str, *, hidden: bool = False) -> Iterator[Problem]:
    """Yield the mistakes in a name or a pattern, which may match hidden names if `hidden`."""
    if is_pattern(text) and not is_valid(text):
        yield Problem(location, f"{show(text)} is not a pattern of names: {_FORM}")
    elif not is_pattern(text) and not is_topic_name(text):
        yield Problem(location, f"{show(text)} is neither a name nor a pattern: {_FORM}")
    elif len(text) > TOPIC_LENGTH:
        message = f"{show(text)} has {len(text)} characters, and ROS allows at most {TOPIC_LENGTH}: shorten it"
        yield Problem(location, message)
    elif is_hidden(text) and not hidden:
        message = f"{show(text)}: patterns never match hidden names, whose parts begin with _: list them by their names"
        yield Problem(location, message)


def _wildcards(kinds: Sequence[str]) -> str:
    return " ".join(kinds) or "no wildcard"

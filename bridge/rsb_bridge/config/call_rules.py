"""The rules of services, actions and parameters in a session, beyond those that they share with topics."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from rsb_bridge.config.decoding import join, show
from rsb_bridge.config.file_form import LISTS, NOUNS, key_of, locations
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.limits import CALL_TIME, TEXT_LENGTH
from rsb_bridge.model.names import is_topic_name
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.session import Problem
from rsb_bridge.model.sources import OWN_NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rsb_bridge.model.session import Kind, Topic

_OF_AN_ACTION = re.compile(r"(?P<action>.*)/_action/[^/]*")
_FOLDERS: dict[Kind, str] = {"service": "srv", "action": "action"}
_PART = r"[A-Za-z][A-Za-z0-9_]*"


def call_problems(topic: Topic, location: str) -> Iterator[Problem]:
    """Mistakes in a service, an action or parameters; nothing of a topic."""
    if topic.kind == "topic":
        return
    for field, name in (("topic", topic.topic), ("remote_topic", topic.remote_topic)):
        if name is not None:
            yield from _name(name, join(location, key_of(topic.kind, field)))
    if topic.kind in _FOLDERS:
        yield from _type(topic, join(location, "type"))
    if topic.timeout is not None and topic.timeout not in CALL_TIME:
        message = f"{topic.timeout} is out of range: {CALL_TIME} s, or leave it out"
        yield Problem(join(location, "timeout"), message)


def _name(name: str, location: str) -> Iterator[Problem]:
    if match := _OF_AN_ACTION.fullmatch(name):
        action = match["action"] or "/..."
        message = f"belongs to the action {action}: list that under actions, which bridges all that it consists of"
        yield Problem(location, f"{show(name)} {message}")
    elif name.startswith(OWN_NAMES):
        yield Problem(location, f"{show(name)} is the bridge's own, and never bridged: name another one")


def _type(topic: Topic, location: str) -> Iterator[Problem]:
    folder, name = _FOLDERS[topic.kind], topic.type
    other: Kind = "action" if topic.kind == "service" else "service"
    if re.fullmatch(rf"{_PART}/{_FOLDERS[other]}/{_PART}", name):
        yield Problem(location, f"{show(name)} is the type of {_a(other)}: list this entry under {LISTS[other]}")
    elif name != AUTO and not re.fullmatch(rf"{_PART}/{folder}/{_PART}", name):
        parts = [part for part in name.split("/") if re.fullmatch(_PART, part)]
        better = f" (did you mean {parts[0]}/{folder}/{parts[-1]}?)" if len(parts) > 1 else ""
        form = f"write package/{folder}/Name, or leave it out"
        yield Problem(location, f"{show(name)} is no type of {_a(topic.kind)}: {form}{better}")
    elif len(name) > TEXT_LENGTH - len("_GetResult"):
        yield Problem(location, f"{show(name)} has {len(name)} characters: that is too long")


def _a(kind: Kind) -> str:
    return "an action" if kind == "action" else f"a {kind}"


def service_names(kind: Kind, name: str) -> list[str]:
    """The full names of the services that are bridged with a service, an action or a node's parameters."""
    return [f"{name}{lane.suffix}" for lane in LANES[kind] if not lane.is_topic]


def overlap(topic: Topic, others: Iterable[Topic]) -> str:
    """Why a service, an action or parameters cannot be bridged beside others of the same link; empty: they can."""
    names = set(service_names(topic.kind, topic.topic))
    related = [other for other in others if not names.isdisjoint(service_names(other.kind, other.topic))]
    return next((f"{topic.topic}: {problem.message}" for problem in overlaps([*related, topic], "")), "")


def overlaps(topics: Sequence[Topic], where: str) -> Iterator[Problem]:
    """Services of one link that two of its entries bridge.

    Args:
        topics: of the link.
        where: the location of the session or client that lists them.
    """
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
            message = (
                f"{topic.topic} has provider: {topics[other].provider} already: only one side's node can answer; "
                "keep the entry of the side whose node does"
            )
        else:
            noun = NOUNS[LISTS[topics[other].kind]]
            message = f"{name} is bridged already, with {noun} {topics[other].topic}: keep one of the two"
        yield Problem(join(where, here) if where else here, message)

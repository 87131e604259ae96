"""The rules of one topic, service, action or node's parameters, also by pattern, and of values that a session has."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from rsb_bridge.config.decoding import did_you_mean, join, read, show
from rsb_bridge.config.file_form import LISTS, NOUNS, key_of, locations
from rsb_bridge.config.keys import conceal
from rsb_bridge.model import transports
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.limits import (
    CALL_TIME,
    CHANNEL,
    DEADMAN_TIME,
    LATE_AFTER,
    MAX_AGE,
    NO_PORT,
    RATE,
    STALE_AFTER,
    TEXT_LENGTH,
    TOPIC_LENGTH,
)
from rsb_bridge.model.names import expand_type_name, is_topic_name, server_topic, well_formed
from rsb_bridge.model.patterns import (
    EXCEPTIONS_PER_PATTERN,
    PATTERNS_PER_LINK,
    Pattern,
    is_hidden,
    is_pattern,
    is_valid,
)
from rsb_bridge.model.qos import AUTO, PROFILES, Qos, parse_qos
from rsb_bridge.model.session import Kind, Problem, Protocol, Session, Topic
from rsb_bridge.model.sources import ANNOUNCEMENT_TOPIC, OWN_NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rsb_bridge.model.transports import TransportTraits

A_KIND: Final[dict[Kind, str]] = {
    "topic": "a topic",
    "service": "a service",
    "action": "an action",
    "parameters": "a node's parameters",
}
"""Each kind, in a sentence."""
_OVER_ZENOH = ("zenoh", "zenoh-drop")
_NAMED: Final[dict[Kind, str]] = {"topic": "topic", "service": "service", "action": "action", "parameters": "node"}
_FORM: Final = "/part/part, where * stands for characters of one part, and ** as a whole part for any number of them"
_OF_AN_ACTION = re.compile(r"(?P<action>.*)/_action/[^/]*")
_FOLDERS: dict[Kind, str] = {"service": "srv", "action": "action"}
_PART = r"[A-Za-z][A-Za-z0-9_]*"


def port_problems(port: int, location: str, transport: type[TransportTraits]) -> Iterator[Problem]:
    """Whether there is such a port."""
    if port and transport.ports is NO_PORT:
        yield Problem(location, "a link over Zenoh has no ports: leave it out")
    elif port not in transport.ports:
        yield Problem(location, f"{port} is not a valid {transport.port_kind}: {transport.ports}")


def transport_of(topic: Topic, session: Session | None) -> type[TransportTraits]:
    """What carries a topic: its own transport, else the link's for its QoS; without a session, an IP link's."""
    if topic.protocol is not None:
        return transports.named(topic.protocol)
    link = transports.of_link(session.server_ip if session is not None else "")
    return transports.named(link.best_effort) if link.best_effort and _is_best_effort(topic) else link


def _is_best_effort(topic: Topic) -> bool:
    try:
        qos = topic.parsed_qos()
    except ValueError:  # a problem of its own
        return False
    return topic.kind == "topic" and qos is not None and qos.reliability == "best_effort"


def topic_problems(topic: Topic, location: str, session: Session | None, client: str | None) -> Iterator[Problem]:
    """Mistakes in a topic by itself.

    Args:
        topic: to look at.
        location: of it; the problems' have the key behind it.
        session: the one it is for, which says what its link can carry; None: not known yet.
        client: the client's name where it is the prefix of the topic's name on the server.
    """
    name, remote = join(location, key_of(topic.kind, "topic")), join(location, key_of(topic.kind, "remote_topic"))
    yield from exception_problems(topic, location)
    if topic.is_pattern:
        yield from pattern_problems(topic, location, transport_of(topic, session))
    else:
        yield from name_problems(topic.topic, name, topic.kind)
        if topic.remote_topic is not None:
            yield from name_problems(topic.remote_topic, remote, topic.kind)
    if topic.remote_topic is None and client is not None and len(topic.topic) <= TOPIC_LENGTH:
        yield from _length(server_topic(topic.topic, client), name, topic.kind, " with its prefix")
    if topic.kind == "topic":
        yield from _type(topic.type, join(location, "type"))
    yield from call_problems(topic, location)
    yield from _protocol(topic, location, session)
    if topic.port is not None:
        yield from port_problems(topic.port, join(location, "port"), transport_of(topic, session))
    yield from _qos(topic.qos, join(location, "qos"))
    yield from rate_problems(topic.max_rate, join(location, "max_rate"))
    yield from rate_problems(topic.expected_rate, join(location, "expected_rate"))
    if topic.stale_after is not None:
        yield from stale_problems(topic.stale_after, join(location, "stale_after"))
    if topic.late_after is not None:
        yield from late_problems(topic.late_after, join(location, "late_after"))
    if topic.max_age:
        yield from _max_age(topic.max_age, join(location, "max_age"))
    yield from _arming(topic, location)


def _arming(topic: Topic, location: str) -> Iterator[Problem]:
    if topic.deadman is None:
        return
    if not topic.arm:
        message = f"only {A_KIND[topic.kind]} that is armed has one: set arm: true, or leave it out"
        yield Problem(join(location, "deadman"), message)
    elif topic.deadman and topic.deadman not in DEADMAN_TIME:
        yield Problem(join(location, "deadman"), f"{topic.deadman} is out of range: {DEADMAN_TIME} s, or 0 for none")


def name_problems(name: str, location: str, kind: Kind = "topic") -> Iterator[Problem]:
    """Whether ROS has such a name, and a bridge may carry it."""
    if is_pattern(name):
        yield Problem(location, f"{show(name)} is a pattern: give the name of one {_NAMED[kind]}")
    elif not is_topic_name(name):
        better = well_formed(name)
        hint = f" (did you mean /{better}?)" if better else ""
        yield Problem(
            location,
            f"{show(name)} is not an absolute {_NAMED[kind]} name: /part/part, of letters, digits and _, no digit "
            f"first{hint}",
        )
    elif kind == "topic" and name == ANNOUNCEMENT_TOPIC:
        yield Problem(
            location, f"{show(name)} is what bridges tell each other: it is never bridged; name another topic"
        )
    else:
        yield from _length(name, location, kind)


def _length(name: str, location: str, kind: Kind, how: str = "") -> Iterator[Problem]:
    most = TOPIC_LENGTH - max((len(lane.suffix) for lane in LANES[kind]), default=0)
    if len(name) > most:
        yield Problem(
            location, f"{show(name)} has {len(name)} characters{how}, and ROS allows at most {most}: shorten it"
        )


def _type(name: str, location: str) -> Iterator[Problem]:
    if name == AUTO:
        return
    try:
        full = expand_type_name(name)
    except ValueError as error:
        yield Problem(location, str(error))
        return
    if len(full) > TEXT_LENGTH:
        yield Problem(location, f"{show(full)} has {len(full)} characters, and at most {TEXT_LENGTH} are allowed")


def _protocol(topic: Topic, location: str, session: Session | None) -> Iterator[Problem]:
    if topic.protocol and not transports.named(topic.protocol).reliable and topic.kind != "topic":
        message = (
            f"{topic.protocol} loses messages, and a call has to arrive whole, and be answered: leave protocol out"
        )
        yield Problem(join(location, "protocol"), message)
    elif session is None:
        return
    elif session.is_bluetooth:
        if topic.protocol not in (None, "bluetooth"):
            yield Problem(
                join(location, "protocol"),
                f"{topic.protocol} does not cross a Bluetooth link (server_ip is a MAC): leave protocol out",
            )
    elif (topic.protocol in _OVER_ZENOH) != session.is_zenoh and topic.protocol is not None:
        yield Problem(join(location, "protocol"), _elsewhere(topic.protocol, session))
    elif topic.protocol == "bluetooth" and session.bluetooth_address is None:
        yield Problem(
            join(location, "protocol"),
            "bluetooth needs the MAC of the server's adapter: as server_ip for the whole link, or as bluetooth_address "
            "for such topics",
        )
    elif topic.protocol == "bluetooth" and topic.port is None:
        yield Problem(
            join(location, "port"),
            f"missing: a bluetooth {_NAMED[topic.kind]} of an IP link needs a channel, {CHANNEL}; several topics may "
            "share one",
        )


def _elsewhere(protocol: Protocol, session: Session) -> str:
    """Why a topic cannot go by that protocol on a session's link."""
    if session.is_zenoh:
        return f"{protocol} does not cross a link over Zenoh: give zenoh or zenoh-drop, or leave protocol out"
    return f"{protocol} needs a link over Zenoh (server_ip: zenoh): leave protocol out"


def _qos(value: str | int | dict[str, Any], location: str) -> Iterator[Problem]:
    if isinstance(value, dict):
        problems: list[Problem] = []
        read({key: policy for key, policy in value.items() if key != "profile"}, Qos, problems, location)
        yield from problems
        if problems:
            return
    try:
        parse_qos(value)
    except ValueError as error:
        name = value.get("profile") if isinstance(value, dict) else value
        options = list(PROFILES) if isinstance(value, dict) else [AUTO, *PROFILES]
        hint = did_you_mean(name, options) if isinstance(name, str) else ""
        yield Problem(location, conceal(f"{error}{hint}"))


def late_problems(seconds: float, location: str) -> Iterator[Problem]:
    """Check a topic's or a session's `late_after`."""
    if seconds and seconds not in LATE_AFTER:
        yield Problem(location, f"{seconds} is out of range: {LATE_AFTER} s, or 0 to accept any delay")


def _max_age(seconds: float, location: str) -> Iterator[Problem]:
    if seconds not in MAX_AGE:
        yield Problem(location, f"{seconds} is out of range: {MAX_AGE} s, or 0 for no limit")


def stale_problems(seconds: float, location: str) -> Iterator[Problem]:
    """Whether such a time without messages can be watched."""
    if seconds and seconds not in STALE_AFTER:
        yield Problem(location, f"{seconds} is out of range: {STALE_AFTER} s, or 0 to never warn")


def rate_problems(rate: float | None, location: str) -> Iterator[Problem]:
    """Whether a rate limit is in its range."""
    if rate is not None and rate not in RATE:
        yield Problem(location, f"{rate} is out of range: {RATE} Hz, or leave it out")


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


def call_problems(topic: Topic, location: str) -> Iterator[Problem]:
    """Mistakes in a service, an action or parameters; nothing of a topic."""
    if topic.kind == "topic":
        return
    for field, name in (("topic", topic.topic), ("remote_topic", topic.remote_topic)):
        if name is not None:
            yield from _called_name(name, join(location, key_of(topic.kind, field)))
    if topic.kind in _FOLDERS:
        yield from _call_type(topic, join(location, "type"))
    if topic.timeout is not None and topic.timeout not in CALL_TIME:
        message = f"{topic.timeout} is out of range: {CALL_TIME} s, or leave it out"
        yield Problem(join(location, "timeout"), message)


def _called_name(name: str, location: str) -> Iterator[Problem]:
    if match := _OF_AN_ACTION.fullmatch(name):
        action = match["action"] or "/..."
        message = f"belongs to the action {action}: list that under actions, which bridges all that it consists of"
        yield Problem(location, f"{show(name)} {message}")
    elif name.startswith(OWN_NAMES):
        yield Problem(location, f"{show(name)} is the bridge's own, and never bridged: name another one")


def _call_type(topic: Topic, location: str) -> Iterator[Problem]:
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

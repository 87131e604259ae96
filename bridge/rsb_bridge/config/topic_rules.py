"""The rules of one topic, service, action or node's parameters, and of the values that a session has, too."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from rsb_bridge.config.call_rules import call_problems
from rsb_bridge.config.decoding import did_you_mean, join, read, show
from rsb_bridge.config.file_form import key_of
from rsb_bridge.config.grants import rate_problems
from rsb_bridge.config.keys import conceal
from rsb_bridge.config.pattern_rules import exception_problems, pattern_problems
from rsb_bridge.model import transports
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.limits import (
    CHANNEL,
    DEADMAN_TIME,
    LATE_AFTER,
    MAX_AGE,
    NO_PORT,
    STALE_AFTER,
    TEXT_LENGTH,
    TOPIC_LENGTH,
)
from rsb_bridge.model.names import expand_type_name, is_topic_name, server_topic, well_formed
from rsb_bridge.model.patterns import is_pattern
from rsb_bridge.model.qos import AUTO, PROFILES, Qos, parse_qos
from rsb_bridge.model.session import Kind, Problem, Protocol, Session, Topic
from rsb_bridge.model.sources import ANNOUNCEMENT_TOPIC

if TYPE_CHECKING:
    from collections.abc import Iterator

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

"""The rules of a session beyond the kind of each value. Every mistake is reported, each with its remedy."""

from __future__ import annotations

import ipaddress
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.config.decoding import did_you_mean, join, read, show
from rsb_bridge.config.keys import conceal
from rsb_bridge.model import transports
from rsb_bridge.model.limits import CHANNEL, DOMAIN, NAME_BYTES, RATE, STALE_AFTER, TEXT_LENGTH, TOPIC_LENGTH
from rsb_bridge.model.names import is_prefix, is_topic_name, server_topic, well_formed
from rsb_bridge.model.qos import AUTO, PROFILES, Qos, parse_qos
from rsb_bridge.model.session import Client, Problem, Session, Topic, is_mac
from rsb_bridge.model.sources import ANNOUNCEMENT_TOPIC
from rsb_bridge.model.type_names import expand_type_name

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.transports import TransportTraits

_ANY_ADDRESS = ("0.0.0.0", "::", "00:00:00:00:00:00")  # noqa: S104 (refused, not bound)
_ENTRY = re.compile(r"(?P<list>topics|clients)\[(?P<at>\d+)\]")
_HOST_LABEL = re.compile(r"[A-Za-z0-9_]([A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?")


def build(data: object) -> tuple[Session, list[Problem]]:
    """Make a session of plain data.

    Args:
        data: what YAML made of a session file.

    Returns:
        The session, to be used only if there are no problems, and all problems.
    """
    problems: list[Problem] = []
    session = read(data, Session, problems)
    found = problems + _unreported(_session(session), problems)
    return session, [placed(problem, data) for problem in found]


def placed(problem: Problem, data: object) -> Problem:
    """Name the topic or client that a problem is about, by its name if it has one, else by its number from 1."""
    parts, rest, around = [], problem.location, data
    while (match := _ENTRY.match(rest)) and isinstance(around, dict):
        kind, name = ("topic", "topic") if match["list"] == "topics" else ("client", "name")
        around, rest = around[match["list"]][int(match["at"])], rest[match.end() :].removeprefix(".")
        called = around.get(name) if isinstance(around, dict) else None
        if isinstance(called, str) and called and len(called) <= NAME_BYTES and called.isprintable():
            parts.append(f"{kind} {conceal(called)}")
        else:
            parts.append(f"{kind} {int(match['at']) + 1}")
    return replace(problem, place=", ".join([*parts, rest] if rest else parts)) if parts else problem


def validate(session: Session) -> list[Problem]:
    """All problems of a session."""
    return build(msgspec.to_builtins(session))[1]


def validate_topic(topic: Topic, session: Session | None = None, *, client: str | None = None) -> list[Problem]:
    """All problems of a topic by itself.

    Args:
        topic: to look at.
        session: the one it is for, which says what its link can carry; None: not known yet.
        client: the client's name where it is the prefix of the topic's name on the server.

    Returns:
        The problems; the location of each is the key: ``protocol``.
    """
    problems: list[Problem] = []
    topic = read(msgspec.to_builtins(topic), Topic, problems)
    return problems + _unreported(_topic(topic, "", session, client), problems)


def domain_of(session: Session, variable: str | None) -> int:
    """The ROS domain that a session joins.

    Args:
        session: whose `Session.domain_id` comes first.
        variable: what ``$ROS_DOMAIN_ID`` says; None or blank is 0, as in ROS.

    Raises:
        ValueError: the variable counts, and is not a domain.
    """
    if session.domain_id is not None:
        return session.domain_id
    text = (variable or "").strip() or "0"
    if not text.isdecimal() or int(text) not in DOMAIN:
        raise ValueError(f"ROS_DOMAIN_ID is {text!r}, which is not a ROS domain: {DOMAIN}")
    return int(text)


def _unreported(found: Iterator[Problem], reported: list[Problem]) -> list[Problem]:
    """Leave out what follows from a reported problem: the default in that value's place may break a rule of its own."""
    locations = [problem.location for problem in reported]
    return [
        new for new in found if not any(_within(new.location, old) or _within(old, new.location) for old in locations)
    ]


def _within(location: str, outer: str) -> bool:
    return not outer or location == outer or location.startswith((f"{outer}.", f"{outer}["))


def _session(session: Session) -> Iterator[Problem]:
    yield from _name(session.name, "name", use_name=session.use_name and not session.clients)
    yield from _address(session)
    yield from _port(session.server_port, "server_port", transports.of_link(session.server_ip))
    if session.domain_id is not None and session.domain_id not in DOMAIN:
        yield Problem("domain_id", f"{session.domain_id} is not a ROS domain: {DOMAIN}")
    yield from _key_files(session)
    yield from _stale_after(session.stale_after, "stale_after")
    if session.stale_warnings < 0:
        yield Problem("stale_warnings", f"{session.stale_warnings} is not a count: 0 or more")
    if session.shutdown_topic is not None:
        yield from _topic_name(session.shutdown_topic, "shutdown_topic")
    client = session.name if session.role == "client" and session.use_name else None
    yield from _topics(session.topics, "topics", session, client)
    yield from _clients(session)


def _name(name: str, location: str, *, use_name: bool) -> Iterator[Problem]:
    if not name.strip() or not name.isprintable():
        yield Problem(location, f"{show(name)} is not a name: give printable characters")
    elif len(name.encode()) > NAME_BYTES:
        yield Problem(location, f"has {len(name.encode())} bytes in UTF-8, and at most {NAME_BYTES} are allowed")
    elif use_name and not is_prefix(name):
        yield Problem(
            location,
            f"{show(name)} cannot be a prefix of topic names, which use_name makes it "
            f"(did you mean {well_formed(name)}?)",
        )


def _address(session: Session) -> Iterator[Problem]:
    address = session.server_ip
    if session.role == "client" and address in _ANY_ADDRESS:
        yield Problem("server_ip", f"a client cannot connect to {address}: give the server's own address")
    elif is_mac(address.replace("-", ":")) and "-" in address:
        yield Problem("server_ip", f"{address!r} is not an address (did you mean {address.replace('-', ':')}?)")
    elif not (is_mac(address) or _is_ip(address) or _is_host(address)):
        yield Problem("server_ip", f"{show(address)} is not an IPv4 or IPv6 address, a host name, or a Bluetooth MAC")
    if session.bluetooth_address is None:
        return
    if session.is_bluetooth:
        yield Problem("bluetooth_address", "server_ip is a Bluetooth MAC already: leave bluetooth_address out")
    elif not is_mac(session.bluetooth_address):
        yield Problem(
            "bluetooth_address",
            f"{show(session.bluetooth_address)} is not a Bluetooth MAC: six hexadecimal pairs, 5C:F3:70:9A:1B:2E",
        )


def _is_ip(address: str) -> bool:
    try:
        ipaddress.ip_address(address)
    except ValueError:
        return False
    return True


def _is_host(address: str) -> bool:
    """RFC 1123 section 2.1, with the underscores that container networks use. All digits and dots is a broken IPv4."""
    labels = address.removesuffix(".").split(".")
    return len(address) <= 253 and all(_HOST_LABEL.fullmatch(label) for label in labels) and not labels[-1].isdecimal()


def _port(port: int, location: str, transport: type[TransportTraits]) -> Iterator[Problem]:
    if port not in transport.ports:
        yield Problem(location, f"{port} is not a valid {transport.port_kind}: {transport.ports}")


def transport_of(topic: Topic, session: Session | None) -> type[TransportTraits]:
    """What carries a topic: its own transport, else the link's; without a session, an IP link's."""
    if topic.protocol is not None:
        return transports.named(topic.protocol)
    return transports.of_link(session.server_ip if session is not None else "")


def _key_files(session: Session) -> Iterator[Problem]:
    owners = [("key_file", session.key_file)]
    if session.clients:
        owners += [(f"clients[{at}].key_file", client.key_file) for at, client in enumerate(session.clients)]
    for location, key_file in owners:
        if key_file is not None and not (key_file.strip() and key_file.isprintable()):
            yield Problem(location, f"{show(key_file)} is not a file name: give the key file's")
    if not session.use_encryption or session.key_file is not None:
        return
    for location, key_file in owners[1:] or owners:
        if key_file is None:
            yield Problem(
                location, "missing: encryption needs a key; make one with `rsb-console keygen` and give its file's name"
            )


def _topic(topic: Topic, location: str, session: Session | None, client: str | None) -> Iterator[Problem]:
    yield from _topic_name(topic.topic, join(location, "topic"))
    if topic.remote_topic is not None:
        yield from _topic_name(topic.remote_topic, join(location, "remote_topic"))
    elif client is not None and len(topic.topic) <= TOPIC_LENGTH:
        yield from _length(server_topic(topic.topic, client), join(location, "topic"), " with its prefix")
    yield from _type(topic.type, join(location, "type"))
    if session is not None:
        yield from _protocol(topic, location, session)
    if topic.port is not None:
        yield from _port(topic.port, join(location, "port"), transport_of(topic, session))
    yield from _qos(topic.qos, join(location, "qos"))
    yield from _rate(topic.max_rate, join(location, "max_rate"))
    yield from _rate(topic.expected_rate, join(location, "expected_rate"))
    if topic.stale_after is not None:
        yield from _stale_after(topic.stale_after, join(location, "stale_after"))


def _topic_name(name: str, location: str) -> Iterator[Problem]:
    if not is_topic_name(name):
        better = well_formed(name)
        hint = f" (did you mean /{better}?)" if better else ""
        yield Problem(
            location,
            f"{show(name)} is not an absolute topic name: /part/part, of letters, digits and _, no digit first{hint}",
        )
    elif name == ANNOUNCEMENT_TOPIC:
        yield Problem(
            location, f"{show(name)} is what bridges tell each other: it is never bridged; name another topic"
        )
    else:
        yield from _length(name, location)


def _length(name: str, location: str, how: str = "") -> Iterator[Problem]:
    if len(name) > TOPIC_LENGTH:
        yield Problem(
            location, f"{show(name)} has {len(name)} characters{how}, and ROS allows at most {TOPIC_LENGTH}: shorten it"
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


def _protocol(topic: Topic, location: str, session: Session) -> Iterator[Problem]:
    if session.is_bluetooth:
        if topic.protocol not in (None, "bluetooth"):
            yield Problem(
                join(location, "protocol"),
                f"{topic.protocol} does not cross a Bluetooth link (server_ip is a MAC): leave protocol out",
            )
    elif topic.protocol == "bluetooth" and session.bluetooth_address is None:
        yield Problem(
            join(location, "protocol"),
            "bluetooth needs the MAC of the server's adapter: as server_ip for the whole link, or as bluetooth_address "
            "for such topics",
        )
    elif topic.protocol == "bluetooth" and topic.port is None:
        yield Problem(
            join(location, "port"),
            f"missing: a bluetooth topic of an IP link needs a channel, {CHANNEL}; several topics may share one",
        )


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


def _rate(rate: float | None, location: str) -> Iterator[Problem]:
    if rate is not None and rate not in RATE:
        yield Problem(location, f"{rate} is out of range: {RATE} Hz, or leave it out")


def _stale_after(seconds: float, location: str) -> Iterator[Problem]:
    if seconds and seconds not in STALE_AFTER:
        yield Problem(location, f"{seconds} is out of range: {STALE_AFTER} s, or 0 to never warn")


def _topics(topics: Sequence[Topic], location: str, session: Session, client: str | None) -> Iterator[Problem]:
    """Mistakes in the topics of one link; `client` as in `validate_topic`."""
    for at, topic in enumerate(topics):
        yield from _topic(topic, join(location, at), session, client)
    yield from _clashes(topics, location, session)


def _clashes(topics: Sequence[Topic], where: str, session: Session) -> Iterator[Problem]:
    """Topics of one link that are there twice, or want one port."""
    routes: dict[tuple[str, str], int] = {}
    ports: dict[tuple[str, int], int] = {}
    shared = -1
    link = transports.of_link(session.server_ip)
    for name in (link.name, *link.companions):
        ports[name, session.server_port] = shared
    for at, topic in enumerate(topics):
        location = join(where, at)
        first = routes.setdefault((topic.topic, topic.direction), at)
        if first != at:
            yield Problem(location, f"{topic.topic} ({topic.direction}) is there already, as number {first + 1}")
        if topic.port is None:
            continue
        transport = transport_of(topic, session)
        holder = ports.setdefault((transport.name, topic.port), at)
        if holder == shared:
            yield Problem(join(location, "port"), f"{topic.port} is the server_port: leave port out to share it")
        elif holder != at and not transport.multiplexed:
            yield Problem(
                join(location, "port"),
                f"{transport.name} {transport.port_kind} {topic.port} is taken by {topics[holder].topic}: "
                "give another, or leave it out",
            )


def _clients(session: Session) -> Iterator[Problem]:
    if session.role == "server" and session.topics:
        yield Problem(
            "role", "a server has no topics of its own: move them to the client's file, or under its entry in clients"
        )
    if session.role == "client" and session.clients:
        yield Problem("role", "a client has no clients: only a server lists them")
    names: dict[str, int] = {}
    for at, client in enumerate(session.clients):
        location = join("clients", at)
        use_name = session.use_name if client.use_name is None else client.use_name
        yield from _name(client.name, join(location, "name"), use_name=use_name)
        first = names.setdefault(client.name, at)
        if first != at:
            yield Problem(
                join(location, "name"), f"{show(client.name)} is the name of client number {first + 1} already"
            )
        yield from _patterns(client, location)
        yield from _topics(client.topics, join(location, "topics"), session, client.name if use_name else None)


def _patterns(client: Client, location: str) -> Iterator[Problem]:
    for key, patterns in (("allow", client.allow), ("deny", client.deny)):
        for at, pattern in enumerate(patterns):
            if not (pattern.startswith(("/", "*")) and pattern.isprintable()):
                yield Problem(
                    join(join(location, key), at),
                    f"{show(pattern)} matches no topic: a pattern begins with / or * (/robot1/*)",
                )

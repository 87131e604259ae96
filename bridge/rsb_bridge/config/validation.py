"""The rules of a session beyond the kind of each value. Every mistake is reported, each with its remedy."""

from __future__ import annotations

import ipaddress
import re
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.config.decoding import Hint, ValueMistake, join, read, show, under
from rsb_bridge.config.file_form import (
    LISTS,
    NAME_KEYS,
    NOUNS,
    SESSION_FILE,
    as_session,
    as_topic,
    as_written,
    foreign,
    key_of,
    locations,
)
from rsb_bridge.config.grants import grant_problems
from rsb_bridge.config.keys import conceal
from rsb_bridge.config.name_rules import armed_name_problems, form_problems, name_problems
from rsb_bridge.config.operator_keys import operator_problems
from rsb_bridge.config.overlaps import overlaps, too_many_patterns
from rsb_bridge.config.topic_rules import (
    entry_problems,
    limits_problems,
    on_end_problems,
    port_problems,
    range_problems,
    topic_problems,
    transport_of,
    unreported,
)
from rsb_bridge.feature import BRINGS_TRANSPORTS
from rsb_bridge.installed_features import added
from rsb_bridge.model import transports
from rsb_bridge.model.by_hand import end_text
from rsb_bridge.model.demands import SourceKey, line_of, local_name
from rsb_bridge.model.limits import DOMAIN, NAME_BYTES, OUTLIVE, PACE, TOPIC_PORT
from rsb_bridge.model.names import is_prefix, well_formed
from rsb_bridge.model.patterns import is_pattern
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.session import ArmedName, Identity, Problem, Session, Topic, peer_keys
from rsb_bridge.model.text import is_clean
from rsb_bridge.model.topic_keys import ADDED_KEYS, type_of, value_of
from rsb_bridge.model.transport_traits import TcpTraits, is_mac
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.session import Client, Kind


class SessionMistake(Wording):
    """A mistake in a session beyond its entries for topics."""

    NAME_UNPRINTABLE = "{name} is not a name: give printable characters"
    NAME_TOO_LONG = "has {length} bytes in UTF-8, and at most {limit} are allowed"
    NAME_NOT_A_PREFIX = "{name} cannot be a prefix of topic names, as use_name requires{hint}"
    PORT_MISSING = "missing, or 0: give a {kind}, {range}"
    DOMAIN_INVALID = "{domain} is not a ROS domain: {range}"
    DOMAIN_VARIABLE_INVALID = "ROS_DOMAIN_ID is {value}, which is not a ROS domain: {range}"
    OUT_OF_RANGE = "{value} is out of range: {range} s"
    MULTIPATH_UNKNOWN = "a link over {medium} has one way only: leave it out"
    STALE_WARNINGS_NEGATIVE = "{count} is not a count: 0 or more"
    PROFILE_ON_BLUETOOTH = "{profile} is no Bluetooth link (server_ip is a MAC): give bluetooth, or leave profile out"
    ADDRESS_OF_CLIENT = "a client cannot connect to {address}: give the server's own address"
    ADDRESS_WITH_DASHES = "{address} is not an address{hint}"
    ADDRESS_INVALID = "{address} is not an IPv4 or IPv6 address, a host name, or a Bluetooth MAC"
    ADDRESS_EMPTY = "missing: give the server's address, or a list of several"
    ADDRESS_TWICE = "{address} is listed already"
    ADDRESSES_OF_SERVER = "a server binds one address: give 0.0.0.0 for all of IPv4, or :: for all"
    ADDRESSES_OF_SEVERAL_KINDS = "only IP addresses and host names may be listed together: one link has one transport"
    ZONE_MISSING = "{address} is link-local: add the interface, as in {address}%wlan0 (ip addr shows it)"
    ADAPTER_TWICE = "server_ip is a Bluetooth MAC already: leave bluetooth_address out"
    ADAPTER_INVALID = "{address} is not a Bluetooth MAC: six hexadecimal pairs, 5C:F3:70:9A:1B:2E"
    TOPIC_TWICE = "{name} ({end}) is listed already, as number {number}"
    SOURCE_TWICE = "{name} comes from the server's {remote}, too: bridge it once, under one name"
    PORT_OF_LINK = "{port} is the server_port: leave port out to share it"
    PORT_TAKEN = "{protocol} {kind} {port} is taken by {name}: give another, or leave it out"
    TOPICS_OF_SERVER = (
        "a server has no {list} of its own: move them to the client's file, or under its entry in clients"
    )
    CLIENTS_OF_CLIENT = "a client has no clients: only a server lists them"
    KEY_OF_SERVER = "belongs in the server's session file, which says what clients may do: leave it out"
    TOPIC_PORT_INVALID = "{port} is no port for a topic: {range}"
    KEY_OF_ITS_CLIENT = "belongs under the client that it is for, in clients"
    CLIENT_TWICE = "{name} is the name of client number {number} already"
    KEY_FILE_MISSING = "missing: encryption needs a key; make one with `rsb-console keygen` and give its file's name"
    KEY_FILE_INVALID = "{name} is not a file name: give the key file's"
    NEXT_KEY_ON_CLIENT = (
        "belongs in the server's session file, where two keys may be valid: here, replace the file that key_file "
        "names, and reload"
    )
    NEXT_KEY_ALONE = "key_file is missing, which this key would replace: give key_file too"
    NEXT_KEY_IS_CURRENT = "{name} is the key_file already: give the new key's file"


_ANY_ADDRESS = ("0.0.0.0", "::", "00:00:00:00:00:00")  # noqa: S104 (refused, not bound)
_ENTRY = re.compile(rf"(?P<list>{'|'.join(NOUNS)})\[(?P<at>\d{{1,9}})\]")
_HOST_LABEL = re.compile(r"[A-Za-z0-9_]([A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?")


def build(data: object) -> tuple[Session, list[Problem]]:
    """Make a session of what YAML made of a session file.

    Returns:
        The session, to be used only if there are no problems, and all problems.
    """
    problems: list[Problem] = []
    session = as_session(read(data, SESSION_FILE, problems))
    found = problems + unreported(_session(session), problems)
    return session, [placed(problem, data) for problem in found]


def placed(problem: Problem, data: object) -> Problem:
    """Name the topic, service or client that a problem is about, by its name if it has one, else by its number."""
    parts, rest, around = [], problem.location, data
    while (match := _ENTRY.match(rest)) and isinstance(around, dict):
        noun, name = NOUNS[match["list"]], NAME_KEYS.get(match["list"], "name")
        entries, at = around.get(match["list"]), int(match["at"])
        if not isinstance(entries, list | tuple) or at >= len(entries):
            break  # a key that only looks like an entry
        around, rest = entries[at], rest[match.end() :].removeprefix(".")
        called = around.get(name) if isinstance(around, dict) else None
        if isinstance(called, str) and called and len(called) <= NAME_BYTES and called.isprintable():
            parts.append(f"{noun} {conceal(called)}")
        else:
            parts.append(f"{noun} {at + 1}")
    return replace(problem, place=", ".join([*parts, rest] if rest else parts)) if parts else problem


def validate(session: Session) -> list[Problem]:
    data = msgspec.to_builtins(as_written(session))
    problems = build(data)[1]
    holders = [("", session.topics)]
    holders += [(join("clients", at), each.topics) for at, each in enumerate(session.listed_clients)]
    for where, topics in holders:
        for topic, here in zip(topics, locations(topics), strict=True):
            # A topic from a peer or a program may have fields that a file has no key for.
            for field, remedy in foreign(topic).items():
                problems.append(placed(Problem(join(join(where, here), field), remedy), data))
    return problems


def validate_topic(topic: Topic, session: Session | None = None, *, client: str | None = None) -> list[Problem]:
    """Do as `entry_problems`, for a topic of a form or a program, whose values may be of the wrong kind, too."""
    mistyped: list[Problem] = []
    try:
        msgspec.convert(msgspec.to_builtins(topic), Topic)
        for name, key in ADDED_KEYS.items():
            msgspec.convert(value_of(topic, name), type_of(key))
    except msgspec.ValidationError:
        written = as_written(topic)
        topic = as_topic(topic.kind, read(msgspec.to_builtins(written), type(written), mistyped))
    return mistyped + unreported(entry_problems(topic, session, client=client), mistyped)


def domain_of(session: Session, variable: str | None) -> int:
    """Return the ROS domain that a session joins.

    Args:
        session: whose `Session.domain_id` comes first.
        variable: the value of ``$ROS_DOMAIN_ID``. None or blank is 0, as in ROS.

    Raises:
        ValueError: the variable counts, and is not a domain.
    """
    if session.domain_id is not None:
        return session.domain_id
    text = (variable or "").strip() or "0"
    if not text.isdecimal() or int(text) not in DOMAIN:
        raise ValueError(SessionMistake.DOMAIN_VARIABLE_INVALID(value=repr(text), range=DOMAIN))
    return int(text)


def _session(session: Session) -> Iterator[Problem]:
    # A server with a list of clients has their names as prefixes, not its own.
    yield from _name(session.name, "name", use_name=session.use_name and session.clients is None)
    if session.group is not None:
        yield from _name(session.group, "group", use_name=False)
    yield from _address(session)
    link = transports.of_link(session.host)
    if not session.server_port and 0 not in link.ports:
        yield Problem("server_port", SessionMistake.PORT_MISSING(kind=link.port_kind, range=link.ports))
    else:
        yield from port_problems(session.server_port, "server_port", link)
    if session.domain_id is not None and session.domain_id not in DOMAIN:
        yield Problem("domain_id", SessionMistake.DOMAIN_INVALID(domain=session.domain_id, range=DOMAIN))
    yield from key_file_problems(session)
    yield from operator_problems(session)
    yield from range_problems(session)
    if session.stale_warnings < 0:
        yield Problem("stale_warnings", SessionMistake.STALE_WARNINGS_NEGATIVE(count=session.stale_warnings))
    for key, seconds, allowed in (("outlive", session.outlive, OUTLIVE), ("pace", session.pace, PACE)):
        if seconds is not None and seconds not in allowed:
            yield Problem(key, SessionMistake.OUT_OF_RANGE(value=seconds, range=allowed))
    if session.multipath and not link.several_ways:
        yield Problem("multipath", SessionMistake.MULTIPATH_UNKNOWN(medium=link.medium))
    profiles = [("profile", session.profile)]
    profiles += [(join(join("clients", at), "profile"), each.profile) for at, each in enumerate(session.listed_clients)]
    for location, profile in profiles:
        if session.is_bluetooth and profile not in (None, "bluetooth"):
            yield Problem(location, SessionMistake.PROFILE_ON_BLUETOOTH(profile=profile))
    if session.shutdown_topic is not None:
        yield from name_problems(session.shutdown_topic, "shutdown_topic")
    client = session.name if session.role == "client" and session.use_name else None
    yield from _topics(session.topics, session, client)
    yield from armed_problems(session.armed)
    yield from _clients(session)
    yield from (Problem(key, text) for key, text in added("problems", session))


def _name(name: str, location: str, *, use_name: bool) -> Iterator[Problem]:
    if not name.strip() or not (name.isprintable() and is_clean(name)):
        yield Problem(location, SessionMistake.NAME_UNPRINTABLE(name=show(name)))
    elif len(name.encode()) > NAME_BYTES:
        yield Problem(location, SessionMistake.NAME_TOO_LONG(length=len(name.encode()), limit=NAME_BYTES))
    elif use_name and not is_prefix(name):
        hint = Hint.DID_YOU_MEAN(name=well_formed(name))
        yield Problem(location, SessionMistake.NAME_NOT_A_PREFIX(name=show(name), hint=hint))


def _address(session: Session) -> Iterator[Problem]:
    several = len(session.hosts) > 1
    for at, address in enumerate(session.hosts):
        location = join("server_ip", at) if several else "server_ip"
        if problem := _host_problem(address, session):
            yield Problem(location, problem)
        elif address in session.hosts[:at]:
            yield Problem(location, SessionMistake.ADDRESS_TWICE(address=address))
    if several:
        if session.role == "server":
            yield Problem("server_ip", SessionMistake.ADDRESSES_OF_SERVER())
        elif {transports.of_link(each) for each in session.hosts} != {TcpTraits}:
            yield Problem("server_ip", SessionMistake.ADDRESSES_OF_SEVERAL_KINDS())
    if session.bluetooth_address is None:
        return
    if session.is_bluetooth:
        yield Problem("bluetooth_address", SessionMistake.ADAPTER_TWICE())
    elif not is_mac(session.bluetooth_address):
        yield Problem("bluetooth_address", SessionMistake.ADAPTER_INVALID(address=show(session.bluetooth_address)))


def _host_problem(address: str, session: Session) -> str:
    """Return what is wrong with an address of the server, or an empty string."""
    if not address:
        return SessionMistake.ADDRESS_EMPTY()
    traits = transports.of_link(address)
    if traits is TcpTraits and address in BRINGS_TRANSPORTS:
        return ValueMistake.OF_FEATURE(value=address, feature=BRINGS_TRANSPORTS[address])
    if session.role == "client" and address in _ANY_ADDRESS:
        return SessionMistake.ADDRESS_OF_CLIENT(address=address)
    if is_mac(address.replace("-", ":")) and "-" in address:
        hint = Hint.DID_YOU_MEAN(name=address.replace("-", ":"))
        return SessionMistake.ADDRESS_WITH_DASHES(address=repr(address), hint=hint)
    if traits is TcpTraits and not (is_ip(address) or is_host(address)):
        return SessionMistake.ADDRESS_INVALID(address=show(address))
    return SessionMistake.ZONE_MISSING(address=address) if lacks_zone(address) else ""


def is_ip(address: str) -> bool:
    try:
        ipaddress.ip_address(address)
    except ValueError:
        return False
    return True


def lacks_zone(address: str) -> bool:
    """Whether it is a link-local address of IPv6 that does not name the interface, without which nothing reaches it."""
    ip = ipaddress.ip_address(address) if is_ip(address) else None
    return isinstance(ip, ipaddress.IPv6Address) and ip.is_link_local and ip.scope_id is None


def zone_of(address: str) -> str | None:
    """Return the interface that an address names, or None."""
    ip = ipaddress.ip_address(address) if is_ip(address) else None
    return ip.scope_id if isinstance(ip, ipaddress.IPv6Address) else None


def is_host(address: str) -> bool:
    """Whether it is a host name: RFC 1123 section 2.1, with the underscores that container networks use.

    All digits and dots is a broken IPv4.
    """
    labels = address.removesuffix(".").split(".")
    return len(address) <= 253 and all(_HOST_LABEL.fullmatch(label) for label in labels) and not labels[-1].isdecimal()


def _topics(topics: Sequence[Topic], session: Session, client: str | None) -> Iterator[Problem]:
    """Yield the mistakes in the topics, services, actions and parameters that one link bridges.

    Args:
        client: as in `entry_problems`.
    """
    for topic, here in zip(topics, locations(topics), strict=True):
        yield from under(here, topic_problems(topic, session, client))
    yield from _clashes(topics, session, client)
    yield from too_many_patterns(topics)
    yield from overlaps(topics)


def _clashes(topics: Sequence[Topic], session: Session, client: str | None) -> Iterator[Problem]:
    """Yield the topics of one link that are listed twice, or want the same port."""
    routes: dict[Identity, int] = {}
    sources: dict[tuple[Kind, str], int] = {}
    ports: dict[tuple[str, int], int] = {}
    shared = -1  # the index of no topic
    link = transports.of_link(session.host)
    for name in (link.name, *link.companions):
        ports[name, session.server_port] = shared
    for at, (topic, location) in enumerate(zip(topics, locations(topics), strict=True)):
        first = routes.setdefault(topic.identity, at)
        if first != at:
            end = topic.direction if topic.kind == "topic" else f"provider: {topic.provider}"
            number = sum(each.kind == topic.kind for each in topics[: first + 1])
            yield Problem(location, SessionMistake.TOPIC_TWICE(name=topic.topic, end=end, number=number))
        elif topic.direction == "receive" and not is_pattern(topic.topic):
            on_server = local_name(topic, client or "", on_server=True, use_name=client is not None)
            other = topics[sources.setdefault((topic.kind, on_server), at)]
            if other is not topic:
                found = SessionMistake.SOURCE_TWICE(name=other.topic, remote=on_server)
                yield Problem(join(location, key_of(topic.kind, "remote_topic")), found)
        if topic.port is None:
            continue
        transport = transport_of(topic, session)
        holder = ports.setdefault((transport.name, topic.port), at)
        if holder == shared:
            yield Problem(join(location, "port"), SessionMistake.PORT_OF_LINK(port=topic.port))
        elif holder != at and not transport.multiplexed:
            message = SessionMistake.PORT_TAKEN(
                protocol=transport.name, kind=transport.port_kind, port=topic.port, name=topics[holder].topic
            )
            yield Problem(join(location, "port"), message)


def _clients(session: Session) -> Iterator[Problem]:
    if session.role == "server" and session.topics:
        yield Problem("role", SessionMistake.TOPICS_OF_SERVER(list=LISTS[session.topics[0].kind]))
    if session.role == "client" and session.clients is not None:
        yield Problem("role", SessionMistake.CLIENTS_OF_CLIENT())
    for key, given in (("shared_keys", session.shared_keys), ("ports", session.ports is not None)):
        if session.role == "client" and given:
            yield Problem(key, SessionMistake.KEY_OF_SERVER())
    for at, port in enumerate(session.ports if isinstance(session.ports, tuple) else ()):
        if port not in TOPIC_PORT:
            yield Problem(join("ports", at), SessionMistake.TOPIC_PORT_INVALID(port=port, range=TOPIC_PORT))
    yield from grant_problems(session)
    if session.role == "server" and (session.allow or session.deny):
        yield Problem("allow" if session.allow else "deny", SessionMistake.KEY_OF_ITS_CLIENT())
    for key in session.features if session.clients is not None else ():
        if key in peer_keys():
            yield Problem(key, SessionMistake.KEY_OF_ITS_CLIENT())
    firsts: dict[str, int] = {}
    for at, client in enumerate(session.listed_clients):
        first = firsts.setdefault(client.name, at)
        yield from under(join("clients", at), _client(client, session, None if first == at else first))


def _client(client: Client, session: Session, first: int | None) -> Iterator[Problem]:
    """Yield the mistakes in one client of a server.

    Args:
        first: the index of the client that has its name already, or None.
    """
    if client.group is not None:
        yield from _name(client.group, "group", use_name=False)
    use_name = client.is_prefixed(session)
    yield from _name(client.name, "name", use_name=use_name)
    if first is not None:
        yield Problem("name", SessionMistake.CLIENT_TWICE(name=show(client.name), number=first + 1))
    yield from grant_problems(client)
    yield from _topics(client.topics, session, client.name if use_name else None)


def armed_problems(armed: Sequence[str | ArmedName]) -> Iterator[Problem]:
    firsts: dict[SourceKey, int] = {}
    for at, each in enumerate(armed):
        entry, here = ArmedName(each) if isinstance(each, str) else each, join("armed", at)
        yield from form_problems(entry.name, here if isinstance(each, str) else join(here, "name"), hidden=True)
        yield from under(here, armed_name_problems(entry))
        yield from under(here, range_problems(entry))
        yield from under(here, on_end_problems(end_text(entry.on_end), entry.kind))
        yield from under(here, limits_problems(entry.limits, entry.kind, entry.type or AUTO, entry.name))
        if (first := firsts.setdefault(line_of(each).key, at)) != at:
            yield Problem(here, f"{show(entry.name)} is listed already, as number {first + 1}: keep one")


def key_file_problems(session: Session) -> Iterator[Problem]:
    """Yield all mistakes in a session's key files, without those in their contents."""
    holders: list[tuple[str, Session | Client, str | None]] = [("", session, session.key_file)]
    for at, client in enumerate(session.listed_clients):
        holders.append((join("clients", at), client, client.key_file or session.key_file))
    for location, holder, current in holders:
        following = holder.next_key_file
        for key, name in (("key_file", holder.key_file), ("next_key_file", following)):
            if name is not None and not (name.strip() and name.isprintable()):
                yield Problem(join(location, key), SessionMistake.KEY_FILE_INVALID(name=show(name)))
        if following is not None and current is None:
            yield Problem(join(location, "next_key_file"), SessionMistake.NEXT_KEY_ALONE())
        elif following is not None and following == current:
            yield Problem(join(location, "next_key_file"), SessionMistake.NEXT_KEY_IS_CURRENT(name=show(following)))
    if session.role == "client" and session.next_key_file is not None:
        yield Problem("next_key_file", SessionMistake.NEXT_KEY_ON_CLIENT())
    if session.use_encryption and session.key_file is None:
        for location, holder, _ in holders[:1] if session.clients is None else holders[1:]:
            if holder.key_file is None:
                yield Problem(join(location, "key_file"), SessionMistake.KEY_FILE_MISSING())

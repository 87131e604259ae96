"""What makes a session right, beyond the kind of each value. Says everything that is wrong, and what would be right."""

from __future__ import annotations

import ipaddress
import re
from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.config.decoding import did_you_mean, join, read, show
from rsb_bridge.config.keys import conceal
from rsb_bridge.model.qos import AUTO, PROFILES, Qos, parse_qos
from rsb_bridge.model.session import Client, Problem, Session, Topic, is_mac
from rsb_bridge.ros.types import expand_type_name
from rsb_bridge.wire.fields import HIGHEST_RATE, LOWEST_RATE

if TYPE_CHECKING:
    from collections.abc import Iterator

MAX_PORT = 65535
MAX_CHANNEL = 30  # RFCOMM: Bluetooth Core specification, RFCOMM section 5.4
MAX_DOMAIN = 232  # the last whose ports fit below 65536: DDSI-RTPS 2.5, section 9.6.1
MAX_TOPIC = 247  # rmw/validate_full_topic_name.h, RMW_TOPIC_MAX_NAME_LENGTH
MIN_STALE, MAX_STALE = 0.1, 1e6  # s; the least is some looks of the engine's, the most eleven days
MAX_DEPTH = 1_000_000  # messages
MAX_QOS_TIME = 1e9  # s, as on the wire
MAX_NAME = 255  # bytes: PROTOCOL.md section 1.1 gives a name's length one byte

_ANY_ADDRESS = ("0.0.0.0", "::", "00:00:00:00:00:00")  # noqa: S104 (refused, not bound)
_NAME_PART = r"[A-Za-z_][A-Za-z0-9_]*"
_TOPIC = re.compile(rf"(/{_NAME_PART})+")
_PREFIX = re.compile(rf"{_NAME_PART}(/{_NAME_PART})*")
_HOST_LABEL = re.compile(r"[A-Za-z0-9_]([A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?")


def build(data: object) -> tuple[Session, list[Problem]]:
    """A session of plain data, and all that is wrong with it.

    Args:
        data: what YAML made of a session file.

    Returns:
        The session, to be used only if the list is empty.
    """
    problems: list[Problem] = []
    session = read(data, Session, problems)
    return session, problems + _unreported(_session(session), problems)


def validate(session: Session) -> list[Problem]:
    """All that is wrong with a session; empty where it is right."""
    return build(msgspec.to_builtins(session))[1]


def validate_topic(topic: Topic, session: Session | None = None) -> list[Problem]:
    """All that is wrong with a topic by itself.

    Args:
        topic: to look at.
        session: whose it is to be, for what its link can carry; None: it is not known yet.

    Returns:
        The problems; a place is the key: ``protocol``.
    """
    problems: list[Problem] = []
    topic = read(msgspec.to_builtins(topic), Topic, problems)
    return problems + _unreported(_topic(topic, "", session), problems)


def _unreported(found: Iterator[Problem], reported: list[Problem]) -> list[Problem]:
    """Leaves out what rests on a value that is a problem of its own: its stand-in may break a rule it never broke."""
    places = [problem.place for problem in reported]
    return [new for new in found if not any(_within(new.place, old) or _within(old, new.place) for old in places)]


def _within(place: str, outer: str) -> bool:
    return not outer or place == outer or place.startswith((f"{outer}.", f"{outer}["))


def _session(session: Session) -> Iterator[Problem]:
    yield from _name(session.name, "name", use_name=session.use_name and not session.clients)
    yield from _address(session)
    yield from _port(session.server_port, "server_port", bluetooth=session.is_bluetooth)
    if session.domain_id is not None and not 0 <= session.domain_id <= MAX_DOMAIN:
        yield Problem("domain_id", f"{session.domain_id} is not a ROS domain: 0 to {MAX_DOMAIN}")
    yield from _key_files(session)
    yield from _seconds(session.stale_after, "stale_after")
    if session.stale_warnings < 0:
        yield Problem("stale_warnings", f"{session.stale_warnings} is not a count: 0 or more")
    if session.shutdown_topic is not None:
        yield from _topic_name(session.shutdown_topic, "shutdown_topic")
    for at, topic in enumerate(session.topics):
        yield from _topic(topic, join("topics", at), session)
    yield from _clashes(session)
    yield from _clients(session)


def _name(name: str, place: str, *, use_name: bool) -> Iterator[Problem]:
    if not name.strip() or not name.isprintable():
        yield Problem(place, f"{show(name)} is not a name: give printable characters")
    elif len(name.encode()) > MAX_NAME:
        yield Problem(place, f"longer than {MAX_NAME} bytes")
    elif use_name and not _PREFIX.fullmatch(name):
        better = _repaired(name)
        yield Problem(place, f"{show(name)} cannot be a prefix of ROS topics, as use_name has it; {better!r} can")


def _address(session: Session) -> Iterator[Problem]:
    address = session.server_ip
    if session.role == "client" and address in _ANY_ADDRESS:
        yield Problem("server_ip", f"{address!r} is every address of a server: a client needs one, the server's own")
    elif is_mac(address.replace("-", ":")) and "-" in address:
        yield Problem("server_ip", f"{address!r} is not an address (did you mean {address.replace('-', ':')}?)")
    elif not (is_mac(address) or _is_ip(address) or _is_host(address)):
        yield Problem("server_ip", f"{show(address)} is not an IPv4 or IPv6 address, a host name, or a Bluetooth MAC")
    if session.bluetooth_address is None:
        return
    if session.is_bluetooth:
        yield Problem("bluetooth_address", "the whole link is Bluetooth already, as server_ip says: leave this out")
    elif not is_mac(session.bluetooth_address):
        yield Problem(
            "bluetooth_address", f"{show(session.bluetooth_address)} is not a Bluetooth MAC: six pairs with : between"
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


def _port(port: int, place: str, *, bluetooth: bool) -> Iterator[Problem]:
    if bluetooth and not 1 <= port <= MAX_CHANNEL:
        yield Problem(place, f"{port} is not an RFCOMM channel: 1 to {MAX_CHANNEL}")
    elif not 1 <= port <= MAX_PORT:
        yield Problem(place, f"{port} is not a port: 1 to {MAX_PORT}")


def _key_files(session: Session) -> Iterator[Problem]:
    owners = [("key_file", session.key_file)]
    if session.clients:
        owners += [(f"clients[{at}].key_file", client.key_file) for at, client in enumerate(session.clients)]
    for place, key_file in owners:
        if key_file is not None and not (key_file.strip() and key_file.isprintable()):
            yield Problem(place, f"{show(key_file)} is not a file name: name the key file")
    if not session.use_encryption or session.key_file is not None:
        return
    for place, key_file in owners[1:] or owners:
        if key_file is None:
            yield Problem(
                place, "missing: use_encryption needs a key; make one with `rsb-console keygen` and name its file"
            )


def _topic(topic: Topic, place: str, session: Session | None) -> Iterator[Problem]:
    yield from _topic_name(topic.topic, join(place, "topic"))
    if topic.remote_topic is not None:
        yield from _topic_name(topic.remote_topic, join(place, "remote_topic"))
    yield from _type(topic.type, join(place, "type"))
    if session is not None:
        yield from _protocol(topic, place, session)
    if topic.port is not None:
        rfcomm = topic.protocol == "bluetooth" or (
            topic.protocol is None and session is not None and session.is_bluetooth
        )
        yield from _port(topic.port, join(place, "port"), bluetooth=rfcomm)
    yield from _qos(topic.qos, join(place, "qos"))
    yield from _rate(topic.max_rate, join(place, "max_rate"))
    yield from _rate(topic.expected_rate, join(place, "expected_rate"))
    if topic.stale_after is not None:
        yield from _seconds(topic.stale_after, join(place, "stale_after"))


def _qos(value: str | int | dict[str, Any], place: str) -> Iterator[Problem]:
    if isinstance(value, dict):
        problems: list[Problem] = []
        read({key: policy for key, policy in value.items() if key != "profile"}, Qos, problems, place)
        yield from problems
        if problems:
            return
    try:
        qos = parse_qos(value)
    except ValueError as error:
        name = value.get("profile") if isinstance(value, dict) else value
        options = list(PROFILES) if isinstance(value, dict) else [AUTO, *PROFILES]
        hint = did_you_mean(name, options) if isinstance(name, str) else ""
        yield Problem(place, conceal(f"{error}{hint}"))
        return
    if qos is not None and qos.depth > MAX_DEPTH:
        yield Problem(place, f"a depth is at most {MAX_DEPTH}, not {show(qos.depth)}")
    if qos is not None and not max(qos.deadline, qos.lifespan) <= MAX_QOS_TIME:
        yield Problem(place, f"deadline and lifespan are at most {MAX_QOS_TIME:g} s; 0 is none")


def _type(name: str, place: str) -> Iterator[Problem]:
    if name == AUTO:
        return
    try:
        expand_type_name(name)
    except ValueError as error:
        yield Problem(place, str(error))


def _topic_name(name: str, place: str) -> Iterator[Problem]:
    if len(name) > MAX_TOPIC:
        yield Problem(place, f"{show(name)} is longer than {MAX_TOPIC} characters")
    elif not _TOPIC.fullmatch(name):
        better = _repaired(name)
        hint = f" (did you mean /{better}?)" if better else ""
        yield Problem(
            place,
            f"{show(name)} is not an absolute topic name: /part/part, of letters, digits and _, no digit first{hint}",
        )


def _repaired(name: str) -> str:
    """The closest that ROS would take, without the leading slash; may be empty."""
    parts = (re.sub(r"[^A-Za-z0-9_]", "_", part) for part in name.lstrip("~").split("/") if part)
    return "/".join(f"_{part}" if part[0].isdecimal() else part for part in parts)


def _protocol(topic: Topic, place: str, session: Session) -> Iterator[Problem]:
    if session.is_bluetooth:
        if topic.protocol not in (None, "bluetooth"):
            words = f"server_ip is a Bluetooth MAC: not {topic.protocol} but bluetooth, or leave it out"
            yield Problem(join(place, "protocol"), words)
    elif topic.protocol == "bluetooth" and session.bluetooth_address is None:
        words = (
            "bluetooth needs a Bluetooth MAC: as server_ip for the whole link, or as bluetooth_address for such topics"
        )
        yield Problem(join(place, "protocol"), words)
    elif topic.protocol == "bluetooth" and topic.port is None:
        yield Problem(
            join(place, "port"),
            f"a bluetooth topic of an IP link names a channel: 1 to {MAX_CHANNEL}; several may share one",
        )


def _rate(rate: float | None, place: str) -> Iterator[Problem]:
    if rate is not None and not LOWEST_RATE <= rate <= HIGHEST_RATE:
        words = f"{rate} is not a rate: {LOWEST_RATE:g} to {HIGHEST_RATE:.0f} Hz; leave it out for no figure"
        yield Problem(place, words)


def _seconds(seconds: float, place: str) -> Iterator[Problem]:
    if seconds and not MIN_STALE <= seconds <= MAX_STALE:
        yield Problem(place, f"{seconds} is not a time: {MIN_STALE:g} to {MAX_STALE:.0f} s; 0 never warns")


def _clashes(session: Session) -> Iterator[Problem]:
    """Topics that say the same twice, or want one port."""
    routes: dict[tuple[str, str], int] = {}
    ports: dict[tuple[str, int], str] = {}
    shared = "its server_port"
    for protocol in ("bluetooth",) if session.is_bluetooth else ("tcp", "udp"):
        ports[protocol, session.server_port] = shared
    for at, topic in enumerate(session.topics):
        place = join("topics", at)
        first = routes.setdefault((topic.topic, topic.direction), at)
        if first != at:
            yield Problem(place, f"{topic.topic} is in topics[{first}] already, as {topic.direction}: one can go")
        if topic.port is None:
            continue
        protocol = topic.protocol or ("bluetooth" if session.is_bluetooth else "tcp")
        holder = ports.setdefault((protocol, topic.port), join("topics", at))
        if holder == shared:
            yield Problem(join(place, "port"), f"{topic.port} is the server_port: leave port out to share it")
        elif holder != place and protocol != "bluetooth":  # topics of one link share a channel
            yield Problem(join(place, "port"), f"{protocol} {topic.port} is taken by {holder}: give another, or none")


def _clients(session: Session) -> Iterator[Problem]:
    if session.role == "server" and session.topics:
        yield Problem("role", "a server has no topics, its clients say which: move topics into a client's file")
    if session.role == "client" and session.clients:
        yield Problem("role", "a client has no clients: only a server lists those it lets in")
    names: dict[str, int] = {}
    for at, client in enumerate(session.clients):
        place = join("clients", at)
        use_name = session.use_name if client.use_name is None else client.use_name
        yield from _name(client.name, join(place, "name"), use_name=use_name)
        first = names.setdefault(client.name, at)
        if first != at:
            yield Problem(join(place, "name"), f"{show(client.name)} is the name of clients[{first}] already")
        yield from _patterns(client, place)


def _patterns(client: Client, place: str) -> Iterator[Problem]:
    for key, patterns in (("allow", client.allow), ("deny", client.deny)):
        for at, pattern in enumerate(patterns):
            if not (pattern.startswith(("/", "*")) and pattern.isprintable()):
                yield Problem(
                    join(join(place, key), at),
                    f"{show(pattern)} fits no topic: a pattern begins with / or * (/robot1/*)",
                )

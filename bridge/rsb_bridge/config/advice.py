"""Advice on a session without mistakes: what running it would warn of or refuse, and topics that move a robot."""

from __future__ import annotations

import dataclasses
import importlib.util
import re
import socket
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.decoding import join
from rsb_bridge.config.file_form import LISTS, NOUNS, locations
from rsb_bridge.config.grants import uses
from rsb_bridge.config.rights import Rights, Use, rights_of_client, rights_of_server
from rsb_bridge.config.topic_rules import transport_of
from rsb_bridge.config.validation import domain_of, zone_of
from rsb_bridge.installed_features import added
from rsb_bridge.model import transports
from rsb_bridge.model.demands import (
    Demands,
    demand_on_entry,
    local_name,
    smallest_max_age,
    sources_of,
)
from rsb_bridge.model.limits import (
    KEPT_DEPTH,
    LATCHED_DEPTH,
    PORTS_PER_CLIENT,
    ROUTES_PER_LINK,
    SAFE_DOMAIN,
    dds_ports,
    discovery_domain,
)
from rsb_bridge.model.motion import may_move
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.session import Problem
from rsb_bridge.model.type_names import expand_type_name, split_type_name
from rsb_bridge.model.wording import Wording
from rsb_bridge.transport.descriptors import first_open_port

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.session import Client, Session, Topic

_MIDDLEWARE = "rmw_fastrtps_cpp"


class Advice(Wording):
    """Facts that an operator should know before a session runs."""

    OTHER_MIDDLEWARE = (
        "RMW_IMPLEMENTATION is {middleware}: only types that are installed here cross (docs/support.md); with {tested} "
        "all do"
    )
    NO_ENCRYPTION = "off: all data crosses unencrypted, and anyone may connect"
    NO_CHECKS = "off: a peer's malformed message can make a node here allocate gigabytes"
    NO_INTERFACE = "this machine has no interface {zone}; it has {interfaces}"
    LOW_PORT = "ports below {limit} need root, or CAP_NET_BIND_SERVICE"
    NO_BLUETOOTH = "this Python has no Bluetooth sockets; the distribution's own has (/usr/bin/python3)"
    PORT_OF_DOMAIN = "{port} belongs to ROS domain {domain} ({ports}): its nodes may fail to discover each other"
    PORT_OF_DISCOVERY = "{port} is reserved for discovery in ROS domain {domain}: give another port"
    DOMAIN_COLLIDES = "domain {domain} can collide with other programs' ports; {range} cannot"
    TOO_MANY_TOPICS = "a server accepts {limit} topics from a client, and refuses the rest"
    TOO_MANY_PORTS = (
        "{count} ports of their own: a server binds {limit} for a client, and refuses the rest, unless its session "
        "file lists them as ports"
    )
    SHUTDOWN_TOPIC = 'it is the shutdown_topic: "shutdown" on it also stops the bridge'
    TOPIC_PORT_LOW = "a server refuses {kind}s below {limit} for topics"
    TOPIC_PORT_OF_DISCOVERY = (
        "a server refuses ports by which nodes discover each other: {port} is ROS domain {domain}'s"
    )
    CROSSES_ALTHOUGH_DENIED = "{reason}, but it crosses: deny applies only to entries of the other side"
    TYPE_NOT_INSTALLED = "{type} is not installed here: check the spelling; the {kind} crosses once there is a {who}"
    DEPTH = "depth {depth}: the receiving side keeps {limit} messages in its publisher"
    KEEP = "{seconds:g} s are kept, and a lost link is given up after {outlive:g} s: set outlive to {seconds:g}"
    NEVER_RESTS = "it never rests, as it {why}: leave lazy out"
    BEAT_RATES = "in beat {beat}, {other} has another max_rate, so that they choose apart: give both the same"
    DEPTH_OF_LATCHED = "depth {depth}: the receiving side keeps {limit} messages for late joiners"


def advise(
    session: Session, domain_variable: str | None, middleware: str = "", file: Path | None = None
) -> Iterator[Problem]:
    """Yield everything in a valid session that its operator should know before it runs.

    Args:
        domain_variable: what ``$ROS_DOMAIN_ID`` says.
        middleware: what ``$RMW_IMPLEMENTATION`` says.
        file: as in `Feature.advice`.
    """
    if middleware not in ("", _MIDDLEWARE):
        yield Problem("domain_id", Advice.OTHER_MIDDLEWARE(middleware=middleware, tested=_MIDDLEWARE))
    if not session.use_encryption:
        yield Problem("use_encryption", Advice.NO_ENCRYPTION())
    if not session.check_messages:
        yield Problem("check_messages", Advice.NO_CHECKS())
    yield from _domain(session, domain_variable)
    if problem := interface_problem(session.host):
        yield Problem("server_ip", problem)
    yield from missing_transports(session)
    yield from (Problem(key, text) for key, text in added("advice", session, file))
    yield from _topics(session.topics, "", session)
    yield from _denied(session.topics, "", rights_of_server(session), session)
    for at, client in enumerate(session.listed_clients):
        where = join("clients", at)
        yield from _topics(client.topics, where, session)
        yield from _denied(client.topics, where, rights_of_client(client, session.name), session, client)


def missing_transports(session: Session) -> Iterator[Problem]:
    """Yield the transports that a session uses and this Python does not have."""
    if session.adapter is not None and not hasattr(socket, "AF_BLUETOOTH"):
        location = "server_ip" if session.is_bluetooth else "bluetooth_address"
        yield Problem(location, Advice.NO_BLUETOOTH())
    if problem := transports.of_link(session.host).missing():
        yield Problem("server_ip", problem)


def interface_problem(host: str) -> str:
    """Return that an address's zone is no interface here, which is no mistake: the file may be for another machine."""
    zone, interfaces = zone_of(host), socket.if_nameindex()
    if zone is None or zone in {str(each) for interface in interfaces for each in interface}:
        return ""
    return Advice.NO_INTERFACE(zone=zone, interfaces=", ".join(name for _, name in interfaces))


def _domain(session: Session, variable: str | None) -> Iterator[Problem]:
    try:
        domain = domain_of(session, variable)
    except ValueError as error:
        yield Problem("domain_id", f"{error}; with that value the bridge does not start")
        return
    taken = dds_ports(domain)
    listed = session.ports if isinstance(session.ports, tuple) else ()
    mine = [(join("ports", at), port) for at, port in enumerate(listed)]
    if session.role == "server" and transports.of_link(session.host).ip_ports:
        mine.append(("server_port", session.server_port))
    first = first_open_port()
    for location, port in mine:
        if port < first:
            yield Problem(location, Advice.LOW_PORT(limit=first))
        if port in taken:
            yield Problem(location, Advice.PORT_OF_DOMAIN(port=port, domain=domain, ports=taken))
        elif (other := discovery_domain(port)) is not None:
            yield Problem(location, Advice.PORT_OF_DISCOVERY(port=port, domain=other))
    if domain not in SAFE_DOMAIN:
        yield Problem("domain_id", Advice.DOMAIN_COLLIDES(domain=domain, range=SAFE_DOMAIN))


def _topics(topics: Sequence[Topic], where: str, session: Session) -> Iterator[Problem]:
    if len(topics) > ROUTES_PER_LINK:
        yield Problem(join(where, "topics"), Advice.TOO_MANY_TOPICS(limit=ROUTES_PER_LINK))
    ports = {(topic.protocol, topic.port) for topic in topics if topic.port is not None}
    if len(ports) > PORTS_PER_CLIENT:
        yield Problem(join(where, "topics"), Advice.TOO_MANY_PORTS(count=len(ports), limit=PORTS_PER_CLIENT))
    for topic, here in zip(topics, locations(topics), strict=True):
        location, place = join(where, here), _place(topic)
        if topic.kind == "topic" and topic.topic == session.shutdown_topic:
            yield Problem(location, Advice.SHUTDOWN_TOPIC(), place=place)
        transport = transport_of(topic, session)
        if topic.port is not None and topic.port not in transport.topic_ports:
            yield Problem(
                join(location, "port"),
                Advice.TOPIC_PORT_LOW(kind=transport.port_kind, limit=transport.topic_ports.low),
                place=f"{place}, port",
            )
        elif topic.port is not None and transport.ip_ports and (domain := discovery_domain(topic.port)) is not None:
            yield Problem(
                join(location, "port"),
                Advice.TOPIC_PORT_OF_DISCOVERY(port=topic.port, domain=domain),
                place=f"{place}, port",
            )
        qos = topic.parsed_qos()
        if qos is not None and qos.history != "keep_all":
            limit, advice = (LATCHED_DEPTH, Advice.DEPTH_OF_LATCHED) if qos.latched else (KEPT_DEPTH, Advice.DEPTH)
            if qos.depth > limit:
                message = advice(depth=qos.depth, limit=limit)
                yield Problem(join(location, "qos"), message, place=f"{place}, qos")
        outlive = transports.outlive_of(session.outlive, transports.profile_of(session.profile))
        if topic.kept is not None and topic.kept.seconds > outlive:
            message = Advice.KEEP(seconds=topic.kept.seconds, outlive=outlive)
            yield Problem(join(location, "keep"), message, place=f"{place}, keep")
        if topic.lazy and (why := _why_never_rests(topic)):
            yield Problem(join(location, "lazy"), Advice.NEVER_RESTS(why=why), place=f"{place}, lazy")
        first = next((each for each in topics if topic.beat and each.beat == topic.beat), topic)
        if first.max_rate != topic.max_rate:
            message = Advice.BEAT_RATES(beat=topic.beat, other=first.topic)
            yield Problem(join(location, "max_rate"), message, place=f"{place}, max_rate")


def _why_never_rests(topic: Topic) -> str:
    qos = topic.parsed_qos()
    if topic.arm:
        return "has to be armed"
    if topic.keep is not None:
        return "keeps its messages"
    return "is latched" if qos is not None and qos.latched else ""


def _denied(
    topics: Sequence[Topic], where: str, rights: Rights, session: Session, client: Client | None = None
) -> Iterator[Problem]:
    """`deny` says what the other side may not ask for, and not what this side proposes to it."""
    rights = dataclasses.replace(rights, allow=())  # an entry of this side is permission enough
    sends = "receive" if session.role == "client" else "transmit"
    for topic, here in zip(topics, locations(topics), strict=True):
        may = uses(topic.kind)[topic.direction != sends]
        names = [topic.topic]
        if client is not None:  # `deny` may have the name on either side
            names.append(local_name(topic, client.name, on_server=True, use_name=client.is_prefixed(session)))
        transport = transport_of(topic, session).name
        refusals = (rights.refusal(Use(name, may, transport, topic.kind)) for name in names)
        if refusal := next(filter(None, refusals), None):
            message = Advice.CROSSES_ALTHOUGH_DENIED(reason=refusal.reason)
            yield Problem(join(where, here), message, place=_place(topic))


def uninstalled_types(session: Session) -> Iterator[Problem]:
    """Yield the types of topics that are not installed here. Only looks for their packages, and imports none."""
    if importlib.util.find_spec("rclpy") is None:
        return  # no ROS here: none is installed
    for topic, here in zip(session.topics, locations(session.topics), strict=True):
        name = expand_type_name(topic.type) if topic.type != AUTO else None
        if name and not _is_installed(*split_type_name(name)):
            who = "publisher" if topic.kind == "topic" else "provider"
            yield Problem(
                join(here, "type"),
                Advice.TYPE_NOT_INSTALLED(type=name, kind=topic.kind, who=who),
                place=f"{_place(topic)}, type",
            )


def _place(topic: Topic) -> str:
    return f"{NOUNS[LISTS[topic.kind]]} {topic.topic}"


def _is_installed(package: str, kind: str, name: str) -> bool:
    spec = importlib.util.find_spec(package)
    for folder in (spec and spec.submodule_search_locations) or ():
        index = Path(folder, kind, "__init__.py")  # which rosidl writes
        if index.is_file() and re.search(rf"\bimport {name}\b", index.read_text(encoding="utf-8")):
            return True
    return False


def moves_a_robot(topic: Topic) -> bool:
    """Whether messages of a topic's entry are commands that move a robot, most likely."""
    return topic.kind == "topic" and may_move(topic.type, topic.topic, topic.remote_topic or "")


def _entries(session: Session) -> Iterator[tuple[Client | None, Topic]]:
    """Yield a session's entries, each with the client that a server has it for."""
    yield from ((None, topic) for topic in session.topics)
    yield from ((client, topic) for client in session.listed_clients for topic in client.topics)


def guarded_here_alone(session: Session) -> Iterator[str]:
    """Yield the names of topics that have to be armed, and move a robot in this side's domain.

    After an arming, this bridge alone stops what they drive.
    """
    demands = Demands(sources_of(session))
    for client, topic in _entries(session):
        received = topic.direction == ("receive" if session.role == "client" else "transmit")
        if received and moves_a_robot(topic) and demand_on_entry(demands, session, client, topic).arm:
            yield topic.topic


def with_late_commands(session: Session) -> Iterator[str]:
    """Yield the names of a session's topics that move a robot and whose messages may be of any age."""
    demands = Demands(sources_of(session))
    for client, topic in _entries(session):
        if not moves_a_robot(topic):
            continue
        stated = smallest_max_age((topic.max_age, demand_on_entry(demands, session, client, topic).max_age))
        if stated == 0.0 or (stated is None and topic.kept is not None):
            yield topic.topic

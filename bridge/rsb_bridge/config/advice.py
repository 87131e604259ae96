"""What is no mistake in a session, but what running it would warn of, or refuse for a topic."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

from rsb_bridge.config.decoding import join
from rsb_bridge.config.validation import domain_of, transport_of
from rsb_bridge.model.limits import (
    KEPT_DEPTH,
    LATCHED_DEPTH,
    PORTS_PER_CLIENT,
    ROUTES_PER_LINK,
    SAFE_DOMAIN,
    TOPIC_PORT,
)
from rsb_bridge.model.session import Problem

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.session import Session, Topic


def advise(session: Session, domain_variable: str | None) -> Iterator[Problem]:
    """Everything in a valid session that its operator should know before it runs.

    Args:
        session: without mistakes.
        domain_variable: what ``$ROS_DOMAIN_ID`` says.
    """
    if not session.use_encryption:
        yield Problem("use_encryption", "off: everything crosses in the clear, and anyone may connect")
    yield from _domain(session, domain_variable)
    if session.role == "server" and not session.is_bluetooth and session.server_port not in TOPIC_PORT:
        yield Problem("server_port", f"ports below {TOPIC_PORT.low} need root, or CAP_NET_BIND_SERVICE")
    if session.adapter is not None and not hasattr(socket, "AF_BLUETOOTH"):
        location = "server_ip" if session.is_bluetooth else "bluetooth_address"
        yield Problem(location, "this Python has no Bluetooth sockets; the distribution's own has (/usr/bin/python3)")
    yield from _topics(session.topics, "topics", session)
    for at, client in enumerate(session.clients):
        yield from _topics(client.topics, join(join("clients", at), "topics"), session)


def _domain(session: Session, variable: str | None) -> Iterator[Problem]:
    try:
        domain = domain_of(session, variable)
    except ValueError as error:
        yield Problem("domain_id", f"{error}; with that value the bridge does not start")
        return
    if domain not in SAFE_DOMAIN:
        yield Problem("domain_id", f"domain {domain} can collide with other programs' ports; {SAFE_DOMAIN} cannot")


def _topics(topics: Sequence[Topic], where: str, session: Session) -> Iterator[Problem]:
    if len(topics) > ROUTES_PER_LINK:
        yield Problem(where, f"a server takes {ROUTES_PER_LINK} topics of a client, and refuses the others")
    ports = [topic for topic in topics if topic.port is not None]
    if len(ports) > PORTS_PER_CLIENT:
        yield Problem(where, f"a server binds {PORTS_PER_CLIENT} ports for a client's topics, and refuses the others")
    for at, topic in enumerate(topics):
        location = join(where, at)
        if topic.topic == session.shutdown_topic:
            yield Problem(location, f"{topic.topic} closes the bridge, too: it is the shutdown_topic")
        transport = transport_of(topic, session)
        if topic.port is not None and topic.port not in transport.topic_ports:
            yield Problem(
                join(location, "port"),
                f"a server refuses {transport.port_kind}s below {transport.topic_ports.low} for topics",
            )
        yield from _depth(topic, join(location, "qos"))


def _depth(topic: Topic, location: str) -> Iterator[Problem]:
    qos = topic.parsed_qos()
    if qos is None or qos.history == "keep_all":
        return
    most = LATCHED_DEPTH if qos.latched else KEPT_DEPTH
    if qos.depth > most:
        kept = "for late joiners" if qos.latched else "in its publisher"
        yield Problem(location, f"depth {qos.depth}: the receiving side keeps {most} messages {kept}")

"""The ports of their own and the file descriptors that one client's topics may have on a server."""

from __future__ import annotations

import resource
from typing import TYPE_CHECKING

from rsb_bridge.model.limits import PORTS_PER_CLIENT, dds_ports, discovery_domain
from rsb_bridge.model.text import join_first
from rsb_bridge.model.wording import Wording
from rsb_bridge.transport import descriptors
from rsb_bridge.transport.transport import ListenError

if TYPE_CHECKING:
    from collections.abc import Callable, Sized

    from rsb_bridge.model.session import Session
    from rsb_bridge.model.transport_traits import TransportTraits

_NAMED = 12  # ports that a refusal lists


class PortDenied(Wording):
    """Reasons why a client's topic gets no port of its own, or no stream."""

    NOT_LISTED = (
        "port {port}: the server's session has ports: {allowed}; leave the topic's port out, so that it shares the "
        "link's, or add it there"
    )
    TOO_MANY = (
        "{client}'s topics already have {limit} ports of their own: leave the topic's port out, so that it shares the "
        "link's, or list the ports that clients may have under ports in the server's session file"
    )
    OUT_OF_RANGE = (
        "{kind} {port}: topics may have {allowed}; give one of these, or leave the topic's port out, so that it shares "
        "the link's"
    )
    DISCOVERY = (
        "{kind} {port} is reserved for discovery in the server's ROS domain {domain} ({ports}): give another, or leave "
        "the topic's port out, so that it shares the link's"
    )
    DISCOVERY_OF_OTHER = (
        "{kind} {port} is reserved for discovery in ROS domain {domain}, which the server's machine may run, too: give "
        "another, or leave the topic's port out, so that it shares the link's"
    )
    TOO_MANY_DESCRIPTORS = (
        "{client}'s topics have used up their share of the server's {limit:,} file descriptors: {remedy} there, "
        "or leave out ports of topics"
    )


class TopicPorts:
    """The ports of one client's topics, across all its connections.

    A port counts from the request, and not only once it is bound: a client may ask for many at once.
    """

    def __init__(self, client: str) -> None:
        self._client = client
        self._users: dict[tuple[str, int], int] = {}

    def reserve(self, session: Session, transport: TransportTraits, port: int) -> Callable[[], None]:
        """Count a port or channel that the client asks for, and return a function that a topic calls to release it.

        Raises:
            ListenError: the client may not have it, or has too many; the message names a remedy.
        """
        key = (transport.name, port)
        if transport.ip_ports and session.ports is not None:
            listed = () if session.ports == "none" else session.ports
            if port not in listed:
                allowed = join_first([str(each) for each in listed], _NAMED) or "none"
                raise ListenError(PortDenied.NOT_LISTED(port=port, allowed=allowed))
            return lambda: None  # the list itself limits their number
        if key not in self._users and len(self._users) >= PORTS_PER_CLIENT:
            raise ListenError(PortDenied.TOO_MANY(client=self._client, limit=PORTS_PER_CLIENT))
        self._users[key] = self._users.get(key, 0) + 1

        def release() -> None:
            self._users[key] -= 1
            if not self._users[key]:
                del self._users[key]

        return release


def check_topic_port(domain: int, transport: TransportTraits, port: int) -> None:
    """Check that topics may have this port or channel; `domain` is this side's.

    Raises:
        ListenError: no topic may; the message names a remedy.
    """
    kind = transport.port_kind
    if port not in transport.topic_ports:
        raise ListenError(PortDenied.OUT_OF_RANGE(kind=kind, port=port, allowed=transport.topic_ports))
    if transport.ip_ports and port in dds_ports(domain):
        raise ListenError(PortDenied.DISCOVERY(kind=kind, port=port, domain=domain, ports=dds_ports(domain)))
    if transport.ip_ports and (other := discovery_domain(port)) is not None:
        raise ListenError(PortDenied.DISCOVERY_OF_OTHER(kind=kind, port=port, domain=other))


class DescriptorShare:
    """The descriptors that streams and ports of one client's topics hold on the server.

    They are at most as many as remain free for all others. So one client alone may take half of all descriptors, and
    clients that take as many as they can never keep the next one out. The rule fits any limit of the process.
    """

    def __init__(self, client: str, clients: Sized) -> None:
        self.held = 0
        self._client = client
        self._clients = clients

    @property
    def room(self) -> int:
        """Number of descriptors that it may still take."""
        left = descriptors.left()  # with other clients, it may take one more while more are left than it holds
        return left if len(self._clients) == 1 else (left - self.held + 1) // 2

    @property
    def refusal(self) -> str:
        """The reason why it may take no more, for the operators of both sides, or an empty string."""
        if descriptors.scarce():
            return descriptors.scarcity_message("server")
        if self.room > 0:
            return ""
        limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        return PortDenied.TOO_MANY_DESCRIPTORS(client=self._client, limit=limit, remedy=descriptors.MORE_DESCRIPTORS)

    def take(self) -> Callable[[], None]:
        """Count one more, and return a function to call once when it is closed."""
        self.held += 1
        return self._give

    def _give(self) -> None:
        self.held -= 1

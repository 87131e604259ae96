"""Which ports of its own a client's topic may have a server bind."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.limits import PORTS_PER_CLIENT, dds_ports, discovery_domain
from rsb_bridge.model.text import join_first
from rsb_bridge.transport.transport import ListenError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.session import Session
    from rsb_bridge.model.transports import TransportTraits

_NAMED = 12
SHARE = "leave the topic's port out, so that it shares the link's"


class TopicPorts:
    """The ports that one client's topics have here, whichever of its links opened them.

    A port counts from when it is asked for, and not only once it is bound: a client may ask for many at once.
    """

    def __init__(self, client: str) -> None:
        self._client = client
        self._users: dict[tuple[str, int], int] = {}

    def reserve(self, session: Session, transport: TransportTraits, port: int) -> Callable[[], None]:
        """Count a port that the client asks for.

        Args:
            session: the server's.
            transport: of the topic.
            port: its number, or channel.

        Returns:
            What to call once when the topic has it no longer.

        Raises:
            ListenError: the client may not have it, or has too many; the message says what would do.
        """
        key = (transport.name, port)
        if transport.ip_ports and session.ports is not None:
            listed = () if session.ports == "none" else session.ports
            if port not in listed:
                allowed = join_first([str(each) for each in listed], _NAMED) or "none"
                raise ListenError(f"port {port}: the server's session has ports: {allowed}; {SHARE}, or add it there")
            return _nothing  # the list is the limit
        if key not in self._users and len(self._users) >= PORTS_PER_CLIENT:
            raise ListenError(
                f"{self._client}'s topics already have {PORTS_PER_CLIENT} ports of their own: {SHARE}, or list the "
                "ports that clients may have under ports in the server's session file"
            )
        self._users[key] = self._users.get(key, 0) + 1
        return lambda: self._release(key)

    def _release(self, key: tuple[str, int]) -> None:
        self._users[key] -= 1
        if not self._users[key]:
            del self._users[key]


def _nothing() -> None:
    """A listed port is not counted."""


def check_topic_port(domain: int, transport: TransportTraits, port: int) -> None:
    """Check that topics may have a port of their own here, whoever asks.

    Args:
        domain: the ROS domain that this side has joined.
        transport: of the topic.
        port: its number, or channel.

    Raises:
        ListenError: none may; the message says what would do.
    """
    kind = transport.port_kind
    if port not in transport.topic_ports:
        raise ListenError(f"{kind} {port}: topics may have {transport.topic_ports}; give one of these, or {SHARE}")
    if transport.ip_ports and port in dds_ports(domain):
        raise ListenError(
            f"{kind} {port} is reserved for discovery in the server's ROS domain {domain} ({dds_ports(domain)}): "
            f"give another, or {SHARE}"
        )
    if transport.ip_ports and (other := discovery_domain(port)) is not None:
        raise ListenError(
            f"{kind} {port} is reserved for discovery in ROS domain {other}, which the server's machine may run, too: "
            f"give another, or {SHARE}"
        )

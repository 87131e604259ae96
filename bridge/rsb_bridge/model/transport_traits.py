"""The facts of a transport: what session files, the wire, rules, rights, forms, benchmarks and the command line read.

`rsb_bridge.transport` has the sockets. A session is checked without loading a socket or an event loop.
"""

from __future__ import annotations

import re
from typing import Any, ClassVar, Literal, NamedTuple

from rsb_bridge.model.limits import CHANNEL, PORT, TOPIC_PORT, Range

Compression = Literal["none", "zstd"]

_MAC = re.compile(r"[0-9A-Fa-f]{2}(:[0-9A-Fa-f]{2}){5}")


def is_mac(address: str) -> bool:
    """Whether an address is a Bluetooth MAC, six hexadecimal pairs with colons between."""
    return _MAC.fullmatch(address) is not None


class Ages(NamedTuple):
    """s that the oldest unacknowledged byte of a link may be older than the shortest round trip."""

    fresh: float  # the window of the link grows below it
    late: float  # the window shrinks above it, to the bytes that cross in `aim` and in a ping
    aim: float
    room: float  # the window grows to the bytes that cross in this where nothing waits, so that receipts are rare


QUEUES_LITTLE = Ages(0.2, 0.8, 0.5, 4.0)
"""For streams whose kernel takes little more than it can send. Measured on a Wi-Fi and a tunnel: docs/design.md, 5."""


class TransportTraits:
    """The facts of a transport. Its class in `rsb_bridge.transport` inherits them."""

    name: ClassVar[str]  # in session files (`Topic.protocol`) and on the wire (`Propose.transport`)
    short: ClassVar[str] = ""  # the name in narrow columns, in capitals, or empty if it is the name itself
    medium: ClassVar[str] = "IP"  # word for what it crosses
    chosen_by: ClassVar[str] = "server_ip is a host"  # the `server_ip` of links over it, for an operator
    port_kind: ClassVar[str] = "port"
    """Word for its numbers, for example ``port``; transports of the same kind share them."""
    ports: ClassVar[Range] = PORT  # range of valid numbers
    topic_ports: ClassVar[Range] = TOPIC_PORT  # range of the numbers that a topic may choose
    ip_ports: ClassVar[bool] = True
    """Whether the numbers are the machine's TCP or UDP ports, which other programs use, too."""
    slow: ClassVar[bool] = False
    """Whether it carries only some 50 kB/s, so that best-effort messages should not queue for seconds."""
    compression: ClassVar[Compression] = "none"  # compression of topics that choose none
    several_ways: ClassVar[bool] = False  # whether several ways of a machine may carry one stream (`Session.multipath`)
    multiplexed: ClassVar[bool] = False
    """Whether the routes of a link share one stream per number, including the control connection's. Otherwise they
    share two per number, for small and for large messages."""
    companions: ClassVar[tuple[str, ...]] = ()
    """Names of the transports that a server of such links binds to the same number for their routes."""
    reliable: ClassVar[bool] = True  # whether every sent message arrives unless the carrier breaks and reports it
    best_effort: ClassVar[str] = ""
    """Name of the companion for topics with best-effort QoS that choose no transport, or an empty string if they use
    this transport."""
    ages: ClassVar[Ages] = QUEUES_LITTLE  # that its window allows
    delivery: ClassVar[str] = "delivers all, in order"  # what it does with messages, behind its name, for an operator
    local: ClassVar[bool] = True
    """Whether its addresses are this machine's own, so that a server that can't bind one cannot start."""

    @staticmethod
    def carries_links_to(host: str) -> bool:
        """Whether a session with that `server_ip` runs over this transport."""
        return False

    @classmethod
    def place(cls, session: Any) -> str:
        """Return where the link of a session goes, for an operator: ``to 10.0.0.1 port 49152``.

        Args:
            session: a `rsb_bridge.model.session.Session` over this transport.
        """
        way = "at" if session.role == "server" else "to"
        return f"{way} {', else '.join(session.hosts)} {cls.port_kind.rpartition(' ')[2]} {session.server_port}"

    @classmethod
    def missing(cls) -> str:
        """Return what this Python lacks for it, with the remedy, or an empty string."""
        return ""


class RfcommTraits(TransportTraits):
    """Bluetooth RFCOMM. Two adapters have one connection on a channel, so the routes of a channel share it."""

    name = "bluetooth"
    medium = "Bluetooth"
    chosen_by = "server_ip is a MAC"
    port_kind = "RFCOMM channel"
    ports = topic_ports = CHANNEL
    ip_ports = False
    slow = True
    compression = "zstd"
    multiplexed = True
    delivery = "uses the radio, on a channel of its own"

    @staticmethod
    def carries_links_to(host: str) -> bool:
        return is_mac(host)


class TcpTraits(TransportTraits):
    """TCP over IPv4 and IPv6, for each address that no other transport takes."""

    name = "tcp"
    companions = ("udp",)
    several_ways = True

    @staticmethod
    def carries_links_to(host: str) -> bool:
        return True


class UdpTraits(TransportTraits):
    """UDP over IPv4 and IPv6."""

    name = "udp"
    reliable = False
    delivery = "never waits for lost messages"

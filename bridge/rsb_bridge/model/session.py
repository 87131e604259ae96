"""A session: what one bridge process is told to do.

In `rsb_bridge.config`, `decoding` makes it of plain data, `validation` finds its mistakes, and `session_file` reads and
writes its file.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal

import msgspec

from rsb_bridge.model.qos import Qos, parse_qos

Direction = Literal["transmit", "receive"]
Protocol = Literal["tcp", "udp", "bluetooth"]
Compression = Literal["none", "zstd"]
Role = Literal["client", "server"]

_MAC = re.compile(r"[0-9A-Fa-f]{2}(:[0-9A-Fa-f]{2}){5}")


def is_mac(address: str) -> bool:
    """Whether an address is a Bluetooth MAC, six hexadecimal pairs with colons between."""
    return _MAC.fullmatch(address) is not None


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake in a session.

    Attributes:
        location: where it is: ``topics[2].protocol``; empty is the session as a whole.
        message: what is wrong, and what would be right.
        line: of the session file, from 1; None where there is no file.
        place: the location for a person: ``topic /scan, protocol``; empty: as `location`.
    """

    location: str
    message: str
    line: int | None = None
    place: str = ""

    def __str__(self) -> str:
        place = self.place or self.location
        return f"{place}: {self.message}" if place else self.message


class Topic(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One bridged topic, as the *client* sees it (thesis, chapter 3).

    Attributes:
        topic: its name on the client, absolute (``/scan``).
        direction: ``transmit`` goes from client to server, ``receive`` the other way.
        type: ``pkg/msg/Name``, a short thesis name (``LaserScan``), or ``auto``: from either side's graph.
        protocol: what carries it; None: tcp on an IP link, bluetooth on an RFCOMM link.
        port: a TCP or UDP port or an RFCOMM channel of its own (topics may share a channel); None: the link's.
        qos: ``auto``, a profile's name, a depth, or a mapping of `rsb_bridge.model.qos.Qos` fields.
        remote_topic: its name on the server; None: the same, after the prefix if `use_name` is set.
        compression: None: zstd on Bluetooth, none elsewhere.
        max_rate: Hz; None: no limit.
        expected_rate: Hz, shown beside the real rate; None: learned.
        stale_after: s without a message until a warning; None: the session's; 0: never.
        paused: the topic is set up, and carries nothing until it is resumed.
    """

    topic: str
    direction: Direction
    type: str = "auto"
    protocol: Protocol | None = None
    port: int | None = None
    qos: str | int | dict[str, Any] = "auto"
    remote_topic: str | None = None
    compression: Compression | None = None
    max_rate: float | None = None
    expected_rate: float | None = None
    stale_after: float | None = None
    paused: bool = False

    def parsed_qos(self) -> Qos | None:
        """The QoS; None is ``auto``."""
        return parse_qos(self.qos)


class Client(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A client that a server lets in.

    Attributes:
        name: as in the client's session.
        key_file: its key; None: the server's `Session.key_file`.
        use_name: prefix its topics on the server; None: the server's `Session.use_name`.
        allow: patterns (shell globs) of the topics that it may bridge; empty: all.
        deny: patterns of the topics that it may not bridge; stronger than `allow`.
        topics: what the server proposes to it whenever it links, as the client sees them.
    """

    name: str
    key_file: str | None = None
    use_name: bool | None = None
    allow: tuple[str, ...] = ()
    deny: tuple[str, ...] = ()
    topics: tuple[Topic, ...] = ()


class Session(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """What one bridge process does.

    Attributes:
        name: must match on both sides; the prefix (``/scan`` -> ``/robot1/scan``) when `use_name` is set.
        role: a client connects, a server binds.
        server_ip: IPv4 or IPv6 address, host name, or Bluetooth MAC, which makes the link RFCOMM. A server binds it.
        server_port: TCP and UDP port, or RFCOMM channel.
        bluetooth_address: MAC of the server's adapter, for single topics over Bluetooth beside an IP link. Each names
            a channel as its port; those that name the same share it.
        domain_id: ROS domain; None: ``$ROS_DOMAIN_ID``, else 0.
        use_name: the client's topics have its name before them on the server, in both directions.
        use_encryption: False sends everything in the clear.
        key_file: path, relative to the session file.
        stale_after: s without a message until a topic is stale (thesis: 15); 0: never.
        stale_warnings: how many times to warn of it (thesis: 5).
        shutdown_topic: "shutdown" as ``std_msgs/String`` on it closes the sockets on both sides; None: no such topic.
        topics: a client's topics.
        clients: those that a server lets in; empty: one, with the session's own name and key.
    """

    name: str
    role: Role
    server_ip: str
    server_port: int
    bluetooth_address: str | None = None
    domain_id: int | None = None
    use_name: bool = False
    use_encryption: bool = True
    key_file: str | None = None
    stale_after: float = 15.0
    stale_warnings: int = 5
    shutdown_topic: str | None = "/shutdown"
    topics: tuple[Topic, ...] = ()
    clients: tuple[Client, ...] = ()

    @property
    def is_bluetooth(self) -> bool:
        """Whether the link is RFCOMM."""
        return is_mac(self.server_ip)

    @property
    def accepted_clients(self) -> tuple[Client, ...]:
        """The clients that a server lets in."""
        return self.clients or (Client(self.name),)

    @property
    def adapter(self) -> str | None:
        """MAC of the server's Bluetooth adapter; None: the session does not use one."""
        return self.server_ip if self.is_bluetooth else self.bluetooth_address

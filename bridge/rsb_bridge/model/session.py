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
    """

    location: str
    message: str
    line: int | None = None

    def __str__(self) -> str:
        return f"{self.location}: {self.message}" if self.location else self.message


class Topic(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One bridged topic, as the *client* sees it (thesis chapter 3: topic name, type, direction, protocol, port, QoS).

    Attributes:
        topic: its name on the client, absolute (``/scan``).
        direction: ``transmit`` goes from client to server, ``receive`` the other way.
        type: ``pkg/msg/Name``, a short thesis name (``LaserScan``), or ``auto``: from either side's graph.
        protocol: what carries it; None is the link's own (udp on IP links is never picked: tcp, or bluetooth).
        port: a socket of its own (TCP or UDP port, RFCOMM channel; topics may share a channel); None: the server's.
        qos: ``auto``, a profile's name, a depth, or a mapping of `rsb_bridge.model.qos.Qos` fields.
        remote_topic: its name on the server; None: the same, with the client's name before it where `use_name` is set.
        compression: None is the link's default (zstd on Bluetooth, none elsewhere).
        max_rate: Hz; None is all.
        expected_rate: Hz, what an operator should see; None is learned.
        stale_after: s; None is the session's; 0 never warns.
        paused: it is set up but carries nothing until resumed.
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
        """The QoS asked for; None is ``auto``."""
        return parse_qos(self.qos)


class Client(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A client that a server lets in.

    Attributes:
        name: as its own session says.
        key_file: its key; None is the server's own `Session.key_file`.
        use_name: prefix its topics on this side; None is the server's own `Session.use_name`.
        allow: topic patterns (shell globs) it may bridge; empty is all.
        deny: topic patterns it may not; stronger than `allow`.
    """

    name: str
    key_file: str | None = None
    use_name: bool | None = None
    allow: tuple[str, ...] = ()
    deny: tuple[str, ...] = ()


class Session(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """What one bridge process does.

    Attributes:
        name: must match on both sides; the prefix (``/scan`` -> ``/robot1/scan``) when `use_name` is set.
        role: a client connects, a server binds.
        server_ip: IPv4, IPv6, host name, or a Bluetooth MAC: then the link is RFCOMM. On a server, what to bind.
        server_port: TCP and UDP port, or RFCOMM channel 1-30.
        bluetooth_address: MAC of the server's adapter, where the link is IP and some topics are to go over Bluetooth:
            each of those names a channel as its port, and those that name the same share it.
        domain_id: ROS domain; None is ``$ROS_DOMAIN_ID``, else 0.
        use_name: prefix the topics a client sends, on the server; and so those it asks for are looked up there.
        use_encryption: off only for experiments: everything crosses in the clear.
        key_file: path, relative to the session file.
        stale_after: s without a message until a topic is stale (thesis: 15).
        stale_warnings: how often that is said (thesis: 5).
        shutdown_topic: ``std_msgs/String`` "shutdown" on it closes both sides' sockets; None is no such topic.
        topics: a client's topics.
        clients: those a server lets in; empty: one, of the session's own name and key.
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
    def adapter(self) -> str | None:
        """MAC of the server's Bluetooth adapter; None: it has none to do with this session."""
        return self.server_ip if self.is_bluetooth else self.bluetooth_address

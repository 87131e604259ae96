"""The name and the facts of each transport, and the settings of links by the kind of their network.

`rsb_bridge.transport` has the sockets. Session files, the wire, rules, rights, forms, benchmarks and the command line
read these facts, so that a session is checked without loading a socket or an event loop.
"""

from __future__ import annotations

import re
from typing import ClassVar, Final, Literal, NamedTuple

from rsb_bridge.model.limits import CHANNEL, NO_PORT, PORT, TOPIC_PORT, Range

Protocol = Literal["tcp", "udp", "bluetooth", "zenoh", "zenoh-drop"]
"""The names of the classes below."""
Compression = Literal["none", "zstd"]

ZENOH_HOST = "zenoh"
"""The `rsb_bridge.model.session.Session.server_ip` of a link over Zenoh."""

_MAC = re.compile(r"[0-9A-Fa-f]{2}(:[0-9A-Fa-f]{2}){5}")


def is_mac(address: str) -> bool:
    """Whether an address is a Bluetooth MAC, six hexadecimal pairs with colons between."""
    return _MAC.fullmatch(address) is not None


class Ages(NamedTuple):
    """s that the oldest unacknowledged byte of a link may be older than the shortest round trip.

    Attributes:
        fresh: the window of the link grows below it,
        late: and shrinks above it,
        aim: to the bytes that cross in this and in a ping.
        room: the window grows to the bytes that cross in this where nothing waits, so that receipts are rare.
    """

    fresh: float
    late: float
    aim: float
    room: float


QUEUES_LITTLE = Ages(0.2, 0.8, 0.5, 4.0)
"""For streams whose kernel takes little more than it can send. Measured on a Wi-Fi and a tunnel: docs/design.md, 5."""


class TransportTraits:
    """The facts of a transport. Its class in `rsb_bridge.transport` inherits them.

    Attributes:
        name: in session files (`Topic.protocol`) and on the wire (`Propose.transport`).
        medium: word for what it crosses.
        chosen_by: the `server_ip` of links over it, for an operator.
        port_kind: word for its numbers, for example ``port``; transports of the same kind share them.
        ports: range of valid numbers.
        topic_ports: range of the numbers that a topic may choose.
        ip_ports: whether the numbers are the machine's TCP or UDP ports, which other programs use, too.
        slow: whether it carries only some 50 kB/s, so that best-effort messages should not queue for seconds.
        compression: compression of topics that choose none.
        multiplexed: whether the routes of a link share one stream per number, including the control connection's.
            Otherwise they share two per number, for small and for large messages.
        companions: names of the transports that a server of such links binds to the same number for their routes.
        reliable: whether every sent message arrives unless the carrier breaks and reports it.
        best_effort: name of the companion for topics with best-effort QoS that choose no transport, or an empty string
            if they use this transport.
        ages: that its window allows.
        delivery: what it does with messages, behind its name, for an operator.
        local: whether its addresses are this machine's own, so that a server that can't bind one cannot start.
    """

    name: ClassVar[Protocol]
    medium: ClassVar[str] = "IP"
    chosen_by: ClassVar[str] = "server_ip is a host"
    port_kind: ClassVar[str] = "port"
    ports: ClassVar[Range] = PORT
    topic_ports: ClassVar[Range] = TOPIC_PORT
    ip_ports: ClassVar[bool] = True
    slow: ClassVar[bool] = False
    compression: ClassVar[Compression] = "none"
    multiplexed: ClassVar[bool] = False
    companions: ClassVar[tuple[Protocol, ...]] = ()
    reliable: ClassVar[bool] = True
    best_effort: ClassVar[Protocol | Literal[""]] = ""
    ages: ClassVar[Ages] = QUEUES_LITTLE
    delivery: ClassVar[str] = "delivers all, in order"
    local: ClassVar[bool] = True

    @staticmethod
    def carries_links_to(host: str) -> bool:
        """Whether a session with that `server_ip` runs over this transport."""
        return False


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

    @staticmethod
    def carries_links_to(host: str) -> bool:
        return True


class UdpTraits(TransportTraits):
    """UDP over IPv4 and IPv6."""

    name = "udp"
    reliable = False
    delivery = "never waits for lost messages"


class ZenohTraits(TransportTraits):
    """Streams over a Zenoh network, each in samples that its routers hold back while it is congested."""

    name = "zenoh"
    medium = "Zenoh"
    chosen_by = "server_ip: zenoh"
    port_kind = "Zenoh port"
    ports = topic_ports = NO_PORT
    ip_ports = False
    companions = ("zenoh-drop",)
    best_effort = "zenoh-drop"
    # Zenoh takes all that the window allows, and puts it on one connection: small messages wait behind large ones, and
    # the more is in transit, the longer TCP waits before it tries again after a gap. With 0.3 s instead of 0.8, joint
    # states came after 0.15 s instead of 0.41 on a Wi-Fi (docs/design.md, 5).
    ages = Ages(0.1, 0.3, 0.15, 1.0)
    local = False

    @staticmethod
    def carries_links_to(host: str) -> bool:
        return host == ZENOH_HOST


class ZenohDropTraits(TransportTraits):
    """Single samples over a Zenoh network, which its routers drop while it is congested."""

    name = "zenoh-drop"
    medium, chosen_by = ZenohTraits.medium, ZenohTraits.chosen_by
    port_kind = "Zenoh port"
    ports = topic_ports = NO_PORT
    ip_ports = False
    reliable = False
    delivery = "never waits for lost messages, as fits best effort"
    local = False


HOW_TO_INSTALL_ZENOH = "the package eclipse-zenoh is not installed: pip install 'rsb-console[zenoh]'"

# TCP comes last: it takes any address
_BY_NAME: dict[str, type[TransportTraits]] = {
    traits.name: traits for traits in (RfcommTraits, ZenohTraits, ZenohDropTraits, UdpTraits, TcpTraits)
}  # fmt: skip


def named(name: str) -> type[TransportTraits]:
    return _BY_NAME[name]


def of_link(host: str) -> type[TransportTraits]:
    """Return the transport of a link whose session has that `server_ip`."""
    return next(traits for traits in _BY_NAME.values() if traits.carries_links_to(host))


ProfileName = Literal["lan", "wifi", "lte", "bluetooth"]


class LinkProfile(NamedTuple):
    """The settings of one profile.

    Attributes:
        compression: of topics, services and actions that name none, or None for the transport's.
        queue_bytes: of a best-effort topic that wait; one message always may. None for the transport's.
        max_rate: Hz of a best-effort topic that names none, or None for any rate.
        patience: s without a byte until the link is given up, and for which a reliable topic's messages are kept
            meanwhile, or None for 5.
    """

    compression: Compression | None = None
    queue_bytes: int | None = None
    max_rate: float | None = None
    patience: float | None = None


NO_PROFILE: Final = LinkProfile()
"""The settings of a link without a profile."""

PROFILES: Final[dict[ProfileName, LinkProfile]] = {
    "lan": NO_PROFILE,
    "wifi": LinkProfile(queue_bytes=1024 * 1024),
    "lte": LinkProfile("zstd", queue_bytes=256 * 1024, max_rate=10.0, patience=15.0),
    "bluetooth": LinkProfile("zstd", queue_bytes=64 * 1024, max_rate=5.0),
}
"""Settings of links by the kind of their network, for what session files leave out.

On a ``lan``, and without a profile, nothing else is set.

- ``wifi`` stalls for some tenths of a second, again and again. A best-effort message that has waited behind 1 MiB
  (0.2 s at 5 MB/s) is better replaced by a newer one.
- ``lte`` is slow upwards (some 500 kB/s), is paid for by the byte, and has gaps of up to some 10 s between cells. So
  messages are compressed, half a second of them waits (256 KiB), and sensors cross at 10 Hz. The link
  is given up after 15 s of silence instead of 5, so that a gap costs no new connection.
- ``bluetooth`` is what RFCOMM links are set to anyway (50 kB/s: zstd, and 64 KiB of best effort), and sensors cross at
  5 Hz, which leaves a message 10 kB.
"""


def profile_of(*names: ProfileName | None) -> LinkProfile:
    """Return the first profile that is given: a client's before its server's."""
    return next((PROFILES[name] for name in names if name is not None), NO_PROFILE)


def compression_of(own: Compression | None, profile: LinkProfile, transport: Compression) -> Compression:
    """Return a topic's own compression, or that of its link's profile or transport."""
    if own is not None:
        return own
    return "zstd" if "zstd" in (profile.compression, transport) else "none"


def profile_text(profile: LinkProfile) -> str:
    """Describe a profile in a line."""
    rate = f"{profile.max_rate:g} Hz" if profile.max_rate else "any rate"
    size = f", {profile.queue_bytes // 1024:,} KiB wait" if profile.queue_bytes else ""
    parts = [
        f"{profile.compression or 'no'} compression",
        f"best effort: {rate}{size}",
        f"given up after {profile.patience or 5:g} s of silence",
    ]
    return "; ".join(parts)

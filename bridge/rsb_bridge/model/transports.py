"""The transports by name, and the settings of links by the kind of their network."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Literal, NamedTuple, TypeAlias

from rsb_bridge.installed_features import added
from rsb_bridge.model.transport_traits import Compression, RfcommTraits, TcpTraits, TransportTraits, UdpTraits

_OF_FEATURES: tuple[type[TransportTraits], ...] = added(
    "transport_traits",
    name_of=lambda traits: traits.name,
    taken=[traits.name for traits in (RfcommTraits, UdpTraits, TcpTraits)],
)
# TCP comes last: it takes any address
_IN_ORDER: tuple[type[TransportTraits], ...] = (RfcommTraits, *_OF_FEATURES, UdpTraits, TcpTraits)
_BY_NAME = {traits.name: traits for traits in _IN_ORDER}

if TYPE_CHECKING:
    Protocol: TypeAlias = str
else:
    Protocol = Literal[("tcp", "udp", "bluetooth", *(traits.name for traits in _OF_FEATURES))]
    """The name of a transport."""


def named(name: str) -> type[TransportTraits]:
    return _BY_NAME[name]


def short_name(name: str) -> str:
    """Return a transport's name for narrow columns; a bridge elsewhere may have one that is not installed here."""
    return (_BY_NAME[name].short if name in _BY_NAME else "") or name.upper()


def of_link(host: str) -> type[TransportTraits]:
    """Return the transport of a link whose session has that `server_ip`."""
    return next(traits for traits in _BY_NAME.values() if traits.carries_links_to(host))


ProfileName = Literal["lan", "wifi", "lte", "bluetooth"]


class LinkProfile(NamedTuple):
    """The settings of one profile."""

    compression: Compression | None = None
    """Of topics, services and actions that name none, or None for the transport's."""
    queue_bytes: int | None = None  # of a best-effort topic that wait; one message always may. None for the transport's
    max_rate: float | None = None  # Hz of a best-effort topic that names none, or None for any rate
    patience: float | None = None
    """s without a byte until the link is given up, and for which a reliable topic's messages are kept meanwhile, or
    None for 5."""
    outlive: float = 60.0  # s that topics and calls wait for a link whose connection is lost
    lazy: bool = False  # whether images and point clouds are lazy whose entries leave that open


NO_PROFILE: Final = LinkProfile()
"""The settings of a link without a profile."""

PROFILES: Final[dict[ProfileName, LinkProfile]] = {
    "lan": NO_PROFILE,
    "wifi": LinkProfile(queue_bytes=1024 * 1024),
    "lte": LinkProfile("zstd", queue_bytes=256 * 1024, max_rate=10.0, patience=15.0, outlive=300.0, lazy=True),
    "bluetooth": LinkProfile("zstd", queue_bytes=64 * 1024, max_rate=5.0),
}
"""Settings of links by the kind of their network, for what session files leave out.

On a ``lan``, and without a profile, nothing else is set.

- ``wifi`` stalls for some tenths of a second, again and again. A best-effort message that has waited behind 1 MiB
  (0.2 s at 5 MB/s) is better replaced by a newer one.
- ``lte`` is slow upwards (some 500 kB/s), is paid for by the byte, and has gaps of up to some 10 s between cells. So
  messages are compressed, half a second of them waits (256 KiB), and sensors cross at 10 Hz. The link
  is given up after 15 s of silence instead of 5, so that a gap costs no new connection, and topics wait for 5 minutes
  instead of 1, as in a tunnel, a lift or an underground car park. Nobody pays for images and clouds that nobody hears.
- ``bluetooth`` is what RFCOMM links are set to anyway (50 kB/s: zstd, and 64 KiB of best effort), and sensors cross at
  5 Hz, which leaves a message 10 kB.
"""


def profile_of(*names: ProfileName | None) -> LinkProfile:
    """Return the first profile that is given: a client's before its server's."""
    return next((PROFILES[name] for name in names if name is not None), NO_PROFILE)


def outlive_of(own: float | None, profile: LinkProfile) -> float:
    """Return for how long (s) a link outlives its connection: a session's own `outlive`, or its profile's."""
    return profile.outlive if own is None else own


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
        f"waited for {profile.outlive:g} s",
    ]
    if profile.lazy:
        parts.append("images and clouds rest while nobody subscribes")
    return "; ".join(parts)

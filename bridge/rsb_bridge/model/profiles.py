"""Settings of links by the kind of their network, for what session files leave out.

One table: `PROFILES`. Without a profile, and on a ``lan``, a link is as it always was. The other figures follow.

- ``wifi`` stalls for some tenths of a second, again and again. A best-effort message that has waited behind 1 MiB
  (0.2 s at 5 MB/s) is better replaced by a newer one.
- ``lte`` is slow upwards (some 500 kB/s), is paid for by the byte, and has gaps of up to some 10 s between cells. So
  messages are compressed, half a second of them waits (256 KiB), and sensors cross at 10 Hz. The link
  is given up after 15 s of silence instead of 5, so that a gap costs no new connection.
- ``bluetooth`` is what RFCOMM links are set to anyway (50 kB/s: zstd, and 64 KiB of best effort), and sensors cross at
  5 Hz, which leaves a message 10 kB.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

ProfileName = Literal["lan", "wifi", "lte", "bluetooth"]
Compression = Literal["none", "zstd"]


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


PLAIN: Final = LinkProfile()
"""The settings of a link without a profile."""

PROFILES: Final[dict[ProfileName, LinkProfile]] = {
    "lan": PLAIN,
    "wifi": LinkProfile(queue_bytes=1024 * 1024),
    "lte": LinkProfile("zstd", queue_bytes=256 * 1024, max_rate=10.0, patience=15.0),
    "bluetooth": LinkProfile("zstd", queue_bytes=64 * 1024, max_rate=5.0),
}


def profile_of(*names: ProfileName | None) -> LinkProfile:
    """Return the first profile that is given: a client's before its server's."""
    return next((PROFILES[name] for name in names if name is not None), PLAIN)


def compression_of(own: Compression | None, profile: LinkProfile, transport: Compression) -> Compression:
    """Return a topic's own compression, or that of its link's profile or transport."""
    if own is not None:
        return own
    return "zstd" if "zstd" in (profile.compression, transport) else "none"


def described(profile: LinkProfile) -> str:
    """Describe a profile in a line."""
    rate = f"{profile.max_rate:g} Hz" if profile.max_rate else "any rate"
    size = f", {profile.queue_bytes // 1024:,} KiB wait" if profile.queue_bytes else ""
    parts = [
        f"{profile.compression or 'no'} compression",
        f"best effort: {rate}{size}",
        f"given up after {profile.patience or 5:g} s of silence",
    ]
    return "; ".join(parts)

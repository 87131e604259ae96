"""The rates of a full link."""

from __future__ import annotations

from enum import StrEnum

import msgspec

from rsb_bridge.model.text import join_first
from rsb_bridge.model.wording import Wording


class CapacitySource(StrEnum):
    """How a capacity is known, the best first."""

    BENCH = "bench"
    """A bench over this link has measured it."""
    FULL = "full"
    """So much crossed while more waited to be sent."""
    SEEN = "seen"
    """So much has crossed; it may carry more."""


class Capacity(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """What a link carries in one direction.

    Attributes:
        bytes_per_second: on the wire.
        source: a `CapacitySource`.
        at: s since the epoch, when that was.
    """

    bytes_per_second: float
    source: str
    at: float

    def age(self, now: float) -> float:
        """S since it was measured, at `now` (s since the epoch)."""
        return max(0.0, now - self.at)


LASTS = 600.0
"""s after which what was measured gives way to what is seen: a robot moves, and its network with it."""


def newer(known: Capacity | None, found: Capacity) -> Capacity:
    """Which of two counts: what a bench or a full link says, while it is recent; of what was only seen, the highest."""
    if known is None or found.source != CapacitySource.SEEN:
        return found
    recent = found.at - known.at < LASTS
    return known if recent and known.bytes_per_second >= found.bytes_per_second else found


_NAMED = 2


class LinkFull(Wording):
    """Texts about a direction of a link that is full."""

    SHARE = "carries {rates}"
    WARNING = "link full {way}: {share}; set max_rate, compression: zstd or priority"
    WARNING_WITH_TOPICS = "link full {way}: {share} (most: {topics}); set max_rate, compression: zstd or priority"


class Fullness(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One direction of a link that is full.

    Attributes:
        carried: bytes/s that arrive.
        asked: bytes/s that its topics ask for.
        topics: names on this side of the topics that ask for the most, the greatest first.
    """

    carried: float
    asked: float
    topics: tuple[str, ...] = ()

    @property
    def share(self) -> str:
        """Text such as ``carries 25 of 48 kB/s``."""
        return LinkFull.SHARE(rates=rates_text(self.carried, self.asked))

    def warning(self, way: str) -> str:
        """Return the warning for an operator.

        Args:
            way: ``to`` or ``from`` and the peer.
        """
        text = LinkFull.WARNING_WITH_TOPICS if self.topics else LinkFull.WARNING
        return text(way=way, share=self.share, topics=join_first(self.topics, _NAMED))


def rates_text(part: float, whole: float) -> str:
    """Format two rates: ``1.1 of 3.0 MB/s``, ``25 of 48 kB/s``."""
    for unit, name in ((1e6, "MB/s"), (1e3, "kB/s")):
        if whole >= unit:
            return f"{_less_text(part / unit, whole / unit, 1 if whole < 9.95 * unit else 0)} {name}"
    return f"{_less_text(part, whole, 0)} B/s"


def _less_text(part: float, whole: float, digits: int) -> str:
    """Format two figures. If `part` is less, its text is too."""
    texts = f"{part:.{digits}f}", f"{whole:.{digits}f}"
    if part < whole and texts[0] == texts[1]:
        return f"{max(0.0, float(texts[1]) - 10.0**-digits):.{digits}f} of {texts[1]}"
    return " of ".join(texts)

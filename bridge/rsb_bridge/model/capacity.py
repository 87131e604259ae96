"""Traffic of a link, and the rates of a full one."""

from __future__ import annotations

from enum import StrEnum

import msgspec

from rsb_bridge.model.text import join_first
from rsb_bridge.model.wording import Wording


class CapacitySource(StrEnum):
    """Source of a capacity, the most reliable first."""

    FULL = "full"
    """The rate that crossed while more messages waited to be sent."""
    SEEN = "seen"
    """The highest rate that crossed; the link may carry more."""


class Capacity(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """The rate that a link can carry in one direction."""

    bytes_per_second: float  # rate on the wire
    source: str  # a `CapacitySource`
    at: float  # time of the measurement, s since the epoch

    def age(self, now: float) -> float:
        return max(0.0, now - self.at)


LASTS = 600.0
"""Seconds after which a seen rate replaces a measured one: a robot moves, and its network changes. Not measured."""


def newer(known: Capacity | None, found: Capacity) -> Capacity:
    """Choose between two capacities: a recent one of a full link, otherwise the highest rate seen."""
    if known is None or found.source != CapacitySource.SEEN:
        return found
    # After the clock was set back, the known one is from the future.
    recent = abs(found.at - known.at) < LASTS
    return known if recent and known.bytes_per_second >= found.bytes_per_second else found


_NAMED = 2


class LinkFull(Wording):
    WARNING = "link full {direction}: {share}; set max_rate, compression: zstd or priority"
    WARNING_WITH_TOPICS = "link full {direction}: {share} (most: {topics}); set max_rate, compression: zstd or priority"


class Fullness(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One full direction of a link."""

    carried: float  # bytes/s that arrive
    asked: float  # bytes/s that its topics want to send
    topics: tuple[str, ...] = ()  # names on this side of the topics that want the most, largest first

    @property
    def share(self) -> str:
        """Share that crosses: ``carries 25 of 48 kB/s``."""
        return f"carries {rates_text(self.carried, self.asked)}"

    def warning(self, direction: str) -> str:
        """Return the warning for an operator.

        Args:
            direction: ``to`` or ``from`` and the peer.
        """
        text = LinkFull.WARNING_WITH_TOPICS if self.topics else LinkFull.WARNING
        return text(direction=direction, share=self.share, topics=join_first(self.topics, _NAMED))


def rates_text(part: float, whole: float) -> str:
    """Format two rates: ``1.1 of 3.0 MB/s``, ``25 of 48 kB/s``."""
    for unit, name in ((1e6, "MB/s"), (1e3, "kB/s")):
        if whole >= unit:
            return f"{_less_text(part / unit, whole / unit, 1 if whole < 9.95 * unit else 0)} {name}"
    return f"{_less_text(part, whole, 0)} B/s"


def _less_text(part: float, whole: float, digits: int) -> str:
    """Format two figures. If `part` is less, its text is too."""
    texts = f"{part:.{digits}f}", f"{whole:.{digits}f}"
    if part > 0 and not float(texts[0]):
        return f"{part:.1g} of {texts[1]}"  # a little is not nothing
    if part < whole and texts[0] == texts[1]:
        return f"{max(0.0, float(texts[1]) - 10.0**-digits):.{digits}f} of {texts[1]}"
    return " of ".join(texts)

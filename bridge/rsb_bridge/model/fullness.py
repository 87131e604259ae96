"""What a link carries that is asked for more than that."""

from __future__ import annotations

import msgspec

from rsb_bridge.model.text import join_first

_NAMED = 2


class Fullness(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One direction of a link that is full.

    Attributes:
        carried: bytes/s that arrive.
        asked: bytes/s that its topics want.
        topics: those that want the most, the first one most of all; their names on this side.
    """

    carried: float
    asked: float
    topics: tuple[str, ...] = ()

    @property
    def share(self) -> str:
        """``carries 25 of 48 kB/s``."""
        return f"carries {rates_text(self.carried, self.asked)}"

    def warning(self, way: str) -> str:
        """What an operator is told.

        Args:
            way: ``to`` or ``from`` whom.
        """
        most = f" (most: {join_first(self.topics, _NAMED)})" if self.topics else ""
        return f"link full {way}: {self.share}{most}; set max_rate, compression: zstd or priority"


def rates_text(part: float, whole: float) -> str:
    """``1.1 of 3.0 MB/s``, ``25 of 48 kB/s``."""
    for unit, name in ((1e6, "MB/s"), (1e3, "kB/s")):
        if whole >= unit:
            digits = 1 if whole < 9.95 * unit else 0
            return f"{part / unit:.{digits}f} of {whole / unit:.{digits}f} {name}"
    return f"{part:.0f} of {whole:.0f} B/s"

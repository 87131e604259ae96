"""The promise of a topic to keep messages, beyond its QoS, for a link that is away or carries too little (`keep`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import msgspec

from rsb_bridge.model.limits import OUTLIVE, Range

if TYPE_CHECKING:
    from collections.abc import Iterator

KEEP_BUDGET = 32 << 20
"""Bytes of kept messages that all topics of one link share, besides those with a size of their own. A round figure: at
a minute, 500 kB/s."""
_RANGES: Final = {"seconds": (Range(1, OUTLIVE.high), "s"), "megabytes": (Range(0.1, 1024), "MB")}
"""No link is away for longer than it may outlive its connection; a topic of 1 GB is a round figure."""


class Keep(msgspec.Struct, frozen=True, omit_defaults=True):
    """All messages of the last seconds, at most so many megabytes; of older ones what the QoS keeps."""

    seconds: float
    megabytes: float | None = None  # of its own, or None for a part of `KEEP_BUDGET`

    def __str__(self) -> str:
        return f"{self.seconds:g} s" if self.megabytes is None else f"{self.seconds:g} s, {self.megabytes:g} MB"

    @property
    def own_bytes(self) -> int | None:
        return None if self.megabytes is None else int(self.megabytes * 1e6)

    @property
    def out_of_range(self) -> Iterator[tuple[str, float, Range, str]]:
        """The numbers that may not be: name, value, the range where it should be, and its unit."""
        for name, (allowed, unit) in _RANGES.items():
            value = getattr(self, name)
            if value is not None and value not in allowed:
                yield name, value, allowed, unit

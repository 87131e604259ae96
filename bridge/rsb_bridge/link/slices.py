"""Long lists that a peer sends, worked off in slices: all other links have their turn between two of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias, TypeVar

import msgspec

from rsb_bridge.wire.codec import invalid

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable

_E = TypeVar("_E")

ENTRIES = 64
"""Entries of one slice: to decode an entry of a report and to judge its route takes about 20 microseconds."""
BYTES = 8 << 10
"""Bytes of one slice, or one entry: 8 KiB of short texts take about 4 ms to decode."""


Slices: TypeAlias = "Generator[int, None, int]"
"""Work in slices: yields how many entries a slice had, and returns how many the last one had."""


def in_slices(entries: Iterable[tuple[_E, int]], work: Callable[[_E], None]) -> Slices:
    """Work off entries, each given with its bytes.

    Raises:
        ProtocolError: an entry is invalid.
    """
    count = size = 0
    try:
        for entry, length in entries:
            if count >= ENTRIES or size >= BYTES:
                yield count
                count = size = 0
            work(entry)
            count += 1
            size += length
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise invalid(error) from None
    return count

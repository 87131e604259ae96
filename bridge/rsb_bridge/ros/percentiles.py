"""The percentiles that latencies are told by."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection


def percentiles(values: Collection[int]) -> tuple[int, int, int]:
    """The 50th, 99th and 99.9th percentile: of so many values the next one above; 0 where there are none."""
    ordered = sorted(values)
    if not ordered:
        return 0, 0, 0
    last = len(ordered) - 1
    return (
        ordered[len(ordered) // 2],
        ordered[min(last, len(ordered) * 99 // 100)],
        ordered[min(last, len(ordered) * 999 // 1000)],
    )

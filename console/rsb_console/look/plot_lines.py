"""Numbers over time as rows of a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.model.pictures import Series


def plot_rows(series: Series, width: int, height: int, *, cursor: int | None = None) -> list[list[tuple[str, str]]]:
    """Return the rows of a plot."""
    raise NotImplementedError

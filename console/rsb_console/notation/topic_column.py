"""Columns of the topics that features add."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from rsb_bridge.installed_features import added

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.snapshot import RouteSnapshot


@dataclass(frozen=True, slots=True)
class TopicColumn:
    """A column of the topics' table.

    Attributes:
        title: its heading, at most as long as the column is wide.
        shows: its meaning, for the choice of columns.
        width: cells.
        text: formats the cell of a route.
        from_width: cells; a narrower table leaves the column out.
    """

    title: str
    shows: str
    width: int
    text: Callable[[RouteSnapshot], str]
    from_width: int = 120


SHOWN_BY_CORE: Final[dict[str, str]] = {
    "KIND": "msg, srv, act or par",
    "PEER": "the other side",
    "VIA": "direction and transport",
    "HZ/EXP": "rate and expected rate",
    "kB/s": "throughput",
    "TOTAL": "bytes in all",
    "ms": "time in transit",
    "NODE": "a node's time for a call",
    "AGE": "since the last message",
    "HISTORY": "rate in the last seconds",
    "LAST FAILURE": "of the calls",
}
"""The core's columns beside state and topic, and what they show."""
ADDED: Final[tuple[TopicColumn, ...]] = added(
    "columns", name_of=lambda column: column.title.strip(), taken=("STATE", "TOPIC", *SHOWN_BY_CORE)
)

"""Columns of the topics that features add."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.feature import installed

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


ADDED: tuple[TopicColumn, ...] = tuple(column for feature in installed() for column in feature.columns())

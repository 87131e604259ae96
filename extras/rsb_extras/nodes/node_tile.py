"""A tile with a robot's nodes, the faults first."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.feature_console import TileLines
from rsb_extras.nodes import node_rows
from rsb_extras.nodes.node_feed import NodeFeed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_console.feature_console import Console, Line


class NodeLines(TileLines):
    """The nodes of one robot, or of the first one that is linked."""

    name = "nodes"
    about = "of the other side, the faults first"

    def __init__(self, console: Console, link: str) -> None:
        super().__init__(console, link)
        self._feed = NodeFeed(console, link or next((each.name for each in console.snapshot().links), None))

    async def renew(self) -> None:
        await self._feed.renew()

    def lines(self, height: int) -> Sequence[Line]:
        now, book = self._feed.now, self._feed.book
        shared = node_rows.sharing(book.nodes.values())
        summary = [(line,) for line in self._feed.summary]
        worst = sorted(book.nodes.values(), key=lambda each: (node_rows.health(each, now), each.name))
        lines = [node_rows.node_line(each, each.name, now, book.processes, shared(each)) for each in worst[:height]]
        return [*summary, *lines][:height]

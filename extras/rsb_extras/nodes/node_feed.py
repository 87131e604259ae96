"""What a console knows of the nodes of one side, which grows by what has changed."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EngineError, Wording
from rsb_extras.nodes import node_rows
from rsb_extras.nodes.node_book import NodeBook
from rsb_extras.nodes.node_data import Nodes

if TYPE_CHECKING:
    from rsb_console.feature_console import Console


class NodeFeedText(Wording):
    NO_SESSION = "no session runs"
    ASKING = "asking {side}"
    THIS_SIDE = "this side"


class NodeFeed:
    """Asks an engine, which may run in another process, for the nodes of one side.

    Args:
        side: name of the link to it, or None for this side.

    Attributes:
        book: the nodes so far.
        now: the time (s) of the engine at its last answer.
        problem: the reason why that is not renewed, for an operator, or empty.
    """

    def __init__(self, console: Console, side: str | None) -> None:
        self.side = side
        self.book = NodeBook()
        self.now = 0
        self.problem = ""
        self._console = console
        self._at = (0, 0)
        self._told_at = 0.0

    async def renew(self) -> None:
        engine = self._console.engine
        if engine is None:
            self.problem = NodeFeedText.NO_SESSION()
            return
        try:
            changes = await asyncio.wrap_future(engine.do(Nodes(self.side, *self._at)))
        except EngineError as error:
            self.problem = str(error)
            return
        self._at, self.now, self.problem = (changes.book, changes.number), changes.now, changes.why_not
        self._told_at = time.monotonic() - changes.age
        self.book.take(changes, changes.now)

    @property
    def is_known(self) -> bool:
        """Whether that side has answered."""
        return self._at[0] > 0

    @property
    def age(self) -> float:
        """Seconds since their side has told of them, which the ages of all nodes lack."""
        return time.monotonic() - self._told_at

    @property
    def side_name(self) -> str:
        return NodeFeedText.THIS_SIDE() if self.side is None else self.side

    @property
    def summary(self) -> list[tuple[str, str]]:
        """How many nodes there are, and how well, or why that is not known: lines, each with its look."""
        if not self.is_known:
            return [(self.problem, "down") if self.problem else (NodeFeedText.ASKING(side=self.side_name), "dim")]
        counts = node_rows.counts(self.book.nodes.values(), self.now)
        lines = (self.problem, "down"), (node_rows.as_of(self.age), "waiting"), ("" if self.problem else counts, "")
        return [line for line in lines if line[0]]

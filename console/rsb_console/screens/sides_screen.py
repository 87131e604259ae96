"""A screen of what both sides of links have, which asks the engine for it again and again."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar

from textual import work
from textual.binding import Binding
from textual.screen import ModalScreen

from rsb_bridge.api import EngineError
from rsb_bridge.model.verdict import duration
from rsb_bridge.model.wording import Wording
from rsb_console.notation.side_answer import SideAnswer, SideText, side_of
from rsb_console.widgets.lines import FixedLines, wrapped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.model.commands import Command
    from rsb_console.console_api import Console
    from rsb_console.screens.main import MainScreen

S = TypeVar("S", bound=SideAnswer)

_WIDTH = 74  # cells, until the screen is laid out
_AGED = 3.0  # s that an answer takes on a good line, and more. A round figure
_MOST_LINKS = 8
"""Links of a server that are asked each time; with more, only that of the topic under the cursor. A round figure."""


class SidesText(Wording):
    ASKING = "asking both sides"
    NO_SESSION = "no session runs"


class SidesScreen(ModalScreen[None], Generic[S]):
    """What this side and the other sides of its links have, asked for each `EVERY` s. Subclasses show it.

    Args:
        link: whose other side is asked, or empty for all.
    """

    BINDINGS: ClassVar = [Binding("escape,q", "dismiss", show=False)]
    DEFAULT_CSS = """
    #side-problems { max-height: 30%; margin-bottom: 1; background: $surface; }
    """
    EVERY: ClassVar[float]

    def __init__(self, console: Console, link: str) -> None:
        super().__init__()
        self.console = console
        self.link = link
        self.problems = FixedLines(id="side-problems")
        self._problems: Sequence[tuple[str, str]] = ()  # of the answer that is shown, each with its look
        self._answered_at = 0.0

    def request(self) -> Command[tuple[S, ...]]:
        """Return what the engine is asked."""
        raise NotImplementedError

    def show(self, sides: Sequence[S]) -> None:
        """Show an answer."""
        raise NotImplementedError

    def on_mount(self) -> None:
        self._show_texts([(SidesText.ASKING(), "dim")])
        self.set_interval(self.EVERY, self.renew)
        self._fetching = self._fetch()

    def renew(self) -> None:
        """Ask again, unless an answer is still due, perhaps over a thin line: then say how old the shown one is."""
        if self._fetching.is_finished:
            self._fetching = self._fetch()
        elif self._answered_at and (age := time.monotonic() - self._answered_at) >= self.EVERY + _AGED:
            self._show_texts([(SideText.OLD(age=duration(age)), "waiting"), *self._problems])

    @work(group="sides")
    async def _fetch(self) -> None:
        engine = self.console.engine
        if engine is None:
            self._show_texts([(SidesText.NO_SESSION(), "down")])
            return
        try:
            sides = await asyncio.wrap_future(engine.do(self.request()))
        except EngineError as error:
            self._show_texts([(str(error), "down")])
        else:
            self.show(sides)

    def show_problems(self, sides: Sequence[S], none: str, *, is_empty: bool) -> None:
        """Show the problems of the sides, or `none` if there are none and nothing is listed."""
        role = self.console.snapshot().role
        texts = [(SideText.of(side_of(role, side.link), side.problem), "down") for side in sides if side.problem]
        if not texts and is_empty:
            texts = [(none, "dim")]
        self._problems = texts
        self._answered_at = time.monotonic()
        self._show_texts(texts)

    def _show_texts(self, texts: Sequence[tuple[str, str]]) -> None:
        width = self.problems.size.width or _WIDTH
        self.problems.put([line for text, look in texts for line in wrapped(text, width, look)])

    def warn(self, text: str) -> None:
        self.console.notify(text, severity="warning", markup=False, timeout=8)


def asked_link(screen: MainScreen) -> str:
    """Return the link that a `SidesScreen` is to ask: of a server of many, that of the topic under the cursor."""
    many, row = len(screen.console.snapshot().links) > _MOST_LINKS, screen.topics.selected
    return row.link if many and row is not None else ""

"""Every key, from the registry."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding
from textual.screen import ModalScreen

from rsb_console.actions import ACTIONS, Group
from rsb_console.widgets.lines import Line, LiveLines

if TYPE_CHECKING:
    from collections.abc import Iterator

    from textual.app import ComposeResult

    from rsb_console.app import ConsoleApp


class KeyList(LiveLines, can_focus=True):
    """The keys, chapter by chapter."""

    BINDINGS: ClassVar = [
        Binding("j", "scroll_down", show=False),
        Binding("k", "scroll_up", show=False),
        Binding("g", "scroll_home", show=False),
        Binding("G", "scroll_end", show=False),
    ]

    def __init__(self, lines: list[Line]) -> None:
        super().__init__(classes="dialog -wide")
        self.border_title = "Keys"
        self._lines = lines

    @property
    def line_count(self) -> int:
        """One a key, and the headings."""
        return len(self._lines)

    def line(self, index: int) -> Line:
        """One of them."""
        return self._lines[index]


class HelpScreen(ModalScreen[None]):
    """Every key; any of escape, q, ? and enter leaves."""

    app: ConsoleApp
    BINDINGS: ClassVar = [Binding("escape,q,question_mark,enter", "dismiss", show=False)]

    def compose(self) -> ComposeResult:
        """The list."""
        yield KeyList(list(self._lines()))

    def _lines(self) -> Iterator[Line]:
        shown = [action for action in ACTIONS if not (action.changes and self.app.readonly)]
        order = list(Group)
        for group, actions in groupby(sorted(shown, key=lambda a: order.index(a.group)), key=lambda a: a.group):
            yield ((group.value, "head"),)
            for action in actions:
                keys = "  ".join(self.app.key_labels(action))
                yield ((f"  {keys:<13}", "key"), (f"{action.help:<60}", ""), (action.id, "dim"))
            yield ()
        yield ((f"Other keys: {self.app.config / 'keys.yaml'}, one line each, like   pause: P", "dim"),)

"""A dialog that lists what matches a typed text, and chooses from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, TypeVar

from textual import on
from textual.binding import Binding
from textual.screen import ModalScreen
from textual.widgets import Input

from rsb_bridge.feature_api import escape_text
from rsb_console.feature_console import Dialog, RowFilter, Suggestion
from rsb_console.widgets.picker import SuggestionList

if TYPE_CHECKING:
    from collections.abc import Iterator

    from textual.app import ComposeResult

T = TypeVar("T")


class SearchScreen(ModalScreen[T]):
    """A search box over a list: typing narrows the list down, arrows move in it.

    Subclasses choose on enter and on a click: `Input.Submitted` and `SelectableList.Chosen`.
    """

    BINDINGS: ClassVar = [
        Binding("escape", "dismiss", show=False),
        Binding("up", "move(-1)", show=False),
        Binding("down", "move(1)", show=False),
        Binding("pageup", "page(-1)", show=False),
        Binding("pagedown", "page(1)", show=False),
    ]
    AUTO_FOCUS = "Input"

    def __init__(self, title: str, keys: str, search: Input) -> None:
        super().__init__()
        self.text, self.list = search, SuggestionList()
        self.dialog = Dialog(title, self.text, self.list, keys=keys, shape="-high")

    def compose(self) -> ComposeResult:
        yield self.dialog

    def suggestions(self) -> Iterator[Suggestion]:
        """Yield all that can be chosen."""
        raise NotImplementedError

    def why_empty(self) -> str:
        """Return the reason, in plain text, why the list is empty."""
        raise NotImplementedError

    @on(Input.Changed)
    def relist(self) -> None:
        """List what matches now."""
        pattern = RowFilter.or_plain(self.text.value)
        self.list.show(list(self.suggestions()), pattern, escape_text(self.why_empty()))

    def action_move(self, step: int) -> None:
        self.list.move_to(self.list.position + step)

    def action_page(self, step: int) -> None:
        self.list.move_to(self.list.position + step * self.list.page)

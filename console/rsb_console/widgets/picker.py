"""A field whose value is picked from a list while it is typed."""

from __future__ import annotations

import textwrap
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from textual import on
from textual.binding import Binding
from textual.widgets import Input

from rsb_console.widgets.controls import FieldInput
from rsb_console.widgets.filter import RowFilter
from rsb_console.widgets.form import Field, Spec
from rsb_console.widgets.lines import Line, fit
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from textual.app import ComposeResult

CURSOR = "▌"
WHOLE = 1000  # cells in which nothing is cut


class Suggestion(NamedTuple):
    """One suggestion."""

    key: str
    value: str  # for the field once it is picked
    line: Callable[[int], Line]  # formats its line for a width in cells
    fills: Mapping[str, str] = MappingProxyType({})  # values for other fields of the form, by their keys


class SuggestionList(SelectableList, can_focus=False):
    """The suggestions that match what is typed."""

    begins_at_top = True

    def __init__(self) -> None:
        super().__init__(classes="suggestions")
        self._suggestions: dict[str, Suggestion] = {}
        self._empty = ""
        self.marks_cursor = True

    def show(self, suggestions: Sequence[Suggestion], pattern: RowFilter, empty: str) -> None:
        """List the suggestions that match `pattern`, or show `empty` if none does."""
        self._empty = empty
        self._suggestions = {suggestion.key: suggestion for suggestion in suggestions if _matches(suggestion, pattern)}
        self.show_keys(list(self._suggestions))

    @property
    def current(self) -> Suggestion | None:
        return None if self.cursor_key is None else self._suggestions[self.cursor_key]

    @property
    def line_count(self) -> int:
        return len(self.keys) or len(self._empty_lines)

    @property
    def _empty_lines(self) -> list[str]:
        return textwrap.wrap(self._empty, max(20, self.size.width - 1))

    def line(self, index: int) -> Line:
        if not self.keys:
            return ((f" {self._empty_lines[index]}", "dim"),)
        sign = CURSOR if self.is_cursor(index) else " "
        return fit(((sign, "key"), *self._suggestions[self.keys[index]].line(self.size.width - 1)), self.size.width)

    def is_cursor(self, index: int) -> bool:
        """Whether enter would pick line `index`."""
        return self.marks_cursor and bool(self.keys) and super().is_cursor(index)


def _matches(suggestion: Suggestion, pattern: RowFilter) -> bool:
    return pattern.matches({"": f"{suggestion.value} {''.join(piece for piece, _ in suggestion.line(WHOLE))}"})


class PickField(Field):
    """A text field over a list. Arrows move in the list, enter picks from it.

    Typing narrows the list down. Enter takes a text that `is_literal` as the value, unless the operator has gone into
    the list.
    """

    BINDINGS: ClassVar = [
        Binding("up", "move(-1)", show=False),
        Binding("down", "move(1)", show=False),
        Binding("pageup", "page(-1)", show=False),
        Binding("pagedown", "page(1)", show=False),
    ]

    class Picked(Field.Changed):
        """A suggestion was picked, or None, which keeps the text in the field."""

        def __init__(self, field: Field, suggestion: Suggestion | None) -> None:
            super().__init__(field)
            self.suggestion = suggestion

    def __init__(self, spec: Spec, is_literal: Callable[[str], bool]) -> None:
        super().__init__(spec)
        self.add_class("-picker")
        assert isinstance(self.control, FieldInput)
        self.control.submits = False  # enter picks
        self.list = SuggestionList()
        self._suggestions: Sequence[Suggestion] = ()
        self._is_literal = is_literal
        self._entered = False
        self._empty: Callable[[str], str] = str

    def compose(self) -> ComposeResult:
        yield from super().compose()
        yield self.list

    def suggest(self, suggestions: Sequence[Suggestion], empty: Callable[[str], str]) -> None:
        """Offer suggestions in this order; `empty` returns the text for an input without a match."""
        self._suggestions, self._empty = suggestions, empty
        self._relist()

    def _relist(self) -> None:
        literal = self._is_literal(self.value)
        self.list.marks_cursor = self._entered or not literal
        self.list.show(self._suggestions, RowFilter.or_plain(self.filter_text()), self._empty(self.value))

    def filter_text(self) -> str:
        """Return the text that narrows the list of suggestions."""
        return self.value

    @property
    def is_ready(self) -> bool:
        """Whether to show the field's mistakes, which a search has not."""
        return super().is_ready and not (self.control.has_focus and self.list.marks_cursor)

    @property
    def picked(self) -> Suggestion | None:
        """The suggestion that enter picks, or None for the typed text."""
        return self.list.current if self.list.marks_cursor else None

    @on(Input.Changed)
    def _narrow(self) -> None:
        self._entered = False
        self._relist()

    @on(Input.Submitted)
    def _pick(self, event: Input.Submitted) -> None:
        event.stop()
        # Else Textual would also call the handler of Field, and enter would submit the form.
        event.prevent_default()
        self.post_message(self.Picked(self, self.picked))

    def on_selectable_list_chosen(self) -> None:
        self.post_message(self.Picked(self, self.list.current))

    def action_move(self, step: int) -> None:
        """Move in the list; from nowhere to its first line."""
        if self.list.marks_cursor:
            self.list.move_to(self.list.position + step)
        self._enter()

    def action_page(self, step: int) -> None:
        """Move by a page of the list."""
        self.list.move_to(self.list.position + step * self.list.page)
        self._enter()

    def _enter(self) -> None:
        self._entered = self.list.marks_cursor = True
        self.list.sync()

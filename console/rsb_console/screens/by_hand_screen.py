"""The form of what is done by hand with fields as YAML: a call, or a message. It stays open for more."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, TypeVar

from textual.binding import Binding
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.widgets import Button

from rsb_bridge.config.fields_text import read_fields
from rsb_bridge.model.calls import FieldError
from rsb_bridge.model.wording import Wording
from rsb_console.widgets.form import FormScreen, Notice
from rsb_console.widgets.key_hints import KeyHints

if TYPE_CHECKING:
    from collections.abc import Sequence

    from textual.app import ComposeResult

    from rsb_console.console_api import Console
    from rsb_console.widgets.form import Field

T = TypeVar("T")
_CHECKED = 4 << 10
"""Longest text (characters) to check while it is typed. A round figure: each key has the whole YAML read again."""


class FieldsText(Wording):
    """Texts about fields that are written by hand."""

    NO_MAPPING = "not a mapping of fields: write one line for each field, such as data: true"
    ALL_DEFAULTS = "(the default of every field)"


class ByHandScreen(FormScreen[T]):
    """F9 accepts from any field, as enter begins a new line in the YAML.

    Args:
        yes: the label of the button that accepts.
        keys: the keys, for the last line.
        look: class of the dialog, for its size.
    """

    BINDINGS: ClassVar = [*FormScreen.BINDINGS, Binding("f9", "submit", show=False)]

    def __init__(self, console: Console, title: str, fields: Sequence[Field], yes: str, keys: str, look: str) -> None:
        super().__init__(title, fields, yes)
        self.console = console
        self.state = Notice("call-state")
        self._keys, self._look = keys, look

    def compose(self) -> ComposeResult:
        with Vertical(classes=f"dialog {self._look}") as dialog:
            dialog.border_title = Content(self._title)
            yield self.state
            yield self.form
            yield self.form.problem
            yield self.form.help
            with Horizontal(classes="buttons -below-help"):
                yield from self.compose_buttons()
            yield from self.compose_result()
            yield KeyHints(self._keys)

    def compose_buttons(self) -> ComposeResult:
        yield Button(self._yes, id="yes", variant="primary", compact=True)
        yield Button("Close", id="no", compact=True)

    def compose_result(self) -> ComposeResult:
        """Compose what shows a result below the form, if it needs more than the state."""
        return ()

    def action_submit(self) -> None:
        self.submit()


def fields_problem(text: str) -> str:
    """Return the mistake in fields as YAML, or an empty string. Only the bridge can check them against the type."""
    try:
        is_wrong = len(text) <= _CHECKED and not isinstance(read_fields(text), dict)
    except FieldError as error:
        return str(error)
    return FieldsText.NO_MAPPING() if is_wrong else ""

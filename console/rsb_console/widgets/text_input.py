"""The text of a form's field of several lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

from textual.widgets import TextArea

if TYPE_CHECKING:
    from textual import events


class TextInput(TextArea):
    """Text of several lines. Enter begins a new line, tab goes on to the next field."""

    def __init__(self, value: str, blank: str) -> None:
        super().__init__(value, placeholder=blank, compact=True, highlight_cursor_line=False)

    async def _on_paste(self, event: events.Paste) -> None:
        """Textual calls TextArea's own, too, which would let the event come back by way of the screen."""
        event.stop()

    @property
    def value(self) -> str:
        """The text."""
        return self.text

    @value.setter
    def value(self, value: str) -> None:
        self.text = value

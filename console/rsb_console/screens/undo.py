"""The question before an undo, with its effect."""

from __future__ import annotations

from typing import TYPE_CHECKING

from textual.widgets import Button

from rsb_console.screens.confirm import ConfirmScreen

if TYPE_CHECKING:
    from textual.app import ComposeResult

    from rsb_console.session.changes import Undo


class UndoScreen(ConfirmScreen):
    """Yes or No. The focus is on No if the undo removes something, or lets messages cross that do not cross now.

    Args:
        undo: with its effect in words.
    """

    SHAPE = "-wide"

    def __init__(self, undo: Undo) -> None:
        super().__init__(undo.title, "\n".join(undo.lines), undo.yes)
        self._careful = undo.careful

    def on_mount(self) -> None:
        """Put the focus on Yes if the undo is harmless."""
        if not self._careful:
            self.query_one("#yes").focus()

    def compose_buttons(self) -> ComposeResult:
        yield Button(self._yes, id="yes", variant="error" if self._careful else "primary", compact=True)
        yield Button("No", id="no", compact=True)

"""The question before a change is taken back: what will be done, and what that means."""

from __future__ import annotations

from typing import TYPE_CHECKING

from textual.widgets import Button

from rsb_console.screens.confirm import ConfirmScreen

if TYPE_CHECKING:
    from textual.app import ComposeResult

    from rsb_console.session.changes import Undo


class UndoScreen(ConfirmScreen):
    """Yes or No; the focus is on No where something is removed, or may cross that does not now.

    Args:
        undo: what it would do.
    """

    SHAPE = "-wide"

    def __init__(self, undo: Undo) -> None:
        super().__init__(undo.title, "\n".join(undo.lines), undo.yes)
        self._careful = undo.careful

    def on_mount(self) -> None:
        """Begin on the button that does it, where that is harmless."""
        if not self._careful:
            self.query_one("#yes").focus()

    def compose_buttons(self) -> ComposeResult:
        yield Button(self._yes, id="yes", variant="error" if self._careful else "primary", compact=True)
        yield Button("No", id="no", compact=True)

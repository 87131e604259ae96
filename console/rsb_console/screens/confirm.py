"""A question before something that cannot be taken back; the focus is on No."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding
from textual.containers import Horizontal, Vertical
from textual.screen import ModalScreen
from textual.widgets import Button, Static

if TYPE_CHECKING:
    from textual.app import ComposeResult


class ConfirmScreen(ModalScreen[bool]):
    """Yes or No; escape is No.

    Args:
        title: what is about to happen: ``Remove /scan?``.
        message: what that means.
        yes: the label of the button that does it: ``Remove``.
    """

    BINDINGS: ClassVar = [
        Binding("y", "answer(True)", show=False),
        Binding("n,escape", "answer(False)", show=False),
        Binding("left,right", "app.focus_next", show=False),
    ]
    AUTO_FOCUS = "#no"
    KEYS = "y yes   n no   ← → ⏎ choose"

    def __init__(self, title: str, message: str, yes: str) -> None:
        super().__init__()
        self._title, self._message, self._yes = title, message, yes

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog") as dialog:
            dialog.border_title = self._title
            yield Static(self._message, markup=False)
            with Horizontal(classes="buttons"):
                yield from self.compose_buttons()
            yield Static(self.KEYS, classes="hint keys", markup=False)

    def compose_buttons(self) -> ComposeResult:
        yield Button(self._yes, id="yes", variant="error", compact=True)
        yield Button("No", id="no", compact=True)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        self.dismiss(event.button.id == "yes")

    def action_answer(self, answer: bool) -> None:
        self.dismiss(answer)

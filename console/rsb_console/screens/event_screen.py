"""The whole text of an event of the log."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding
from textual.screen import ModalScreen
from textual.widgets import Static

from rsb_console.notation import formats
from rsb_console.screens.dialog import Dialog
from rsb_console.widgets.log import WORD

if TYPE_CHECKING:
    from textual.app import ComposeResult

    from rsb_bridge.model.snapshot import Event


class EventScreen(ModalScreen[None]):
    """The whole text of an event."""

    BINDINGS: ClassVar = [Binding("escape,q,enter", "dismiss", show=False)]

    def __init__(self, event: Event) -> None:
        super().__init__()
        self._event = event

    def compose(self) -> ComposeResult:
        """Compose the text, and below it the link and the topic."""
        event = self._event
        concerns = [word for word in (event.code, event.link, event.topic) if word]
        yield Dialog(
            f"{WORD[event.level]} at {formats.time_of_day(event.time)}",
            Static(event.text, markup=False),
            Static(" · ".join(concerns), classes="hint keys", markup=False),
            keys="esc close",
        )

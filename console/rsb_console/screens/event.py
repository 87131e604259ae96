"""One line of the log, whole."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding
from textual.screen import ModalScreen
from textual.widgets import Static

from rsb_console.look import formats
from rsb_console.widgets.dialog import Dialog
from rsb_console.widgets.log import WORD

if TYPE_CHECKING:
    from textual.app import ComposeResult

    from rsb_bridge.model.snapshot import Event


class EventScreen(ModalScreen[None]):
    """All that an event says, over as many lines as it takes.

    Args:
        event: which.
    """

    BINDINGS: ClassVar = [Binding("escape,q,enter", "dismiss", show=False)]

    def __init__(self, event: Event) -> None:
        super().__init__()
        self._event = event

    def compose(self) -> ComposeResult:
        """The text, and below it what it concerns."""
        event = self._event
        concerns = [word for word in (event.code, event.link, event.topic) if word]
        yield Dialog(
            f"{WORD[event.level]} at {formats.time_of_day(event.time)}",
            Static(event.text, markup=False),
            Static(" · ".join(concerns), classes="hint keys", markup=False),
            keys="esc close",
        )

"""What is typed after a form was submitted and before its refusal is to be seen: no field is to have it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from textual import events

if TYPE_CHECKING:
    from textual.message import Message

AT_MOST = 5.0  # s; a submission of which nobody says what became of it makes the form deaf no longer than this
LEAVING = ("escape", "ctrl+c")


class InputGuard:
    """Knows by their times which keys and pastes those are; they may come long after, while the console is busy."""

    def __init__(self) -> None:
        self._until = 0.0

    def begin(self) -> None:
        """The form is submitted."""
        self._until = time.monotonic() + AT_MOST

    def end(self) -> None:
        """What became of it is to be seen."""
        self._until = time.monotonic()

    def covers(self, event: Message) -> bool:
        """Whether `event` is to be dropped; never one that leaves the form."""
        if event.time > self._until:  # Textual's times are monotonic
            return False
        return isinstance(event, events.Paste) or (isinstance(event, events.Key) and event.key not in LEAVING)

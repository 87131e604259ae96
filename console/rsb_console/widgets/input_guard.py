"""Ignores input from a form's submission until the result of the submission is shown."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from textual import events

if TYPE_CHECKING:
    from textual.message import Message

AT_MOST = 5.0  # s that a form ignores input if no result is ever shown
LEAVING = ("escape", "ctrl+c")


class InputGuard:
    """Knows by their times which keys and pastes to ignore; a busy console handles them long after they were typed."""

    def __init__(self) -> None:
        self._until = 0.0

    def begin(self) -> None:
        self._until = time.monotonic() + AT_MOST

    def cancel(self) -> None:
        """Ignore no input: what the operator typed since `begin` is meant for the new focus."""
        self._until = 0.0

    def end(self) -> None:
        """The result is shown."""
        self._until = time.monotonic()

    def covers(self, event: Message) -> bool:
        """Whether to ignore an event; never one that leaves the form."""
        if event.time > self._until:  # Textual's times are monotonic
            return False
        return isinstance(event, events.Paste) or (isinstance(event, events.Key) and event.key not in LEAVING)

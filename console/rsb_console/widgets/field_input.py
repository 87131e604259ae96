"""The text of a form's field."""

from __future__ import annotations

from typing import TYPE_CHECKING

from textual import events
from textual.widgets import Input

from rsb_console.terminal.input_queue import InputQueue
from rsb_console.widgets.input_guard import InputGuard

if TYPE_CHECKING:
    from collections.abc import Iterator

    from textual.message import Message


class FieldInput(Input):
    """One line of text, which ignores input from its submission until the result is shown.

    Attributes:
        input_guard: the form's.
        submits: whether enter submits the form.

    Args:
        value: at first.
        blank: what an empty one means.
        edited: the focus comes to its end; else what is typed then replaces it.
    """

    def __init__(self, value: str, blank: str, *, edited: bool = False) -> None:
        super().__init__(value, placeholder=blank, compact=True, select_on_focus=not edited)
        self.input_guard = InputGuard()
        self.submits = True

    # Textual calls these of every class, Input's after ours, unless the default is prevented.

    def _on_focus(self, event: events.Focus) -> None:
        if not self.select_on_focus and not event.from_app_focus:
            self.cursor_position = len(self.value)

    async def _on_key(self, event: events.Key) -> None:
        if self.input_guard.covers(event):
            event.stop()
            event.prevent_default()
        elif event.key == "enter" and self.submits:
            # A binding would run only after the keys that are queued already.
            self.input_guard.begin()
            event.stop()
            event.prevent_default()
            await self.action_submit()

    def _on_paste(self, event: events.Paste) -> None:
        covered = self.input_guard.covers(event)
        if covered or "\t" in event.text:
            event.stop()
            event.prevent_default()
        if not covered and "\t" in event.text:
            InputQueue.of(self.app).insert(fields_of(event.text))


def fields_of(pasted: str) -> Iterator[Message]:
    """Split a pasted text into fields. A tab in it goes to the next field, like the key."""
    for number, part in enumerate(pasted.split("\t")):
        if number:
            yield events.Key("tab", "\t")
        if part:
            yield events.Paste(part)

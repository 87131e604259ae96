"""The controls of a form's fields: a line of text, several lines, and a choice. Each may ignore input for a while."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, ClassVar

from rich.cells import cell_len
from textual import events
from textual.binding import Binding
from textual.content import Content
from textual.message import Message
from textual.reactive import reactive
from textual.widget import Widget
from textual.widgets import Input, TextArea

from rsb_console.terminal.input_queue import InputQueue

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_GUARDED_AT_MOST = 5.0  # s that a form ignores input if no result is ever shown
_LEAVING = ("escape", "ctrl+c")
_SAME_WORD = 1.0
"""Seconds after which a typed letter begins a new word. A round figure: people type the letters of a word faster."""


class InputGuard:
    """Knows by their times which keys and pastes to ignore; a busy console handles them long after they were typed."""

    def __init__(self) -> None:
        self._until = 0.0

    def begin(self) -> None:
        self._until = time.monotonic() + _GUARDED_AT_MOST

    def cancel(self) -> None:
        """Ignore no input: what the operator typed since `begin` is meant for the new focus."""
        self._until = 0.0

    def end(self) -> None:
        self._until = time.monotonic()

    def covers(self, event: Message) -> bool:
        """Whether to ignore an event; never one that leaves the form."""
        if event.time > self._until:  # Textual's times are monotonic
            return False
        return isinstance(event, events.Paste) or (isinstance(event, events.Key) and event.key not in _LEAVING)


class FieldInput(Input):
    """One line of text, which ignores input from its submission until the result is shown.

    Attributes:
        submits: whether enter submits the form.

    Args:
        edited: puts the cursor at the end on focus; otherwise typing replaces the text.
    """

    def __init__(self, value: str, blank: str, *, edited: bool = False) -> None:
        super().__init__(value, placeholder=blank, compact=True, select_on_focus=not edited)
        self.input_guard = InputGuard()
        self.submits = True

    # Textual calls these handlers of every class, Input's after ours, unless the default is prevented.

    def on_focus(self, event: events.Focus) -> None:
        # When the terminal's window gets the focus back, the cursor stays where it was.
        if not self.select_on_focus and not event.from_app_focus:
            self.cursor_position = len(self.value)

    async def on_key(self, event: events.Key) -> None:
        if self.input_guard.covers(event):
            event.stop()
            event.prevent_default()
        elif event.key == "enter" and self.submits:
            # A binding would run only after the keys that are queued already.
            self.input_guard.begin()
            event.stop()
            event.prevent_default()
            await self.action_submit()

    def on_paste(self, event: events.Paste) -> None:
        covered = self.input_guard.covers(event)
        if covered or "\t" in event.text:
            event.stop()
            event.prevent_default()
        if not covered and "\t" in event.text:
            InputQueue.of(self.app).insert(_split_at_tabs(event.text))


def _split_at_tabs(pasted: str) -> Iterator[Message]:
    """Split a pasted text into fields. A tab in it goes to the next field, like the key."""
    for number, part in enumerate(pasted.split("\t")):
        if number:
            yield events.Key("tab", "\t")
        if part:
            yield events.Paste(part)


class TextInput(TextArea):
    """Text of several lines. Enter begins a new line, tab goes on to the next field."""

    def __init__(self, value: str, blank: str) -> None:
        super().__init__(value, placeholder=blank, compact=True, highlight_cursor_line=False)

    async def on_paste(self, event: events.Paste) -> None:
        """Stop the event: Textual also calls TextArea's handler, which would return it through the screen."""
        event.stop()

    @property
    def value(self) -> str:
        return self.text

    @value.setter
    def value(self, value: str) -> None:
        self.text = value


class Choice(Widget, can_focus=True):
    """A row such as ``◉ transmit   ○ receive``, or only the chosen option if the row is too narrow.

    Args:
        options: value and label of each; at least one.
    """

    BINDINGS: ClassVar = [
        Binding("left", "choose(-1)", show=False),
        Binding("right,space", "choose(1)", show=False),
        Binding("enter", "submit", show=False),
    ]
    COMPONENT_CLASSES: ClassVar[set[str]] = {"choice--chosen", "choice--other"}

    value = reactive("")

    class Changed(Message):
        """Another option was chosen."""

    class Submitted(Message):
        """Enter was pressed."""

    class Mistyped(Message):
        """The typed text matches the beginning of no option."""

        def __init__(self, text: str, choice: Choice) -> None:
            super().__init__()
            self.text = text
            self.choice = choice

    def __init__(self, options: Sequence[tuple[str, str]], value: str = "") -> None:
        super().__init__()
        self.input_guard = InputGuard()
        self._typed = ""
        self._typed_at = 0.0
        self._before = ""
        self._options = tuple(options)
        self.set_reactive(Choice.value, value or self._options[0][0])

    def offer(self, options: Sequence[tuple[str, str]]) -> None:
        """Replace the options; choose the first if the present choice is gone."""
        if tuple(options) != self._options:
            self._options = tuple(options)
            if self.value not in dict(options):
                self.value = options[0][0]
            self.refresh()

    def watch_value(self) -> None:
        self.post_message(self.Changed())

    @property
    def _at(self) -> int:
        return [value for value, _ in self._options].index(self.value)

    def action_choose(self, step: int) -> None:
        """Choose the option `step` places further, wrapping around."""
        self.value = self._options[(self._at + step) % len(self._options)][0]

    def on_key(self, event: events.Key) -> None:
        """Choose the option whose name is typed."""
        if self.input_guard.covers(event):
            return  # the form stops it
        if event.character is None or not event.is_printable or event.character.isspace():
            self._typed = ""
            return
        event.stop()  # a letter is no key of the screen here
        event.prevent_default()
        if event.time - self._typed_at > _SAME_WORD:
            self._typed = ""
        self._typed_at = event.time
        self._type(event.character)

    def on_paste(self, event: events.Paste) -> None:
        event.stop()
        if self.input_guard.covers(event):
            return
        if "\t" in event.text:
            InputQueue.of(self.app).insert(_split_at_tabs(event.text))
        elif event.text.isspace():
            self.action_choose(len(event.text))
        else:
            self._typed = ""
            self._type(event.text)

    def on_blur(self) -> None:
        self._typed = ""

    def _type(self, text: str) -> None:
        typed = self._typed + text
        start = typed.casefold()
        named = [each[0] for each in self._options if any(name.casefold().startswith(start) for name in each)]
        if not self._typed:
            self._before = self.value
        if named:
            self._typed = typed
            # The chosen one stays if it fits: a letter does not jump to the first of several that begin alike.
            self.value = self.value if self.value in named else named[0]
        else:
            self._typed, self.value = "", self._before
            self.post_message(self.Mistyped(typed, self))

    def action_submit(self) -> None:
        self.post_message(self.Submitted())

    def _pieces(self) -> list[str]:
        return [f"{'◉' if value == self.value else '○'} {label}   " for value, label in self._options]

    def render(self) -> Content:
        pieces, at = self._pieces(), self._at
        if cell_len("".join(pieces)) > self.size.width:
            return Content(f"◀ {self._options[at][1]} ▶  {at + 1} of {len(pieces)}")
        chosen, other = (self.get_visual_style(f"choice--{name}", partial=True) for name in ("chosen", "other"))
        return Content.assemble(*((piece, chosen if index == at else other) for index, piece in enumerate(pieces)))

    def on_click(self, event: events.Click) -> None:
        edge = 0
        for (value, _), piece in zip(self._options, self._pieces(), strict=True):
            edge += cell_len(piece)
            if event.x < edge:
                self.value = value
                return

"""One of a few options, on one line, chosen with the arrow keys or by typing its name."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from rich.cells import cell_len
from textual.binding import Binding
from textual.content import Content
from textual.message import Message
from textual.reactive import reactive
from textual.widget import Widget

from rsb_console.terminal.input_queue import InputQueue
from rsb_console.widgets.field_input import fields_of
from rsb_console.widgets.input_guard import InputGuard

if TYPE_CHECKING:
    from collections.abc import Sequence

    from textual import events

_SAME_WORD = 1.0
"""s after which a typed letter begins a new word."""


class Choice(Widget, can_focus=True):
    """A row such as ``◉ transmit   ○ receive``, or only the chosen option if the row is too narrow.

    Args:
        options: value and label of each; at least one.
        value: chosen at first, or empty for the first option.

    Attributes:
        input_guard: the form's.
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
        """The typed text is the beginning of no option.

        Attributes:
            text: the typed text.
            choice: the widget.
        """

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
        """Have other options; one that is there no longer gives way to the first."""
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
        """Choose the option `step` places on, round the end."""
        self.value = self._options[(self._at + step) % len(self._options)][0]

    def on_key(self, event: events.Key) -> None:
        """Choose the option whose name is typed."""
        if self.input_guard.covers(event):
            return  # the form stops it
        if event.character is None or not event.is_printable or event.character.isspace():
            self._typed = ""
            return
        event.stop()
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
            InputQueue.of(self.app).insert(fields_of(event.text))
        elif event.text.isspace():
            self.action_choose(len(event.text))
        else:
            self._typed = ""
            self._type(event.text)

    def on_blur(self) -> None:
        self._typed = ""

    def _type(self, text: str) -> None:
        typed = self._typed + text
        named = [value for value, label in self._options if _begins((value, label), typed)]
        if not self._typed:
            self._before = self.value
        if named:
            self._typed = typed
            self.value = self.value if self.value in named else named[0]
        else:
            self._typed, self.value = "", self._before
            self.post_message(self.Mistyped(typed, self))

    def action_submit(self) -> None:
        """As enter in any other field."""
        self.post_message(self.Submitted())

    def _pieces(self) -> list[str]:
        return [f"{'◉' if value == self.value else '○'} {label}   " for value, label in self._options]

    def render(self) -> Content:
        pieces, at = self._pieces(), self._at
        if cell_len("".join(pieces)) > self.size.width:
            return Content(f"◀ {self._options[at][1]} ▶  {at + 1} of {len(pieces)}")
        looks = ["choice--chosen" if index == at else "choice--other" for index in range(len(pieces))]
        return Content.assemble(
            *((piece, self.get_visual_style(look, partial=True)) for piece, look in zip(pieces, looks, strict=True))
        )

    def on_click(self, event: events.Click) -> None:
        edge = 0
        for (value, _), piece in zip(self._options, self._pieces(), strict=True):
            edge += cell_len(piece)
            if event.x < edge:
                self.value = value
                return


def _begins(names: tuple[str, ...], typed: str) -> bool:
    return any(name.casefold().startswith(typed.casefold()) for name in names)

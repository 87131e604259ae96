"""The line in which a filter is typed."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding
from textual.containers import Horizontal
from textual.message import Message
from textual.widgets import Input, Static

from rsb_console.widgets.pattern import Pattern, PatternError

if TYPE_CHECKING:
    from textual.app import ComposeResult


class Prompt(Horizontal):
    """``/`` and an input. What is typed filters at once; enter keeps it, escape takes it back.

    Args:
        columns: those by whose name one may look, as a hint.
    """

    BINDINGS: ClassVar = [Binding("escape", "cancel", show=False)]

    class Changed(Message):
        """A valid pattern, or none, was typed."""

        def __init__(self, pattern: Pattern | None) -> None:
            super().__init__()
            self.pattern = pattern

    class Closed(Message):
        """The operator is done with it."""

    def __init__(self, columns: str = "state: kind: robot: type: via: why:") -> None:
        super().__init__(id="prompt")
        self._columns = columns
        self.display = False
        self._before = ""

    def compose(self) -> ComposeResult:
        """The slash, the input, and room for what is wrong."""
        yield Static(" /", id="sign")
        yield Input(id="pattern", placeholder=f"terms that match, !terms that do not; {self._columns}")
        yield Static("", id="problem", classes="problem")

    def open(self, text: str) -> None:
        """Ask for a filter, beginning with `text`. The focus moves at once: what is typed next is meant for it."""
        self._before = text
        self.display = True
        field = self.query_one(Input)
        with self.prevent(Input.Changed):
            field.value = text
        self.query_one("#problem", Static).update("")
        self.screen.set_focus(field)

    def on_input_changed(self, event: Input.Changed) -> None:
        """Filter by what stands there now."""
        event.stop()
        problem = self.query_one("#problem", Static)
        try:
            pattern = Pattern(event.value) or None
        except PatternError as error:
            problem.update(str(error))
            return
        problem.update("")
        self.post_message(self.Changed(pattern))

    def on_input_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        self._close()

    def action_cancel(self) -> None:
        self.post_message(self.Changed(Pattern(self._before) if self._before else None))
        self._close()

    def _close(self) -> None:
        self.display = False
        self.post_message(self.Closed())

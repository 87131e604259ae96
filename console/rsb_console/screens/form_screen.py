"""A dialog that is a form: checked while it is filled in, and accepted only without mistakes."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, TypeVar

from textual.binding import Binding
from textual.containers import Horizontal, Vertical
from textual.screen import ModalScreen
from textual.widgets import Button

from rsb_console.widgets.form import Choice, Field, Form

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from textual import events
    from textual.app import ComposeResult

T = TypeVar("T")
_AROUND = 11
"""Lines that are not the form's: the frame, help and buttons, and below the dialog a toast."""
_DRAWN_AFTER = 0.1  # s from a refusal until it is drawn, which takes two or three refreshes


class FormScreen(ModalScreen[T | None]):
    """Fields and two buttons; escape gives None.

    A subclass says what is wrong with the values (`problems`) and what they make (`result`).

    Args:
        yes: the label of the button that accepts.
    """

    BINDINGS: ClassVar = [Binding("escape", "dismiss", show=False)]
    AUTO_FOCUS = ".field Input, .field Choice"

    def __init__(self, title: str, fields: Sequence[Field], yes: str) -> None:
        super().__init__()
        self.form = Form(fields)
        self._title, self._yes = title, yes

    def compose(self) -> ComposeResult:
        """Compose the form, its problem as a whole, the help and the buttons."""
        with Vertical(classes="dialog -wide") as dialog:
            dialog.border_title = self._title
            yield self.form
            yield self.form.problem
            yield self.form.help
            with Horizontal(classes="buttons -below-help"):
                yield from self.compose_buttons()

    def compose_buttons(self) -> ComposeResult:
        yield Button(self._yes, id="yes", variant="primary", compact=True)
        yield Button("Cancel", id="no", compact=True)

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        """Return the problems by the field's key; any other key is about the form as a whole."""
        raise NotImplementedError

    def result(self, values: Mapping[str, str]) -> T:
        """Return the result of values without problems."""
        raise NotImplementedError

    def on_mount(self) -> None:
        self.check()

    def on_resize(self) -> None:
        """Leave room for a toast below the dialog; the fields scroll."""
        self.form.styles.max_height = max(4, self.size.height - _AROUND)

    def on_field_changed(self) -> None:
        self.check()

    def on_field_submitted(self, event: Field.Submitted) -> None:
        """Go to the next field that needs a value, or submit."""
        self.check()
        following = self.form.empty_after(event.field)
        if following is None:
            self.submit()
        else:
            # This enter has submitted nothing, and its guard would swallow what is typed into the next field.
            self.form.input_guard.cancel()
            following.touched = True
            following.control.focus()
            self.check()

    def check(self) -> None:
        """Show the problems of the present values."""
        self.form.show_problems(self.problems(self.form.values))

    def submit(self) -> None:
        """Accept the result, or focus the first mistake. Ignore input until the result of the submission is shown."""
        self.form.input_guard.begin()
        self.check()
        if self.form.settle():
            self.accept(self.result(self.form.values))
        self.set_timer(_DRAWN_AFTER, self.form.input_guard.end)

    def on_key(self, event: events.Key) -> None:
        """Ignore the keys that were typed before the result of a submission was shown."""
        if self.form.input_guard.covers(event):
            event.stop()
            event.prevent_default()
        elif event.key == "enter" and isinstance(self.focused, Choice):
            # Already here: keys behind enter are handled before its binding submits the choice.
            self.form.input_guard.begin()

    def accept(self, result: T) -> object:
        """Close the dialog with the result; a subclass may have more to do first."""
        return self.dismiss(result)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Handle a button; not to be overridden, as Textual calls the handler of every class."""
        self.press(event.button.id or "")

    def press(self, button: str) -> None:
        """Accept or leave; a subclass with more buttons handles those first."""
        if button == "yes":
            self.submit()
        else:
            self.dismiss(None)

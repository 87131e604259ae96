"""Forms: labelled fields with mistakes beneath them, and a dialog with a form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, TypeVar

from textual import events, on
from textual.binding import Binding
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.message import Message
from textual.screen import ModalScreen
from textual.widgets import Button, Input, Static, TextArea

from rsb_console.library_internals.textual_internals import HasPlace
from rsb_console.terminal.input_queue import InputQueue
from rsb_console.widgets.controls import Choice, FieldInput, InputGuard, TextInput

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from textual.app import ComposeResult
    from textual.widget import Widget

T = TypeVar("T")
_AROUND = 11
"""Lines that are not the form's: the frame, help and buttons, and below the dialog a toast."""
_DRAWN_AFTER = 0.1  # s from a refusal until it is drawn, which takes two or three refreshes


@dataclass(frozen=True, slots=True)
class Spec:
    """One field of a form."""

    key: str
    label: str
    help: str  # one or two lines, shown while the field has the focus
    value: str = ""
    blank: str = ""  # meaning of an empty field, shown in it
    options: tuple[tuple[str, str], ...] = ()  # value and label of each choice, or empty for a text field
    edited: bool = False  # operators usually edit the value rather than replace it, as with a path


class Notice(Static):
    """Some lines of text, which take no room while they are empty."""

    def __init__(self, classes: str, *, id: str | None = None) -> None:  # noqa: A002 -- Textual's name
        super().__init__(markup=False, classes=classes, id=id)
        self.display = False
        self._text = ""

    def set_text(self, text: str) -> None:
        if text != self._text:  # Textual lays the screen out again even for the same text
            self._text = text
            self.update(text)
            self.display = bool(text)


class Field(Vertical, HasPlace):
    """A label, an input or a choice, and its problem.

    Attributes:
        touched: the operator has typed or chosen here; mistakes are shown only then.
        position: in the form, from the top.
    """

    class Changed(Message):
        """The value of a field changed."""

        def __init__(self, field: Field) -> None:
            super().__init__()
            self.field = field

    class Submitted(Changed):
        """Enter was pressed in a field."""

    def __init__(self, spec: Spec) -> None:
        super().__init__(classes="field", id=f"field-{spec.key}")
        self.spec = spec
        self.touched = False
        self.position = 0
        self._label = Static(spec.label, classes="label", markup=False)
        self.control: FieldInput | Choice | TextInput = (
            Choice(spec.options, spec.value) if spec.options else FieldInput(spec.value, spec.blank, edited=spec.edited)
        )
        self.problem = Notice("problem")
        self.note = Notice("hint note")

    def compose(self) -> ComposeResult:
        with Horizontal():
            yield self._label
            yield self.control
        yield self.problem
        yield self.note

    def describe(self, spec: Spec) -> None:
        """Take another label, help and options for the same key; the value stays if it is still an option."""
        self.spec = spec
        self._label.update(spec.label)
        if isinstance(self.control, Choice):
            self.control.offer(spec.options)
        else:
            self.control.placeholder = spec.blank

    @property
    def is_ready(self) -> bool:
        """Whether to show the field's mistakes."""
        return self.touched

    @property
    def value(self) -> str:
        return self.control.value.strip()

    @value.setter
    def value(self, value: str) -> None:
        self.control.value = value

    @on(Input.Changed)
    @on(Choice.Changed)
    def _changed(self, event: Message) -> None:
        event.stop()
        # Values that a pick or a proposal fills in are nobody's mistakes yet.
        self.touched = self.touched or self.control.has_focus
        self.post_message(self.Changed(self))

    @on(Input.Submitted)
    @on(Choice.Submitted)
    def _submitted(self, event: Message) -> None:
        event.stop()
        self.post_message(self.Submitted(self))


class TextField(Field):
    """A field with several lines of text."""

    def __init__(self, spec: Spec) -> None:
        super().__init__(spec)
        self.add_class("-text")
        self.control = TextInput(spec.value, spec.blank)

    @on(TextArea.Changed)
    def _text_changed(self, event: Message) -> None:
        self._changed(event)


class Form(VerticalScroll, can_focus=False):
    """Fields, one below the other. Arrows and tab move between them, enter submits."""

    BINDINGS: ClassVar = [
        Binding("up", "app.focus_previous", show=False),
        Binding("down", "app.focus_next", show=False),
    ]

    def __init__(self, fields: Sequence[Field]) -> None:
        super().__init__(classes="form")
        self.fields = {field.spec.key: field for field in fields}
        self.help = Notice("hint help")
        self.problem = Notice("problem", id="form-problem")
        self.input_guard = InputGuard()
        for position, field in enumerate(fields):
            field.position = position
            if isinstance(field.control, FieldInput | Choice):
                field.control.input_guard = self.input_guard
        self._focus_moved = False
        self._problems: Mapping[str, str] = {}

    def compose(self) -> ComposeResult:
        yield from self.fields.values()

    @property
    def values(self) -> dict[str, str]:
        """The values of the fields that are not hidden, by their keys; also while the app ends, which displays none."""
        return {key: field.value for key, field in self.fields.items() if field.styles.display != "none"}

    def show_problems(self, problems: Mapping[str, str]) -> None:
        """Show problems by their keys: a field's below the field, others below the form."""
        self._problems = problems
        for key, field in self.fields.items():
            field.problem.set_text(problems.get(key, "") if field.is_ready else "")
        # Also the mistakes of hidden fields, which have no place of their own.
        elsewhere = [message for key, message in problems.items() if key not in self.values]
        self.problem.set_text("\n".join(elsewhere))

    def settle(self) -> bool:
        """Return whether there is no problem; else show every problem and focus the first."""
        for field in self.fields.values():
            field.touched = True
        self.show_problems(self._problems)
        if wrong := self._wrong:
            wrong[0].control.focus()
        return not self._problems

    @property
    def _wrong(self) -> list[Field]:
        return [field for key, field in self.fields.items() if key in self._problems and field.display]

    def empty_after(self, submitted: Field) -> Field | None:
        """Return the next untouched field that needs a value, or None if there are other mistakes."""
        wrong = self._wrong
        if len(wrong) < len(self._problems) or submitted in wrong or any(each.touched or each.value for each in wrong):
            return None
        return wrong[0] if wrong else None

    def on_descendant_focus(self, event: events.DescendantFocus) -> None:
        for position, field in enumerate(self.fields.values()):
            if field.control is event.widget:
                self.help.set_text(field.spec.help)
                self._focus_moved = self._focus_moved or position > 0

    @on(Choice.Mistyped)
    def _mistyped(self, event: Choice.Mistyped) -> None:
        """Pass a text that was typed at the first choice of a new form on to the first text field."""
        event.stop()
        controls = [field.control for field in self.fields.values() if field.display]
        first = next((each for each in controls if isinstance(each, FieldInput)), None)
        # Only before the focus has moved: text that is typed ahead of a form is for its first text field.
        if first is not None and controls[0] is event.choice and not self._focus_moved:
            first.focus()
            InputQueue.of(self.app).insert([events.Paste(event.text)])


class FieldSearch(Notice, can_focus=True):
    """Takes the beginning of a field's name, and goes to that field. Takes no room until it begins."""

    def __init__(self, form: Form) -> None:
        super().__init__("hint")
        self._form = form
        self._typed = ""
        self._back: Widget | None = None

    def begin(self) -> None:
        if not self.has_focus:
            self._typed, self._back = "", self.screen.focused
        self._show([])
        self.focus()

    def _found(self) -> list[Field]:
        fields = (field for field in self._form.fields.values() if field.display)
        return [field for field in fields if field.spec.label.casefold().startswith(self._typed.casefold())]

    def _show(self, found: list[Field]) -> None:
        names = ", ".join(field.spec.label for field in found) or "type the beginning of its name"
        self.set_text(f"Go to {self._typed or 'a field'}: {names}")

    def on_key(self, event: events.Key) -> None:
        event.stop()
        event.prevent_default()
        if event.key == "enter" and self._typed:
            self._found()[0].control.focus()
        elif event.key in ("escape", "enter"):
            self.screen.set_focus(self._back)
        elif event.character is not None and event.is_printable:
            before, self._typed = self._typed, self._typed + event.character
            found = self._found()
            if len(found) == 1:
                found[0].control.focus()
                return
            if not found:  # a letter that no name has there is left out
                self._typed = before
            self._show(self._found() if self._typed else [])

    def on_blur(self) -> None:
        self.set_text("")


class FormScreen(ModalScreen[T | None]):
    """Fields and two buttons, the first of which (`yes`) accepts; escape gives None.

    A subclass checks the values (`problems`) and makes the result of them (`result`).
    """

    BINDINGS: ClassVar = [Binding("escape", "dismiss", show=False)]
    AUTO_FOCUS = ".field Input, .field Choice"

    def __init__(self, title: str, fields: Sequence[Field], yes: str) -> None:
        super().__init__()
        self.form = Form(fields)
        self._title, self._yes = title, yes

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog -wide") as dialog:
            dialog.border_title = Content(self._title)
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
        """Return the result, which is valid only for values without problems."""
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

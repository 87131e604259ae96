"""A field of several lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

from textual import on
from textual.widgets import TextArea

from rsb_console.widgets.form import Field
from rsb_console.widgets.text_input import TextInput

if TYPE_CHECKING:
    from textual.message import Message

    from rsb_console.widgets.form import Spec


class TextField(Field):
    """As `Field`, of several lines."""

    def __init__(self, spec: Spec) -> None:
        super().__init__(spec)
        self.add_class("-text")
        self.control = TextInput(spec.value, spec.blank)

    @on(TextArea.Changed)
    def _text_changed(self, event: Message) -> None:
        self._changed(event)

"""A screen with a list that `/` filters."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, TypeVar

from textual.binding import Binding
from textual.screen import ModalScreen

if TYPE_CHECKING:
    from rsb_console.widgets.filter import Prompt, RowFilter

T = TypeVar("T")


class FilteredScreen(ModalScreen[T]):
    """A list that `/` filters, and the prompt for that. Subclasses show both, and set `AUTO_FOCUS` to the list.

    Attributes:
        pattern: the filter, or None.
    """

    BINDINGS: ClassVar = [Binding("slash", "filter", show=False)]

    def __init__(self, prompt: Prompt) -> None:
        super().__init__()
        self.prompt = prompt
        self.pattern: RowFilter | None = None

    def show(self) -> None:
        """Show what the filter leaves."""
        raise NotImplementedError

    def action_filter(self) -> None:
        self.prompt.open("" if self.pattern is None else self.pattern.text)

    def on_prompt_changed(self, event: Prompt.Changed) -> None:
        self.pattern = event.pattern
        self.show()

    def on_prompt_closed(self) -> None:
        self.set_focus(self.query_one(str(self.AUTO_FOCUS)))

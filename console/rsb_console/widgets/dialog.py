"""The frame of a dialog."""

from __future__ import annotations

from typing import TYPE_CHECKING

from textual.containers import Vertical
from textual.widgets import Static

if TYPE_CHECKING:
    from textual.widget import Widget


class Dialog(Vertical):
    """A dialog's widgets, with a title on the frame, and the keys as its last line.

    Args:
        title: of the dialog.
        widgets: from the top.
        keys: what to press; the last line.
        shape: a further CSS class: ``-wide`` or ``-history``.
    """

    def __init__(self, title: str, *widgets: Widget, keys: str, shape: str = "-wide") -> None:
        super().__init__(*widgets, Static(keys, classes="hint keys", markup=False), classes=f"dialog {shape}")
        self.border_title = title

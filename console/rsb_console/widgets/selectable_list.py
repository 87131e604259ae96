"""A list of live lines, whose cursor stays on its item while the list is sorted, filtered and refreshed."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, ClassVar

from textual.geometry import Region
from textual.message import Message

from rsb_console.actions import Group, bindings
from rsb_console.terminal.input_queue import InputGate
from rsb_console.widgets.lines import LiveLines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from textual import events


class SelectableList(LiveLines, can_focus=True):
    """A list of keyed items, one a line, below `sticky` lines of heading.

    `show_keys` sets the items; a subclass draws each in `line`.

    Attributes:
        slid_at: s, when another item slid below the cursor, or minus infinity.
    """

    BINDINGS = bindings(Group.MOVE)

    begins_at_top: ClassVar[bool] = False
    """Whether the first item is what matters, until the operator moves the cursor. Elsewhere a key that acts on an item
    must not meet the one that has just taken its place."""

    class CursorMoved(Message):
        """Another item is under the cursor."""

        def __init__(self, pane: SelectableList) -> None:
            super().__init__()
            self.pane = pane

        @property
        def control(self) -> SelectableList:
            return self.pane

    class Chosen(CursorMoved):
        """An item was clicked."""

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:  # noqa: A002 -- Textual's name
        super().__init__(id=id, classes=classes)
        self.keys: Sequence[str] = ()
        self._cursor = 0
        self._moved = False
        self.slid_at = float("-inf")

    @property
    def follows_top(self) -> bool:
        """Whether the cursor stays on the first item, until the operator moves it."""
        return self.begins_at_top and not self._moved

    @property
    def line_count(self) -> int:
        """Number of lines: the heading and one for each item."""
        return self.sticky + len(self.keys)

    def is_cursor(self, index: int) -> bool:
        """Whether line `index` holds the item under the cursor."""
        return index == self.sticky + self._cursor

    @property
    def cursor_key(self) -> str | None:
        """The key of the item under the cursor, or None if the list is empty."""
        return self.keys[self._cursor] if self._cursor < len(self.keys) else None

    def show_keys(self, keys: Sequence[str]) -> None:
        """List `keys`. The cursor stays on its item, or at its position if the item is gone."""
        before, follows = self.cursor_key, self.follows_top
        self.keys = keys
        # First: Textual scrolls no further than the height that it knows.
        self.measure_lines()
        if follows:
            self._place(0)
        elif self.cursor_key != before:
            self._place(keys.index(before) if before in keys else min(self._cursor, max(0, len(keys) - 1)))
        self.sync()
        if self.cursor_key != before:
            if before is not None:
                self.slid_at = time.monotonic()
            self.post_message(self.CursorMoved(self))

    def is_seen(self) -> bool:
        """Whether a key can be for the item under the cursor, and not for one that was there a moment ago."""
        return InputGate.of(self.app).was_seen(self.slid_at)

    def hold(self) -> None:
        """Keep the cursor on its item from now on, as the operator has chosen it."""
        self._moved = True

    def move_to(self, position: int) -> None:
        """Put the cursor on item number `position`, or the nearest there is."""
        self.hold()
        position = max(0, min(len(self.keys) - 1, position))
        if position != self._cursor:
            self._place(position)
            self.sync()
            self.post_message(self.CursorMoved(self))

    def _place(self, position: int) -> None:
        self._cursor = position
        top, page = round(self.scroll_offset.y), self.page
        shown = max(position - page + 1, min(top, position))
        if shown != top:
            # Forced: Textual scrolls only a widget that shows a scrollbar, and shows it a refresh after it has grown.
            self.scroll_to(y=shown, animate=False, force=True)

    @property
    def position(self) -> int:
        """Number of the item under the cursor."""
        return self._cursor

    @property
    def page(self) -> int:
        return max(1, self.size.height - self.sticky)

    def action_move_down(self) -> None:
        self.move_to(self._cursor + 1)

    def action_move_up(self) -> None:
        self.move_to(self._cursor - 1)

    def action_move_first(self) -> None:
        self.move_to(0)

    def action_move_last(self) -> None:
        self.move_to(len(self.keys) - 1)

    def action_page_down(self) -> None:
        self.move_to(self._cursor + self.page)

    def action_page_up(self) -> None:
        self.move_to(self._cursor - self.page)

    def on_click(self, event: events.Click) -> None:
        """Move the cursor to the item under the mouse; choose the item if the cursor is there already."""
        at = event.get_content_offset(self)
        if at is None:  # on the border
            return
        if at.y < self.sticky:
            self.heading_clicked(at.x)
            return
        position = self.index_at(at.y) - self.sticky
        if position == self._cursor:
            self.hold()
            self.post_message(self.Chosen(self))
        elif position < len(self.keys):
            self.move_to(position)

    def heading_clicked(self, x: int) -> None:
        """Handle a click on the heading, `x` cells from its left edge."""

    def on_focus(self) -> None:
        """Redraw the cursor's line, which looks different in the focused pane."""
        self._refresh_cursor()

    def on_blur(self) -> None:
        self._refresh_cursor()

    def _refresh_cursor(self) -> None:
        y = self.sticky + self._cursor - round(self.scroll_offset.y)
        self.refresh(Region(0, y, self.size.width, 1))

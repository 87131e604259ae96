"""The log: events, newest first, filtered by level and pattern."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import Level
from rsb_console.notation import formats
from rsb_console.widgets.lines import LiveLines, fit
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.model.snapshot import Event
    from rsb_console.widgets.filter import RowFilter
    from rsb_console.widgets.lines import Line

KEPT = 5000  # events; a round figure: each relisting goes through all of them
SEVERITY = {level: rank for rank, level in enumerate(Level)}
LOOK = {Level.DEBUG: "dim", Level.INFO: "", Level.WARNING: "stale", Level.ERROR: "down"}
WORD = {Level.DEBUG: "debug", Level.INFO: "info", Level.WARNING: "WARN", Level.ERROR: "ERROR"}


class LogPane(SelectableList):
    """Events, newest first. At the top it follows; further down it holds still while new ones come in.

    When the focus goes to another pane it follows again.
    """

    def __init__(self) -> None:
        super().__init__(id="log")
        self.events: deque[Event] = deque(maxlen=KEPT)
        self.level = Level.INFO
        self.pattern: RowFilter | None = None
        self._shown: dict[str, Event] = {}

    def add(self, events: Iterable[Event]) -> None:
        events = list(events)
        if events:
            self.events.extend(events)
            self.relist()

    @property
    def follows_top(self) -> bool:
        return self.position == 0

    def clear(self) -> None:
        self.events.clear()
        self.relist()

    def relist(self) -> None:
        self._shown = {str(event.number): event for event in reversed(self.events) if self._wanted(event)}
        self.show_keys(list(self._shown))
        parts = ["Log"]
        if self.level is not Level.INFO:
            parts.append("all" if self.level is Level.DEBUG else f"{WORD[self.level]}+")
        if self.pattern is not None:
            parts.append(f"/{self.pattern.text}")
        self.entitle(f" {' ▸ '.join(parts)} ")

    def _wanted(self, event: Event) -> bool:
        if SEVERITY[event.level] < SEVERITY[self.level]:
            return False
        texts = {"": plain(event), "state": WORD[event.level], "topic": event.topic, "robot": event.link}
        return self.pattern is None or self.pattern.matches(texts)

    def next_level(self) -> None:
        """Show one level less; after errors only, everything."""
        levels = list(Level)
        self.level = levels[(SEVERITY[self.level] + 1) % len(levels)]
        self.relist()

    def next_match(self, step: int) -> None:
        """Move to the next line, or without a filter to the next warning or error."""
        shown = list(self._shown.values())
        position = self.position + step
        while 0 <= position < len(shown):
            if self.pattern is not None or SEVERITY[shown[position].level] >= SEVERITY[Level.WARNING]:
                self.move_to(position)
                return
            position += step

    @property
    def selected(self) -> Event | None:
        return None if self.cursor_key is None else self._shown[self.cursor_key]

    @property
    def listed(self) -> list[Event]:
        """The events shown, oldest first."""
        return list(self._shown.values())[::-1]

    def on_blur(self) -> None:
        """Return to the newest line, except for the filter's prompt or when the terminal's window loses the focus."""
        if isinstance(self.screen.focused, LiveLines):
            self.move_to(0)

    def is_cursor(self, index: int) -> bool:
        return self.has_focus and super().is_cursor(index)

    def line(self, index: int) -> Line:
        event = self._shown[self.keys[index]]
        look = LOOK[event.level]
        whole = (
            (f" {formats.time_of_day(event.time)} ", "dim"),
            (f"{WORD[event.level]:<6}", look),
            (f"{event.source:<6} ", "dim"),
            (_named(event), "dim" if event.level is Level.DEBUG else ""),
        )
        return fit(whole, self.width)


def plain(event: Event) -> str:
    return f"{formats.time_of_day(event.time)} {WORD[event.level]:<5} {event.source:<6} {_named(event)}"


def _named(event: Event) -> str:
    return f"{event.link}: {event.text}" if event.link and not event.text.startswith(f"{event.link}: ") else event.text

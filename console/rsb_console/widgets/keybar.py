"""The last line: the most useful keys, as far as they fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.widgets.lines import LiveLines, width_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from textual import events

    from rsb_console.widgets.lines import Line


class KeyBar(LiveLines):
    """Keys and labels, in the registry's order. Those of the last two (help, quit) always fit; a click does it."""

    can_focus = False

    def __init__(self) -> None:
        super().__init__(id="keys")
        self._entries: Sequence[tuple[str, str, str]] = ()

    @property
    def line_count(self) -> int:
        return 1

    def show(self, entries: Sequence[tuple[str, str, str]]) -> None:
        """Show `entries`: key, label, and the action that a click runs; none, or at least two."""
        self._entries = entries
        self.sync()

    def line(self, index: int) -> Line:
        return tuple(piece for key, label, _ in self._fitting() for piece in _pieces(key, label))

    def _fitting(self) -> list[tuple[str, str, str]]:
        if not self._entries:
            return []
        *others, second_last, last = self._entries
        always = [second_last, last]
        room = self.width - sum(width_of(_pieces(key, label)) for key, label, _ in always)
        fitting = []
        for entry in others:
            room -= width_of(_pieces(entry[0], entry[1]))
            if room < 0:
                break
            fitting.append(entry)
        return fitting + always

    async def on_click(self, event: events.Click) -> None:
        """Do what stands under the mouse."""
        edge = 0
        for key, label, action in self._fitting():
            edge += width_of(_pieces(key, label))
            if event.x < edge:
                await self.run_action(action)
                return


def _pieces(key: str, label: str) -> tuple[tuple[str, str], ...]:
    return (f" {key}", "key"), (f" {label} ", "dim")

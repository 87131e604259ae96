"""The last line: the most useful keys, as far as they fit, and how much is wrong beside the keys that show it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_console.widgets.lines import Line, LiveLines, width_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from textual import events


class KeyEntry(NamedTuple):
    """One key.

    Attributes:
        key: as it is written for people.
        label: what it does.
        action: that a click runs.
        rank: on a narrow screen, those of a lower one come first.
        counts: stand behind the label; or in its place on a screen without room for both.
    """

    key: str
    label: str
    action: str
    rank: int
    counts: Line = ()


class KeyBar(LiveLines):
    """Keys and labels, in the registry's order; a click does it."""

    can_focus = False

    def __init__(self) -> None:
        super().__init__(id="keys")
        self._entries: Sequence[KeyEntry] = ()

    @property
    def line_count(self) -> int:
        return 1

    def show(self, entries: Sequence[KeyEntry]) -> None:
        self._entries = entries
        self.sync()

    def line(self, index: int) -> Line:
        return tuple(piece for _, pieces in self._fitting() for piece in pieces)

    def _fitting(self) -> list[tuple[KeyEntry, Line]]:
        """The entries that there is room for, as they are drawn: with label and counts if all of them fit so."""
        whole = [(entry, _pieces(entry, entry.label)) for entry in self._entries]
        if sum(width_of(pieces) for _, pieces in whole) <= self.width:
            return whole
        short = [(entry, _pieces(entry, "" if entry.counts else entry.label)) for entry in self._entries]
        room, fitting = self.width, []
        for index in sorted(range(len(short)), key=lambda index: short[index][0].rank):
            if (width := width_of(short[index][1])) <= room:
                room -= width
                fitting.append(index)
        return [short[index] for index in sorted(fitting)]

    async def on_click(self, event: events.Click) -> None:
        """Do what stands under the mouse."""
        edge = 0
        for entry, pieces in self._fitting():
            edge += width_of(pieces)
            if event.x < edge:
                await self.run_action(entry.action)
                return


def _pieces(entry: KeyEntry, label: str) -> Line:
    return ((f" {entry.key}", "key"), (f" {label}" if label else "", "dim"), *entry.counts, (" ", "dim"))

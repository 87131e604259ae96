"""Gives the terminal the newest picture of the screen at the pace of its line, what a key may have done first.

Textual writes each picture that it makes. On a slow line they queue up, and the operator sees what was, while keys
already do what will be seen later. Here the next frame is made once the last one has left, of what the screen is then.
"""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Final

from textual.geometry import Region
from textual.widgets import Button, Input, TextArea

from rsb_console.library_internals.textual_internals import ToastRack, crash
from rsb_console.terminal.screen_cells import BOX, FIRST, LAST, LINES, USUAL, ScreenCells
from rsb_console.terminal.terminal_line import TerminalLine

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from typing import Any

    from rich.color import ColorSystem
    from textual.app import App
    from textual.screen import Screen
    from textual.widget import Widget

    from rsb_console.library_internals.textual_internals import ChopsUpdate, LayoutUpdate
    from rsb_console.terminal.driver import ConsoleDriver

_LOOK_EVERY: Final = 0.02
"""s between two looks whether the next frame may be written."""
_LOOK_AT_LEAST_EVERY, _OF_WAIT = 0.2, 0.1
"""s between two looks at a line that stands still, and the part of its wait that a look may come late: with 50 looks a
second, a terminal that is stuck takes half as much of the processor again as one that reads."""
_EFFECT_WITHIN, _NEXT_KEY_AFTER = 0.5, 1.0
"""s after a key in which a slow line carries the top screen alone: until the key's effect is made, and carried. And s
without a key after which the next one is new: else repeats of a held one hold pictures back. Round figures."""
_HEADER: Final = 2
"""Rows at the top, which tell whether something is armed, and how late the line is."""


class NoTerminal:
    """In the place of a writer where no terminal is, as in tests.

    Attributes:
        line: carries all.
    """

    late, is_free, line = 0.0, True, TerminalLine(rate=float("inf"))

    def use_colours(self, colours: ColorSystem) -> None:
        """Do nothing."""

    def forget(self, region: Region | None = None) -> None:
        """Do nothing."""

    def expect_effect(self) -> None:
        """Do nothing."""

    def has(self, region: Region) -> bool:
        """Whether the terminal has a region: nothing waits."""
        return True


class ScreenWriter:
    """Writes the screen of one app to its terminal.

    Attributes:
        line: the bytes in flight to it.

    Args:
        pictures: widgets whose content comes after all else.
        written: called with where text was written.
    """

    def __init__(
        self,
        app: App[Any],
        driver: ConsoleDriver,
        colours: ColorSystem,
        pictures: Collection[Widget],
        written: Callable[[Sequence[tuple[int, int, int]]], None],
    ) -> None:
        self._app = app
        self._driver, self.line = driver, driver.line
        self._pictures = pictures
        self._written = written
        self._cells = ScreenCells(colours)
        self._losses = driver.losses
        self._next: asyncio.TimerHandle | None = None
        self._lacking_since: float | None = None
        self._gave_at = time.monotonic()
        self._cursor = (0, 0)
        self._top: Screen[Any] | None = None
        self._key_at = self._rest_waits_until = float("-inf")
        self._only_rest_waits = False
        """Whether the terminal lacks only what waits until then."""

    def use_colours(self, colours: ColorSystem) -> None:
        """Write in other colours from now on."""
        self._cells.colours = colours

    def forget(self, region: Region | None = None) -> None:
        """Note that the terminal may show anything, or does so in a region: it is written again."""
        self._cells.forget(region)
        if self._next is None:
            self._look_in(_LOOK_EVERY)

    def expect_effect(self) -> None:
        """Give what a key does before all else, from its top on."""
        now = time.monotonic()
        if now - self._key_at > _NEXT_KEY_AFTER:
            self._rest_waits_until = now + _EFFECT_WITHIN
            self._cells.begin_at_top()
        self._key_at = now

    def draw(self, update: ChopsUpdate | LayoutUpdate) -> None:
        """Take what Textual has drawn, and write it as soon as the line allows."""
        self._cells.resize(self._app.size)
        self._cells.draw(update)
        if self._next is not None and self._only_rest_waits:
            self._next.cancel()
            self._next = None
        if self._next is None:
            self.give()

    def give(self) -> None:
        """Write what the terminal lacks, if its line is free, or else soon."""
        self._next = None
        if self._losses != self._driver.losses:
            self._losses = self._driver.losses
            self._cells.forget()
        if self._driver.is_free:
            self._gave_at = time.monotonic()
            stack = self._app.screen_stack
            if (top := stack[-1] if stack else None) is not self._top:  # while the app ends there is none
                self._top = top
                self._cells.begin_at_top()
            self._cells.erases = self._driver.erases
            # Above the first screen, a box: what is below only becomes dim, or is a picture.
            rest_waits = len(stack) > 1 and self._gave_at < self._rest_waits_until
            if rest_waits and not any(each.region for each in stack[-1].children if not isinstance(each, ToastRack)):
                # The box has no place yet; its screen has only made all below it dim.
                self._only_rest_waits = True
                self._look_in(self._rest_waits_until - self._gave_at)
                return
            frame = self._cells.next(self.line.most, [*self._ranks()], rest_waits=rest_waits)
            self._write(frame.text, frame.spans)
            self._only_rest_waits = rest_waits and frame.lacks is not None and frame.lacks > LINES
            if frame.lacks is None or frame.lacks == LAST or self._only_rest_waits:
                self._lacking_since = None
            if frame.lacks is None:
                return
            if self._only_rest_waits:
                self._look_in(self._rest_waits_until - self._gave_at)
                return
        if self._lacking_since is None:
            self._lacking_since = time.monotonic()
        wait = (time.monotonic() - self._gave_at) * _OF_WAIT
        self._look_in(max(_LOOK_EVERY, min(wait, _LOOK_AT_LEAST_EVERY)))

    def _look_in(self, seconds: float) -> None:
        # Textual's timer skips its only call if this process gets no processor for so long at its start.
        self._next = asyncio.get_running_loop().call_later(seconds, self._look)

    def _look(self) -> None:
        try:
            self.give()
        except Exception as error:  # noqa: BLE001 -- a crash of the app, as in its own handlers
            crash(self._app, error)

    def _write(self, text: str, spans: Sequence[tuple[int, int, int]]) -> None:
        if isinstance(self._app.focused, Input | TextArea):
            # The cursor is hidden, but some terminals show there what an input method composes.
            x, y = self._app.cursor_position
            text += f"\x1b[{y + 1};{x + 1}H" if text or (x, y) != self._cursor else ""
            self._cursor = x, y
        if text:
            self._driver.write_frame(text, whole=len(spans) > 1)
            self._written(spans)

    def _ranks(self) -> Iterator[tuple[Region, int]]:
        for screen in reversed(self._app.screen_stack):
            yield from (
                (each.content_region, LAST) for each in self._pictures if each.is_attached and each.screen is screen
            )
            if screen is self._app.screen_stack[0]:
                continue
            boxes = [each.region for each in screen.children if not isinstance(each, ToastRack)]
            if screen is self._app.screen:
                # The title, and the answers to a question: with its first part alone an operator knows what is asked.
                if answers := [each.region for each in screen.query(Button)]:
                    yield Region.from_union(answers), FIRST
                yield from ((Region(x, y, width, 1), FIRST) for x, y, width, _ in boxes)
                yield from ((each, BOX) for each in boxes)
            else:
                yield from ((each, USUAL) for each in boxes)  # they only become dim
        yield Region(0, 0, self._app.size.width, _HEADER), LINES

    def has(self, region: Region) -> bool:
        """Whether the terminal was given all of a region; if no answer will show that it has it, the line is free."""
        return not self._cells.lacks(region) and (self.line.answers or self._driver.is_free)

    @property
    def is_free(self) -> bool:
        """Whether pictures in pixels may be written: nothing else waits, and the terminal is known."""
        return self._next is None and self._driver.is_free and self._driver.knows_terminal

    @property
    def late(self) -> float:
        """Seconds by which the terminal's picture is older than the screen, as far as is known, except for pictures."""
        since = self._lacking_since
        return max(self._driver.late, 0.0 if since is None else time.monotonic() - since)

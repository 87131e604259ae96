"""Draws one picture on the screen: rows of characters, or an image in the terminal's pixels.

Pixels and boxes stand side by side: bands of an image on which something else stands, such as a message or a
question, are in characters meanwhile.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any, cast

from rich.segment import Segment
from rich.style import Style
from textual.content import Content
from textual.geometry import Region
from textual.message import Message as TextualMessage
from textual.strip import Strip
from textual.widget import Widget

from rsb_console.feature_console import FullScreen
from rsb_console.library_internals.textual_internals import Toast, ToastRack, entitle
from rsb_console.widgets.lines import LOOK_CLASSES, yield_gil
from rsb_extras.pictures.cell_image import Inks
from rsb_extras.pictures.graphics import USUAL_CELL, Extent, Painter, bands_of, frame_of
from rsb_extras.pictures.paper import Paper

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from textual.events import Click

    from rsb_console.feature_console import TerminalApp
    from rsb_console.terminal.terminal_facts import TerminalFacts
    from rsb_extras.pictures.graphics import Band
    from rsb_extras.pictures.paper import Rgb
    from rsb_extras.pictures.picture import Pixels, Wish
    from rsb_extras.pictures.picture_rows import Row

_LOOKS = {
    "dim": "dim", "strong": "strong", "axis": "dim", "ok": "ok", "warning": "stale", "error": "down",
    "robot": "ok", "path": "key", "curve": "plot", "free": "dim", "goal": "stale", "lethal": "down",
}  # fmt: skip
"""The theme's look of each style of a picture that has another name there."""
_TRIES, _LOOK_EVERY = 100, 0.02
"""Looks whether a terminal that lags has the picture, 2 s in all, and s between them. Round figures."""
IMAGE_WITHIN = 2.0
"""s of the line that an image in pixels may take. Nothing overtakes it: neither a key's effect nor what the robot does.
A line that is faster than known shows a coarser image first, which tells its rate."""
_COVERED_EVERY = 0.1
"""s between two looks for what stands on an image: a message that comes is hidden for so long at most."""


class PicturePane(Widget, can_focus=True):
    """Shows a picture, with a title and keys on its frame."""

    def __init__(self) -> None:
        super().__init__(classes="dialog -whole")
        self._rows: list[Row] = []
        self._strips: dict[int, Strip] = {}
        self._title = ""
        self._styles: dict[tuple[str, str], Style] = {}
        self._bands: list[Band] = []
        self._frame = Extent(0, 0, 0.0, 0.0)
        self._painter: Painter | None = None
        self._covered: frozenset[int] = frozenset()
        """Rows of the image that are in characters."""
        self._under_boxes: frozenset[int] = frozenset()
        """Rows on which something stood at the last look."""
        self._losses = 0
        self._owes = False
        """Whether the newest image waits for the terminal."""
        self.image_bytes = 0
        """Bytes of the newest image that the terminal lacked, without what was under boxes."""
        self.whole_bytes = 0
        """Bytes of all of the newest image."""
        self.is_left_out = False
        """Whether it was too large for the line, so that the one before stays in sight."""

    class Clicked(TextualMessage):
        """A cell was clicked."""

        def __init__(self, column: int, row: int) -> None:
            super().__init__()
            self.column, self.row = column, row

    @property
    def terminal(self) -> TerminalApp[Any]:
        return cast("TerminalApp[Any]", self.app)

    def on_mount(self) -> None:
        self.set_interval(_COVERED_EVERY, self._paint)
        self.terminal.text_drawn.subscribe(self, self._drawn_over, immediate=True)
        self.terminal.terminal_changed.subscribe(self, self._suit_terminal, immediate=True)
        self.terminal.pictures.add(self)

    def on_unmount(self) -> None:
        self.terminal.pictures.discard(self)
        self.take_image_away()

    def on_resize(self) -> None:
        self.take_image_away()  # it has the former size

    def on_click(self, event: Click) -> None:
        offset = event.get_content_offset(self)
        if offset is not None:
            self.post_message(self.Clicked(offset.x, offset.y))

    def show(self, rows: list[Row]) -> None:
        """Show rows of characters; only those that differ are drawn."""
        yield_gil()
        self.take_image_away()
        self.is_left_out = False
        self._show_rows(rows)

    async def show_image(
        self, image: Pixels, wish: Wish, blocks: Callable[[], list[Row]], *, few_colours: bool = False
    ) -> None:
        """Show an image in pixels, unless it would take the line too long.

        Args:
            wish: gives the area and the shape of its cells.
            blocks: gives the image in characters, on a thread.
            few_colours: whether bytes to the terminal are dear (`bands_of`).

        Raises:
            UnreadableError: the other side's image is damaged.
        """
        bands, frame, covered = await self.cut(image, wish, few_colours=few_colours)
        self.is_left_out = self.image_bytes > IMAGE_WITHIN * self.terminal.writer.line.rate
        if self.is_left_out:
            return
        self._bands, self._frame, self._owes = bands, frame, True
        self._covered = self._under_boxes = covered
        hidden = {row for band in self._bands if band.is_under(self._covered) for row in band.range}
        rows = await asyncio.to_thread(blocks) if hidden else []
        # Characters below pixels would be sent for nothing, and sixels once more, as they go with characters on them.
        self._show_rows([row if y in hidden else () for y, row in enumerate(rows)])
        self.call_after_refresh(self._paint)

    async def cut(self, image: Pixels, wish: Wish, *, few_colours: bool) -> tuple[list[Band], Extent, frozenset[int]]:
        """Cut an image into bands, and measure them; return them, their place, and the rows of it under boxes.

        Raises:
            UnreadableError: the other side's image is damaged.
        """
        facts = self.terminal.facts
        painter = self._painter = self._painter or Painter(facts.pixels)
        cell, paper, before = facts.cell or USUAL_CELL, self._paper.background, self._bands
        frame, first_id = frame_of(image, wish), painter.first_id
        make = partial(bands_of, image, frame, cell, facts.pixels, first_id, paper, before, few_colours=few_colours)
        bands = await asyncio.to_thread(make)
        covered = self._rows_under_boxes(frame)
        lacking = (each for each in painter.lacking(bands) if not each.is_under(covered))
        self.image_bytes = sum(len(each.sequence) for each in lacking)
        self.whole_bytes = sum(len(each.sequence) for each in bands)
        return bands, frame, covered

    def _suit_terminal(self, facts: TerminalFacts) -> None:
        """Forget the image if the terminal is another one, which has none of it."""
        if self._painter is not None and self._painter.protocol != facts.pixels:
            self._painter, self._bands, self._owes = None, [], False

    def _show_rows(self, rows: list[Row]) -> None:
        before, self._rows = self._rows, rows
        changed = [y for y in range(max(len(before), len(rows))) if before[y : y + 1] != rows[y : y + 1]]
        for y in changed:
            self._strips.pop(y, None)
        for first, last in _runs(changed):
            self.refresh(Region(0, first, self.size.width, last - first + 1))

    # -- pixels -------------------------------------------------------------------------------------------------------

    def _paint(self) -> None:
        """Send what the terminal lacks of the image, but nothing on boxes: Textual would not draw them again."""
        if self._painter is None or not self._bands or not self.is_attached:
            return
        if not self.terminal.writer.is_free:
            return  # it is called again in a moment
        under_boxes = self._rows_under_boxes(self._frame)
        # Where a box has gone, `show_image` first looks whether the line can take what was under it.
        self._covered |= under_boxes
        if under_boxes != self._under_boxes:
            self._under_boxes = under_boxes
            self.show_again()
        if self._losses != self.terminal.losses:
            self._losses = self.terminal.losses
            self._painter.lost()
        at = self.content_region.offset
        if lifted := self._painter.lifted(self._bands, (at.x, at.y), self._covered):
            self._draw_text(lifted)
            return
        sequence = self._painter.painted(self._bands, (at.x, at.y), self._covered)
        self.terminal.write_to_terminal(sequence)
        self._owes = False

    def _drawn_over(self, spans: Sequence[tuple[int, int, int]]) -> None:
        """Send the image again where text was drawn: for a box on the screen, Textual often draws all that is below."""
        if self._painter is None or not self._bands:
            return
        image = self._region_of(self._frame)
        rows = {y - image.y for y, left, right in spans if image.overlaps(Region(left, y, right - left, 1))}
        if rows:
            self._painter.overwritten(rows)
            self._paint()

    async def is_taken(self) -> bool:
        """Wait until the terminal has the picture, but not for long; return whether it has."""
        for _try in range(_TRIES):
            await asyncio.sleep(_LOOK_EVERY)
            if not self._owes and self.terminal.writer.is_free:
                return not self.is_left_out
        return False

    def take_image_away(self) -> None:
        self._bands, self._owes = [], False
        if self._painter is not None:
            self._draw_text(self._painter.lifted((), (0, 0), ()))
            self.terminal.write_to_terminal(self._painter.taken_away())

    def _draw_text(self, regions: Sequence[Region]) -> None:
        for region in regions:
            self.terminal.writer.forget(region)

    def show_again(self) -> object:
        """Called when other rows of an image are covered: it is to be shown again, with characters there."""

    def _rows_under_boxes(self, frame: Extent) -> frozenset[int]:
        """Return the rows of an image on which something else stands."""
        if not self.display or self.screen not in self.app.screen_stack:
            return frozenset(range(frame.rows))
        image = self._region_of(frame)
        # A box beside it has an intersection, too, which is as high as both, and 0 wide.
        boxes = filter(image.overlaps, self._boxes())
        return frozenset(y - image.y for box in boxes for y in image.intersection(box).line_range)

    def _region_of(self, frame: Extent) -> Region:
        return Region(*self.content_region.offset, frame.columns, frame.rows)

    def _boxes(self) -> Iterator[Region]:
        stack = self.app.screen_stack
        for screen in stack[stack.index(self.screen) :]:
            yield from (toast.region for toast in screen.query(Toast))
            if screen is not self.screen:
                if isinstance(screen, FullScreen):
                    yield screen.region
                yield from (each.region for each in screen.children if not isinstance(each, ToastRack))

    # -- characters ---------------------------------------------------------------------------------------------------

    def entitle(self, title: str) -> None:
        """Show a title, which is plain text, and draw only its line."""
        if title == self._title:
            return
        self._title = title
        if self.is_mounted:
            entitle(self, Content(title))
            self.refresh(Region(0, -1, self.size.width, 1))
        else:
            self.border_title = Content(title)

    def notify_style_update(self) -> None:
        self._styles.clear()
        self._strips.clear()
        super().notify_style_update()

    def render_line(self, y: int) -> Strip:
        """Draw screen row `y` (Textual's line API)."""
        strip = self._strips.get(y)
        if strip is None or strip.cell_length != self.size.width:
            row = self._rows[y] if y < len(self._rows) else ()
            strip = Strip([Segment(part.text, self._style(part.style, part.background)) for part in row])
            strip = self._strips[y] = strip.adjust_cell_length(self.size.width, self.visual_style.rich_style)
        return strip

    @property
    def _paper(self) -> Paper:
        own = self.visual_style
        assert own.background is not None
        assert own.foreground is not None
        return Paper(own.background.rgb, own.foreground.rgb)

    def inks(self, styles: Iterable[str], cell: tuple[float, float]) -> Inks:
        """Return the colours of these styles, for characters of so many pixels."""
        paper = self._paper
        return Inks(paper, {name: self._ink(name, paper) for name in styles}, cell)

    def _ink(self, name: str, paper: Paper) -> Rgb:
        style = self._style(name, "")
        colour = style.color
        ink = paper.foreground if colour is None or colour.is_default else colour.get_truecolor()
        if not style.dim:
            return ink[0], ink[1], ink[2]
        red, green, blue = ((own + each) // 2 for own, each in zip(paper.background, ink, strict=True))
        return red, green, blue

    def _style(self, name: str, background: str) -> Style:
        key = name, background
        style = self._styles.get(key)
        if style is None:
            if len(self._styles) > 20_000:  # each pixel of an image may have colours of its own
                self._styles.clear()
            style = self.visual_style.rich_style
            if not background or background.startswith("@"):  # a character's colour, not an image's
                name, background = self._paper.ink(name) or name, self._paper.colour(background[1:])
            if name.startswith("@"):
                name = self._paper.colour(name[1:]) or self._paper.own
            is_colour = name.startswith(("#", "color("))
            if background or is_colour:
                style += Style(color=name if is_colour else None, bgcolor=background or None)
            if (look := _LOOKS.get(name, name)) in LOOK_CLASSES:
                style += self.app.get_component_styles(LOOK_CLASSES[look]).partial_rich_style
            self._styles[key] = style
        return style


def _runs(numbers: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Yield the first and the last of numbers that follow each other."""
    first = last = None
    for number in numbers:
        if first is None or last is None or number != last + 1:
            if first is not None and last is not None:
                yield first, last
            first = number
        last = number
    if first is not None and last is not None:
        yield first, last

"""A view of styled lines that redraws only what has changed: the base of every live pane."""

from __future__ import annotations

import textwrap
import time
from typing import TYPE_CHECKING, ClassVar, Self

from rich.cells import cell_len
from rich.segment import Segment
from textual.binding import Binding
from textual.content import Content
from textual.geometry import Region, Size
from textual.scroll_view import ScrollView
from textual.strip import Strip

from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rich.style import Style

Line = tuple[tuple[str, str], ...]
"""Pieces of one line: text, and the name of its look (one of `LOOKS`, or empty for the pane's own)."""

BREATH = 0.5e-3
"""s that a pane sleeps before it is drawn: see `yield_gil`."""

LOOKS = (*(state.value for state in State), "dim", "strong", "armed", "key", "head", "alarm", "plot")
LOOK_CLASSES = {look: f"line--{look}" for look in LOOKS}
"""The CSS component class of each look. The app has them, not each pane: whenever the classes or the focus of a node
change, Textual styles all component classes of that node, which took a fifth of the console's time."""


class LiveLines(ScrollView):
    """Lines drawn on demand: makes only the lines on screen, and writes only what differs from the last picture.

    A subclass counts the lines (`line_count`) and makes each (`line`); after its data changed it calls `sync`. The
    first `sticky` lines stay at the top while the rest scrolls.

    Attributes:
        width: cells; asking Textual's `size` for each line costs too much.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = {"line--cursor"}
    sticky = 0

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:  # noqa: A002 -- Textual's name
        super().__init__(id=id, classes=classes)
        self._drawn: dict[int, tuple[Line, bool]] = {}
        self._finished: tuple[Region, list[Strip]] | None = None
        self._looks: dict[tuple[str, bool], Style] = {}
        self._title = ""
        self.width = self._top = 0

    @property
    def line_count(self) -> int:
        """Number of lines, including the sticky ones."""
        raise NotImplementedError

    def line(self, index: int) -> Line:
        """Make line number `index` for the present width."""
        raise NotImplementedError

    def is_cursor(self, index: int) -> bool:
        """Whether line `index` is to be drawn as the one under the cursor."""
        return False

    def index_at(self, y: int) -> int:
        """Return the line at screen row `y` of this pane."""
        return y if y < self.sticky else y + self._top

    def sync(self) -> None:
        """Redraw the lines that differ from the screen."""
        yield_gil()
        self.measure_lines()
        self._measure()
        width = self.width
        for y, (old, was_cursor) in self._drawn.items():
            new, cursor = self._make(y)
            if cursor != was_cursor:
                self.refresh(Region(0, y, width, 1))
            elif new != old:
                self.refresh(Region(0, y, changed_width(old, new, width), 1))

    def measure_lines(self) -> None:
        """Set the scrollable height to that of all lines."""
        size = Size(0, self.line_count)  # no width: lines are cut, not scrolled sideways
        if size != self.virtual_size:
            self.virtual_size = size

    def _measure(self) -> None:
        # Without the scrollbar, which would hide the end of each line.
        self.width, self._top = self.scrollable_content_region.width, round(self.scroll_offset.y)

    def _make(self, y: int) -> tuple[Line, bool]:
        index = self.index_at(y)
        # Rows that were drawn before the list became shorter.
        if index >= self.line_count:
            return (), False
        return self.line(index), self.is_cursor(index)

    def refresh(self, *regions: Region, repaint: bool = True, layout: bool = False, recompose: bool = False) -> Self:
        self._finished = None
        return super().refresh(*regions, repaint=repaint, layout=layout, recompose=recompose)

    def notify_style_update(self) -> None:
        self._looks.clear()
        super().notify_style_update()

    def render_lines(self, crop: Region) -> list[Strip]:
        """Draw the lines in `crop` (Textual's line API), which asks all panes whenever one of them has changed."""
        if self._finished is None or self._finished[0] != crop:
            yield_gil()
            self._measure()
            self._finished = crop, super().render_lines(crop)
        return self._finished[1]

    def render_line(self, y: int) -> Strip:
        made, cursor = self._drawn[y] = self._make(y)
        strip = Strip([Segment(text, self._style(look, cursor=cursor)) for text, look in made])
        return strip.adjust_cell_length(self.width, self._style("", cursor=cursor)).simplify()

    def _style(self, look: str, *, cursor: bool) -> Style:
        style = self._looks.get((look, cursor))
        if style is None:  # Textual's own cache of these ends with every refresh
            style = self.get_component_rich_style("line--cursor") if cursor else self.visual_style.rich_style
            if look:
                style += self.app.get_component_styles(LOOK_CLASSES[look]).partial_rich_style
            self._looks[look, cursor] = style
        return style

    def entitle(self, title: str) -> None:
        """Set the title on the border; Textual would redraw the pane even for the same one."""
        if title != self._title:
            self._title = title
            self.border_title = Content(title)

    def on_resize(self) -> None:
        self._drawn.clear()
        self.refresh()
        self.sync()


def yield_gil() -> None:
    """Release the interpreter lock, so that the bridge's threads run before a pane is drawn.

    A thread that only computes keeps the lock for 5 ms, unless it sleeps. A shorter interval
    (`sys.setswitchinterval`) costs the bridge more than it gains: bench/README.md has the figures.
    """
    time.sleep(BREATH)


def changed_width(old: Line, new: Line, width: int) -> int:
    """Return how many cells from the left edge two lines differ; Textual draws from a pane's left edge anyway."""
    cells = width_of(new)
    if width_of(old) != cells:
        return width
    for before, after in zip(reversed(old), reversed(new), strict=False):
        if before != after:
            break
        cells -= cell_len(after[0])
    return max(1, cells)


def width_of(line: Line) -> int:
    return sum(cell_len(text) for text, _ in line)


def fit(line: Line, width: int) -> Line:
    """Cut `line` to `width` cells, with an ellipsis in place of the missing part."""
    if width_of(line) <= width:
        return line
    kept: list[tuple[str, str]] = []
    room = width - 1
    for text, look in line:
        piece = clip(text, room)
        kept.append((piece, look))
        room -= cell_len(piece)
        if room <= 0 or piece != text:
            break
    return (*kept, ("…", kept[-1][1]))


def wrapped(text: str, width: int, look: str = "") -> Iterator[Line]:
    """Yield the lines of a text that is broken at `width` cells, all but the first indented."""
    for line in textwrap.wrap(text, max(20, width), subsequent_indent="  ") or [""]:
        yield ((line, look),)


def fit_middle(text: str, width: int) -> str:
    """Cut `text` to `width` cells in its middle: names that begin alike often differ at their ends."""
    if cell_len(text) <= width:
        return text
    tail = clip(text[::-1], (width - 1) // 2)[::-1]
    return f"{clip(text, width - 1 - cell_len(tail))}…{tail}"


def clip(text: str, width: int) -> str:
    """Return the start of `text` that fits into `width` cells."""
    if text.isascii():
        return text[: max(0, width)]
    while cell_len(text) > max(0, width):
        text = text[:-1]
    return text


class FixedLines(LiveLines, can_focus=False):
    """Lines that are replaced as a whole, each cut to the pane's width."""

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:  # noqa: A002 -- Textual's name
        super().__init__(id=id, classes=classes)
        self._lines: Sequence[Line] = ()

    @property
    def line_count(self) -> int:
        return len(self._lines)

    def line(self, index: int) -> Line:
        return fit(self._lines[index], self.width)

    def put(self, lines: Sequence[Line]) -> None:
        """Show other lines, in a pane that is as high as they are many; without any, its margin goes, too."""
        self._lines = lines
        self.display = bool(lines)
        self.styles.height = len(lines)
        self.sync()


class ScrolledLines(FixedLines, can_focus=True):
    """Lines that an operator scrolls."""

    BINDINGS: ClassVar = [
        Binding("j", "scroll_down", show=False),
        Binding("k", "scroll_up", show=False),
        Binding("g", "scroll_home", show=False),
        Binding("G", "scroll_end", show=False),
    ]

    def show(self, lines: Iterable[Line]) -> None:
        width = self.scrollable_content_region.width
        self._lines = [fit(line, width) for line in lines]
        self.sync()

"""What a terminal has of the screen, cell by cell, and the shortest text that gives it what it lacks.

Textual draws each region that was touched, whether its characters differ or not. Over a slow line that is most of what
is sent; so what Textual draws is kept here, and only cells that differ from the terminal's are written.

Source of the sequences: ECMA-48 (CUP, CUF, CUD, ECH, SGR).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import groupby, islice, pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

from rich.cells import get_character_cell_size, split_graphemes
from textual.geometry import Region

from rsb_console.library_internals.rich_internals import attributes_of
from rsb_console.library_internals.textual_internals import ChopsUpdate, LayoutUpdate

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rich.color import ColorSystem
    from rich.style import Style
    from textual.geometry import Size
    from textual.strip import Strip

_ATTRIBUTES: Final = ("1", "2", "3", "4", "5", "6", "7", "8", "9", "21", "51", "52", "53")
"""SGR's code of each attribute of `rich.style.Style`, from its lowest bit."""
_SEEN_ON_BLANKS: Final = frozenset({"4", "7", "9", "21", "51", "52", "53"})
"""The attributes that show where no character is."""
_OWN_INK, _OWN_PAPER = "39", "49"
_JUMP: Final = 6
"""Cells that are written again rather than jumped over: a sequence that jumps is as long."""
_PLACE, _LOOK = 8, 38
"""Bytes of a sequence that moves the cursor, and of one that sets two colours of 24 bits."""
_ERASED: Final = 12
"""Blank cells from which on a sequence that erases them, and one that jumps over them, are shorter."""
_ERASE_TWO, _LAST_OF_PLANE_0 = "\x1b[2X", 0xFFFF
"""Written before emoji: a terminal that takes them for narrow would leave the second cell as it was."""
FIRST, BOX, LINES, USUAL, LAST = range(5)
"""What is written before what: the words that tell what a key has done, the rest of its box, the lines around it, the
rest of the screen, and pictures."""
_DRAWS_LINES: Final = ("\u2500", "\u257f")
"""The first and the last of Unicode's box drawings, of three bytes each."""
_TOP: Final = (FIRST, 0, 0)
"""The rank, row and column with which a frame begins, unless the one before was cut short."""


class CellLook(NamedTuple):
    """The look of a cell as SGR's parameters; of a blank one, the ink is an empty string.

    Attributes:
        attributes: such as ``1;7``.
        ink: colour of the character.
        paper: colour behind it.
    """

    attributes: str
    ink: str
    paper: str

    @property
    def marks_blanks(self) -> bool:
        """Whether more of it than the paper is seen where no character is."""
        return not _SEEN_ON_BLANKS.isdisjoint(self.attributes.split(";"))


_OWN: Final = CellLook("", _OWN_INK, _OWN_PAPER)
"""The terminal's own look."""


class Cell(NamedTuple):
    """A cell of the screen.

    Attributes:
        text: the character, or an empty string behind a wide one.
        look: its look.
    """

    text: str
    look: CellLook


class CellRun(NamedTuple):
    """Neighbouring cells in one row, in which the terminal lacks something.

    Attributes:
        look: of all of them; of a picture's, only the last one's.
        blanks: whether they are made blank, until what they lack comes.
    """

    rank: int
    row: int
    left: int
    right: int
    look: CellLook
    blanks: bool = False


class ScreenFrame(NamedTuple):
    """A text that brings the terminal nearer to the screen.

    Attributes:
        text: to be written, or empty if the terminal lacks nothing.
        spans: where it writes: row, first column, and the column behind the last one.
        lacks: the rank of what comes next, or None if the terminal lacks nothing after it.
    """

    text: str
    spans: Sequence[tuple[int, int, int]]
    lacks: int | None


class ScreenCells:
    """The screen as Textual drew it last, and as the terminal has it.

    Args:
        colours: the terminal's colours.

    Attributes:
        erases: whether the terminal gives cells that it erases the present paper.
    """

    def __init__(self, colours: ColorSystem) -> None:
        self.colours = colours
        self.erases = False
        self._wanted: list[list[Cell]] = []
        self._shown: list[list[Cell | None]] = []
        self._texts: list[list[bool]] = []
        """Whether the terminal's cells were written as text: not as a picture's."""
        self._changed: set[int] = set()
        self._begin_at = _TOP
        """The rank, row and column with which the next frame begins: where the last one ended, if it was cut short."""
        self._look: CellLook | None = None
        """The look in which the last frame left the terminal, or None if it may have another one."""

    def resize(self, size: Size) -> None:
        """Take the screen's size; what the terminal has in another size is not known."""
        if (size.height, size.width) != (len(self._wanted), len(self._wanted[0]) if self._wanted else 0):
            self._wanted = [[_blank(_OWN)] * size.width for _ in range(size.height)]
            self._shown = [[None] * size.width for _ in range(size.height)]
            self._texts = [[False] * size.width for _ in range(size.height)]
            self._changed = set(range(size.height))
            self._begin_at = _TOP

    def forget(self, region: Region | None = None) -> None:
        """Note that the terminal may show anything in any look, or that a region may show anything."""
        if region is None:
            self._look = None
        region = region or Region(0, 0, len(self._wanted[0]) if self._wanted else 0, len(self._wanted))
        for y in region.line_range:
            if y < len(self._shown):
                columns = slice(region.x, region.right)
                self._shown[y][columns] = [None] * len(self._shown[y][columns])
                self._changed.add(y)

    def draw(self, update: ChopsUpdate | LayoutUpdate) -> None:
        """Take what Textual has drawn."""
        if isinstance(update, LayoutUpdate):
            for y, strips in enumerate(update.strips, update.region.y):
                self._put(y, update.region.x, strips)
            return
        for y, left, right in update.spans:
            for end, (x, strip) in zip(update.chop_ends[y], update.chops[y].items(), strict=False):
                # Outside the span, Textual draws widgets that others cover.
                if strip is not None and x <= right and end > left:
                    self._put(y, x, (strip if end <= right else strip.crop(0, right - x),))

    def _put(self, y: int, x: int, strips: Iterable[Strip]) -> None:
        if y >= len(self._wanted):
            return
        row, width = self._wanted[y], len(self._wanted[y])
        if 0 < x < width and not row[x].text:  # half of a wide character stays
            row[x - 1] = _blank(row[x].look)
        for strip in strips:
            for text, style, _ in strip:
                cells = _cells(text, _look(style, self.colours))[: max(0, width - x)]
                row[x : x + len(cells)] = cells
                x += len(cells)
        if x < width and not row[x].text:
            row[x] = _blank(row[x].look)
        self._changed.add(y)

    def lacks(self, region: Region) -> bool:
        """Whether the terminal was not yet given all of a region."""
        columns = slice(region.x, region.right)
        return any(self._wanted[y][columns] != self._shown[y][columns] for y in region.line_range if y in self._changed)

    def begin_at_top(self) -> None:
        """Begin the next frame with the first row, wherever the last one ended: there is something new to read."""
        self._begin_at = _TOP

    def next(self, most: float, ranks: Sequence[tuple[Region, int]] = (), *, rest_waits: bool = False) -> ScreenFrame:
        """Return the next frame, and count it as shown.

        Args:
            most: bytes, with which it ends once it has something.
            ranks: regions that come before or after what is `USUAL`; the first that has a cell counts.
            rest_waits: whether what comes after `LINES` is left for later, unless all fits into the frame.
        """
        self._changed = {y for y in self._changed if self._wanted[y] != self._shown[y]}

        pen, spans, doubted = _Pen(most, self._look, erases=self.erases), [], set()
        runs = [*self._runs(ranks)]
        pictures, waiting = [region for region, rank in ranks if rank == LAST], []
        if (pictures or rest_waits) and self._size(runs) > most:
            waiting = [run for run in runs if run.rank > LINES] if rest_waits else []
            runs += self._remains(runs, pictures)
        if waiting:
            runs = [run for run in runs if run.rank <= LINES]
        for run in self._in_order(runs, most):
            row = [_blank(run.look)] * run.right if run.blanks else self._wanted[run.row]
            written = pen.write(row, run)
            self._look = pen.look
            self._shown[run.row][run.left : written] = cells = row[run.left : written]
            self._texts[run.row][run.left : written] = [run.rank != LAST and not run.blanks] * len(cells)
            if (more := _more_cells(cells)) and written < len(self._wanted[run.row]):
                self.forget(Region(written, run.row, more, 1))
                doubted.add(run.row)
            if written > run.left:
                spans.append((run.row, run.left, written))
            if written < run.right:
                self._begin_at = run.rank, run.row, written
                return ScreenFrame(pen.text, spans, run.rank)
        self._begin_at = _TOP
        if waiting:
            return ScreenFrame(pen.text, spans, min(run.rank for run in waiting))
        self._changed = doubted
        return ScreenFrame(pen.text, spans, USUAL if doubted else None)

    def _remains(self, runs: Sequence[CellRun], pictures: Sequence[Region]) -> Iterator[CellRun]:
        """Yield texts in the place of a picture that will take long, such as a question that was answered."""
        for _, y, left, right, _, _ in filter(lambda run: run.rank == LAST, runs):
            # A wide character before a picture begins a run outside of it.
            edge = next((each.x for each in pictures if each.contains(left, y)), left) - 1
            look = CellLook("", "", self._wanted[y][edge].look.paper if edge >= 0 else _OWN_PAPER)
            remains = (is_text and self._shown[y][x] != _blank(look) for x, is_text in enumerate(self._texts[y]))
            begin = left
            for are, cells in groupby(islice(remains, left, right)):
                end = begin + len([*cells])
                if are:
                    yield CellRun(LINES, y, begin, end, look, blanks=True)
                begin = end

    def _size(self, runs: Sequence[CellRun]) -> int:
        """Return the bytes of runs, about, if they are written look by look; each cell of a picture has its own."""
        looks = {self._look, *(run.look for run in runs if run.rank != LAST)}
        cells = sum((run.right - run.left) * (_LOOK if run.rank == LAST else 1) for run in runs)
        return cells + _PLACE * len(runs) + _LOOK * len(looks)

    def _in_order(self, runs: list[CellRun], most: float) -> list[CellRun]:
        """Sort runs by rank from where the last frame ended, or look by look if they fit into one frame.

        A row of a table has several looks, and a column one: a sequence that gives colours is longer than one that
        moves. Pictures stay behind all else, row by row, as cells of theirs rarely share a look.
        """
        looks = [*dict.fromkeys((self._look, *(run.look for run in runs if run.rank != LAST)))]
        if self._begin_at == _TOP and self._size(runs) <= most:
            places = {look: place for place, look in enumerate(looks)}
            return sorted(
                runs, key=lambda run: (len(looks) if run.rank == LAST else places[run.look], run.row, run.left)
            )
        return sorted(
            runs, key=lambda run: (run.rank, (run.rank, run.row, run.left) < self._begin_at, run.row, run.left)
        )

    def _runs(self, ranks: Sequence[tuple[Region, int]]) -> Iterator[CellRun]:
        for y in self._changed:
            wanted, shown = self._wanted[y], self._shown[y]
            _, row, column = self._begin_at
            edges = {0, len(wanted), *([column] if y == row else [])}
            for left, right, rank in _ranked(y, edges, ranks):
                for begin, end, look in _differing(wanted, shown, left, right, mixed=rank == LAST):
                    yield CellRun(_rank_of(wanted[begin:end], rank), y, begin, end, look)


class _Pen:
    """Writes cells one after the other, with as few sequences as they need.

    Attributes:
        look: the look that the terminal has after what is written, or None if it is unknown.
    """

    def __init__(self, most: float, look: CellLook | None, *, erases: bool) -> None:
        self.look = look
        self._most = most
        self._erases = erases
        self._parts: list[str] = []
        self._size = 0
        self._at: tuple[int, int] | None = None
        """Row and column of the cursor, if they are known."""

    @property
    def text(self) -> str:
        return "".join(self._parts)

    def write(self, row: Sequence[Cell], run: CellRun) -> int:
        """Write a run, or a part of it; return the column behind the last one that was written."""
        done = run.left
        for x in range(run.left, run.right):
            text, look = row[x]
            if not text or x < done:
                continue
            if self._size >= self._most:
                return x
            self._move(run.row, x)
            self._take(look)
            if self._erases and (blanks := _blanks(row, x, run.right)) >= _ERASED:
                self._add(f"\x1b[{blanks}X")
                self._at, done = (run.row, x), x + blanks
                continue
            is_wide = x + 1 < len(row) and row[x + 1].text == ""
            if is_wide and (len(text) > 1 or ord(text) > _LAST_OF_PLANE_0):
                self._add(_ERASE_TWO)
            self._add(text)
            # Terminals do not agree how wide some are, nor where the cursor is behind the last column.
            is_known = x + 1 < len(row) and len(text) == 1 and not is_wide
            self._at = (run.row, x + 1) if is_known else None
        return run.right

    def _add(self, text: str) -> None:
        self._parts.append(text)
        self._size += len(text) if text.isascii() else len(text.encode("utf-8", "replace"))

    def _move(self, y: int, x: int) -> None:
        if self._at == (y, x):
            return
        place = f"\x1b[{y + 1};{x + 1}H" if x else f"\x1b[{y + 1}H"
        if self._at is not None and y >= self._at[0]:
            down, right = y - self._at[0], x - self._at[1]
            steps = ("\b" * -right or _step(right, "C")) + _step(down, "B")
            place = min(steps, place, key=len)
        self._add(place)

    def _take(self, look: CellLook) -> None:
        if look == self.look:
            return
        had, codes = (_OWN, ["0"]) if self.look is None else (self.look, [])
        if not look.ink:  # blank: neither ink nor weight are seen
            look = CellLook("" if had.marks_blanks else had.attributes, had.ink, look.paper)
        if look.attributes != had.attributes:
            before, after = ([code for code in each.attributes.split(";") if code] for each in (had, look))
            if set(before) - set(after):
                codes.append("0")
                had, before = _OWN, []
            codes += [each for each in after if each not in before]
        codes += [look.ink] if look.ink != had.ink else []
        codes += [look.paper] if look.paper != had.paper else []
        if codes:
            self._add(f"\x1b[{'' if codes == ['0'] else ';'.join(codes)}m")
        self.look = look


def _step(cells: int, way: str) -> str:
    return "" if not cells else f"\x1b[{way}" if cells == 1 else f"\x1b[{cells}{way}"


def _ranked(y: int, edges: set[int], ranks: Sequence[tuple[Region, int]]) -> Iterator[tuple[int, int, int]]:
    """Yield the parts of a row: the first column, the one behind the last, and the rank.

    Args:
        edges: columns where parts begin and end, besides those of regions.
    """
    parts, width = [(each.x, each.right, rank) for each, rank in ranks if y in each.line_range], max(edges)
    edges |= {max(0, min(width, edge)) for begin, end, _ in parts for edge in (begin, end)}
    for left, right in pairwise(sorted(edges)):
        yield left, right, next((rank for begin, end, rank in parts if begin <= left < end), USUAL)


def _differing(
    wanted: Sequence[Cell], shown: Sequence[Cell | None], left: int, right: int, *, mixed: bool
) -> Iterator[tuple[int, int, CellLook]]:
    """Yield the beginnings, ends and looks of runs of cells that differ.

    None begins behind a wide character.

    Args:
        mixed: cells of several looks may be in one run.
    """
    x = left
    while x < right:
        if wanted[x] == shown[x]:
            x += 1
            continue
        begin, end, look = x, x + 1, wanted[x].look
        x += 1
        while x < right and x - end < _JUMP:
            differs, common = wanted[x] != shown[x], _common(look, wanted[x].look)
            if common is None and not (mixed and differs and x == end):
                break
            if differs:
                end, look = x + 1, common or wanted[x].look
            x += 1
        while begin > 0 and not wanted[begin].text:
            begin -= 1
        while end < len(wanted) and not wanted[end].text:
            end += 1
        yield begin, end, look


def _common(one: CellLook, other: CellLook) -> CellLook | None:
    """Return the look in which cells of two looks can be written, or None: a blank shows only its paper."""
    if one == other:
        return one
    if one.paper != other.paper or (one.ink and other.ink):
        return None
    inked = one if one.ink else other
    return None if inked.marks_blanks else inked


def _rank_of(cells: Sequence[Cell], rank: int) -> int:
    """Return the rank of cells in a region of a rank: a box's frame comes after what is in it."""
    first, last = _DRAWS_LINES
    texts = {text for text, _ in cells} - {" "}
    is_line = rank < LINES and bool(texts) and all(first <= text <= last for text in texts)
    return LINES if is_line else rank


def _blanks(row: Sequence[Cell], left: int, right: int) -> int:
    """Return how many cells from one on are blank and show the same paper."""
    if row[left].text != " " or row[left].look.ink:
        return 0
    return next((x for x in range(left, right) if row[x] != row[left]), right) - left


def _more_cells(cells: Sequence[Cell]) -> int:
    """Return how many cells behind some a terminal may have written, too: tmux draws a skin tone beside its emoji."""
    last = next((text for text, _ in reversed(cells) if text), "")
    return 2 * max(0, len(last) - 1)


def _blank(look: CellLook) -> Cell:
    return Cell(" ", look if look.marks_blanks else CellLook("", "", look.paper))


@lru_cache(maxsize=8192)
def _cells(text: str, look: CellLook) -> tuple[Cell, ...]:
    space = _blank(look)
    if text.isascii() or all(get_character_cell_size(char) == 1 for char in text):
        return tuple(space if char == " " else Cell(char, look) for char in text)
    cells: list[Cell] = []
    for start, end, width in split_graphemes(text)[0]:
        if width:
            cells.append(space if text[start:end] == " " else Cell(text[start:end], look))
            cells += [Cell("", look)] * (width - 1)
    return tuple(cells)


@lru_cache(maxsize=4096)
def _look(style: Style | None, colours: ColorSystem) -> CellLook:
    if style is None:
        return _OWN
    bits = attributes_of(style)
    attributes = ";".join(code for bit, code in enumerate(_ATTRIBUTES) if bits & (1 << bit))
    ink, paper = (
        own if colour is None else ";".join(colour.downgrade(colours).get_ansi_codes(foreground=own is _OWN_INK))
        for colour, own in ((style.color, _OWN_INK), (style.bgcolor, _OWN_PAPER))
    )
    return CellLook(attributes, ink, paper)

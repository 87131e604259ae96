"""What the terminal lacks of the screen: a real emulator, given the frames, shows what Textual has drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pyte
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.color import ColorSystem
from rich.segment import Segment
from rich.style import Style
from textual._compositor import ChopsUpdate, LayoutUpdate
from textual.geometry import Region, Size
from textual.strip import Strip

from rsb_console.terminal.frames import FIRST, LAST, USUAL, Frames

if TYPE_CHECKING:
    from collections.abc import Sequence

SIZE = Size(24, 5)
INF = float("inf")
PLAIN, BOLD, REVERSE, COLOURED = (
    Style(), Style(bold=True), Style(reverse=True), Style(color="#204060", bgcolor="#a0b0c0")
)  # fmt: skip
STYLES = (PLAIN, BOLD, REVERSE, COLOURED, Style(color="#204060"), Style(bgcolor="#a0b0c0", underline=True))
Piece = tuple[int, int, str, Style]
"""A text from a row and a column on."""
pieces = st.lists(
    st.tuples(
        st.integers(0, SIZE.height - 1),
        st.integers(0, SIZE.width - 6),
        st.text("ab ▇─é網", min_size=1, max_size=3),
        st.sampled_from(STYLES),
    ),
    max_size=6,
)


def frames() -> Frames:
    made = Frames(ColorSystem.TRUECOLOR)
    made.resize(SIZE)
    return made


def drawn(frames: Frames, *drawn: Piece) -> None:
    for y, x, text, style in drawn:
        strip = Strip([Segment(text, style)])
        frames.draw(LayoutUpdate([[strip]], Region(x, y, strip.cell_length, 1)))


class Emulator:
    """A terminal of another program."""

    def __init__(self) -> None:
        self.screen = pyte.Screen(SIZE.width, SIZE.height)
        self._stream = pyte.Stream(self.screen)

    def take(self, text: str) -> None:
        self._stream.feed(text)

    @property
    def cells(self) -> list[list[tuple[object, ...]]]:
        rows = (self.screen.buffer[y] for y in range(SIZE.height))
        return [[_seen(row[x]) for x in range(SIZE.width)] for row in rows]


def _seen(char: pyte.screens.Char) -> tuple[object, ...]:
    """Return what is seen of a cell: of a blank one, neither its ink nor its weight."""
    marks = char.bg, char.reverse, char.underscore
    return (char.data, *marks) if char.data == " " and not char.reverse else (char.data, *marks, char.fg, char.bold)


@given(st.lists(pieces, min_size=1, max_size=5), st.integers(1, 60))
def test_terminal_shows_what_was_drawn(turns: Sequence[Sequence[Piece]], most: int) -> None:
    """In small frames, after several changes, it shows the same as after one frame of the last screen alone."""
    ours, whole = frames(), frames()
    by_frames, at_once = Emulator(), Emulator()
    ours.forget()
    whole.forget()
    for turn in turns:
        drawn(ours, *turn)
        drawn(whole, *turn)
        by_frames.take(ours.next(most, (), ()).text)
    for _ in range(1000):
        frame = ours.next(most, (), ())
        by_frames.take(frame.text)
        if frame.lacks is None:
            break
    at_once.take(whole.next(INF, (), ()).text)
    assert by_frames.cells == at_once.cells
    assert ours.next(most, (), ()).text == ""


def test_region_is_written_again() -> None:
    """As where an image in pixels stood."""
    ours = frames()
    drawn(ours, (1, 0, "left right", PLAIN), (2, 0, "below", PLAIN))
    ours.next(INF, (), ())
    ours.forget(Region(5, 1, 100, 100))
    frame = ours.next(INF, (), ())
    assert "right" in frame.text
    assert "left" not in frame.text
    assert {left for _, left, _ in frame.spans} == {5}


def test_wide_characters_are_written_whole() -> None:
    ours, emulator = frames(), Emulator()
    drawn(ours, (0, 0, "網a", PLAIN))
    emulator.take(ours.next(INF, (), ()).text)
    drawn(ours, (0, 1, "b", PLAIN))  # its second half
    emulator.take(ours.next(INF, (), ()).text)
    drawn(ours, (0, 0, "c", PLAIN))
    emulator.take(ours.next(INF, (), ()).text)
    assert emulator.screen.display[0].startswith("cba")


def test_only_cells_that_differ_are_written() -> None:
    ours = frames()
    drawn(ours, (1, 0, "12.5 Hz", COLOURED))
    assert "12.5 Hz" in ours.next(INF, (), ()).text
    drawn(ours, (1, 0, "12.6 Hz", COLOURED))
    frame = ours.next(INF, (), ())
    assert frame.text == "\x1b[2;4H\x1b[38;2;32;64;96;48;2;160;176;192m6\x1b[m"
    assert frame.spans == [(1, 3, 4)]
    drawn(ours, (1, 0, "12.6 Hz", COLOURED))
    assert ours.next(INF, (), ()).text == ""


def test_looks_are_said_once() -> None:
    ours = frames()
    ours.next(INF, (), ())
    drawn(ours, (0, 0, "a", BOLD), (0, 1, " ", PLAIN), (0, 2, "b", BOLD), (0, 3, "c", PLAIN))
    assert ours.next(INF, (), ()).text == "\x1b[1H\x1b[1ma b\x1b[mc\x1b[m"


def test_most_important_comes_first() -> None:
    ours = frames()
    drawn(ours, *((y, 0, "x" * SIZE.width, PLAIN) for y in range(SIZE.height)))
    box, picture = Region(4, 3, 8, 1), Region(0, 0, SIZE.width, 2)
    while (frame := ours.next(8, [box], [picture])).lacks == FIRST:
        assert {y for y, *_ in frame.spans} == {3}
        assert ours.lacks(box)
    assert not ours.lacks(box)
    while (frame := ours.next(8, [box], [picture])).lacks == USUAL:
        assert not any(y < 2 for y, *_ in frame.spans)
    assert frame.lacks == LAST
    assert ours.lacks(picture)


def test_frame_goes_on_where_last_one_ended() -> None:
    """Else what changes at the top would hide for ever what is below."""
    ours = frames()
    rows = set()
    for turn in range(12 * SIZE.height):
        drawn(ours, *((y, 0, str(turn % 10) * 10, PLAIN) for y in range(SIZE.height)))
        rows |= {y for y, *_ in ours.next(12, (), ()).spans}
    assert rows == set(range(SIZE.height))


@pytest.mark.parametrize("another", [SIZE, Size(30, 6)])
def test_all_is_written_again_to_a_terminal_that_lost_it(another: Size) -> None:
    ours = frames()
    drawn(ours, (1, 2, "here", PLAIN))
    ours.next(INF, (), ())
    if another == SIZE:
        ours.forget()
        assert "here" in ours.next(INF, (), ()).text
    else:
        ours.resize(another)
        drawn(ours, (1, 2, "here", PLAIN))
        assert "here" in ours.next(INF, (), ()).text


def test_update_changes_nothing_beside_its_spans() -> None:
    """There it has what lies below a note: Textual leaves out widgets that nothing of the update touches."""
    ours, terminal = frames(), Emulator()
    drawn(ours, (1, 0, "topics", PLAIN), (1, 6, "note", PLAIN))
    chops = [{}, {0: Strip([Segment("TOPICS")]), 6: Strip([Segment("base")])}]
    ours.draw(ChopsUpdate(chops, [(1, 0, 6)], [[], [6, 10]]))
    terminal.take(ours.next(INF, (), ()).text)
    assert terminal.screen.display[1].rstrip() == "TOPICSnote"

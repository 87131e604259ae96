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

from rsb_console.terminal.screen_cells import BOX, FIRST, LAST, LINES, USUAL, ScreenCells

if TYPE_CHECKING:
    from collections.abc import Sequence

SIZE = Size(24, 5)
INF = float("inf")
PLAIN, BOLD, REVERSE, COLOURED = (
    Style(), Style(bold=True), Style(reverse=True), Style(color="#204060", bgcolor="#a0b0c0")
)  # fmt: skip
STYLES = (
    PLAIN, BOLD, REVERSE, BOLD + REVERSE, COLOURED, Style(color="#204060"), Style(bgcolor="#a0b0c0", underline=True)
)  # fmt: skip
Piece = tuple[int, int, str, Style]
"""A text from a row and a column on."""
pieces = st.lists(
    st.tuples(
        st.integers(0, SIZE.height - 1),
        st.integers(0, SIZE.width - 6),
        st.text("ab ▇─é網", min_size=1, max_size=3) | st.sampled_from([" " * 18, "a" + " " * 14 + "b"]),
        st.sampled_from(STYLES),
    ),
    max_size=6,
)
ranked = st.lists(
    st.tuples(
        st.sampled_from([Region(3, 1, 12, 3), Region(0, 0, SIZE.width, 2), Region(6, 0, 18, SIZE.height)]),
        st.sampled_from([FIRST, BOX, LAST]),
    ),
    max_size=2,
)


def screen_cells() -> ScreenCells:
    made = ScreenCells(ColorSystem.TRUECOLOR)
    made.resize(SIZE)
    return made


def drawn(frames: ScreenCells, *drawn: Piece) -> None:
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


@given(st.lists(st.tuples(pieces, ranked), min_size=1, max_size=5), st.integers(1, 60), st.booleans())
def test_terminal_shows_what_was_drawn(
    turns: Sequence[tuple[Sequence[Piece], Sequence[tuple[Region, int]]]], most: int, erases: bool
) -> None:
    """In small frames, after several changes, it shows the same as after one frame of the last screen alone."""
    ours, whole = screen_cells(), screen_cells()
    ours.erases = erases
    by_frames, at_once = Emulator(), Emulator()
    ours.forget()
    whole.forget()
    ranks: Sequence[tuple[Region, int]] = ()
    for turn, ranks in turns:
        drawn(ours, *turn)
        drawn(whole, *turn)
        by_frames.take(ours.next(most, ranks).text)
    for _ in range(1000):
        frame = ours.next(most, ranks)
        by_frames.take(frame.text)
        if frame.lacks is None:
            break
    at_once.take(whole.next(INF).text)
    assert by_frames.cells == at_once.cells
    assert ours.next(most).text == ""


def test_only_spans_of_an_update_are_taken() -> None:
    """Beside them, Textual has drawn the widget below a message that has not changed."""
    ours = screen_cells()
    drawn(ours, (1, 0, "below" * 4, PLAIN), (1, 10, "message", BOLD))
    ours.next(INF)
    row = {0: Strip([Segment("BELOW" * 2)]), 10: Strip([Segment("BELOW" * 2)])}
    ours.draw(ChopsUpdate([{}, row], [(1, 0, 5)], [[], [10, 20]]))
    assert ours.next(INF).text == "\x1b[2H\x1b[mBELOW"


def test_region_is_written_again() -> None:
    """As where an image in pixels stood."""
    ours = screen_cells()
    drawn(ours, (1, 0, "left right", PLAIN), (2, 0, "below", PLAIN))
    ours.next(INF)
    ours.forget(Region(5, 1, 100, 100))
    frame = ours.next(INF)
    assert "right" in frame.text
    assert "left" not in frame.text
    assert {left for _, left, _ in frame.spans} == {5}


def test_wide_characters_are_written_whole() -> None:
    ours, emulator = screen_cells(), Emulator()
    drawn(ours, (0, 0, "網a", PLAIN))
    emulator.take(ours.next(INF).text)
    drawn(ours, (0, 1, "b", PLAIN))  # its second half
    emulator.take(ours.next(INF).text)
    drawn(ours, (0, 0, "c", PLAIN))
    emulator.take(ours.next(INF).text)
    assert emulator.screen.display[0].startswith("cba")


def test_nothing_is_left_beside_emoji_that_terminal_takes_for_narrow() -> None:
    """As tmux does with those that a variation selector makes wide."""
    ours, emulator = screen_cells(), Emulator()
    drawn(ours, (0, 0, "abcd", PLAIN))
    emulator.take(ours.next(INF).text)
    drawn(ours, (0, 0, "❤\ufe0f", PLAIN))
    emulator.take(ours.next(INF).text)
    assert [emulator.screen.buffer[0][x].data for x in range(1, 4)] == [" ", "c", "d"]


def test_cells_beside_an_emoji_are_kept_where_its_skin_tone_is_drawn_beside_it() -> None:
    """As tmux does."""
    ours, emulator = screen_cells(), Emulator()
    drawn(ours, (0, 0, "abcdefghij", PLAIN))
    emulator.take(ours.next(INF).text)
    drawn(ours, (0, 1, "👍\U0001f3fd👍\U0001f3fd", PLAIN), (0, 8, "IJ", BOLD))
    lacks: int | None = USUAL
    while lacks is not None:
        text, _, lacks = ours.next(INF)
        emulator.take(text)
    assert emulator.screen.display[0].rstrip() == "a👍👍fghIJ"


def test_only_cells_that_differ_are_written() -> None:
    ours = screen_cells()
    drawn(ours, (1, 0, "12.5 Hz", COLOURED))
    assert "12.5 Hz" in ours.next(INF).text
    drawn(ours, (1, 0, "12.6 Hz", COLOURED))
    frame = ours.next(INF)
    assert frame.text == "\x1b[2;4H6"
    assert frame.spans == [(1, 3, 4)]
    drawn(ours, (1, 0, "12.6 Hz", COLOURED))
    assert ours.next(INF).text == ""


def test_smaller_screen_after_a_frame_that_was_cut_short_is_written() -> None:
    ours = screen_cells()
    drawn(ours, (0, 0, "x" * SIZE.width, PLAIN))
    assert ours.next(SIZE.width - 4).lacks == USUAL
    ours.resize(Size(4, 2))
    drawn(ours, (0, 0, "abcd", PLAIN))
    assert "abcd" in ours.next(INF).text


def test_looks_are_said_once() -> None:
    ours = screen_cells()
    drawn(ours, *((y, 0, "--", PLAIN) for y in range(SIZE.height)))
    ours.next(INF)
    drawn(ours, (0, 0, "a", BOLD), (0, 1, " ", PLAIN), (0, 2, "b", BOLD), (0, 3, "c", PLAIN))
    assert ours.next(INF).text == "\x1b[1;4Hc\b\b\b\b\x1b[1ma b"
    drawn(ours, *((y, 0, "x", BOLD) for y in (1, 3)), *((y, 1, "y", PLAIN) for y in (1, 3)))
    assert ours.next(INF).text == "\x1b[2Hx\x1b[4Hx\x1b[2;2H\x1b[my\b\x1b[2By"


def test_look_is_said_again_to_a_terminal_that_may_have_another() -> None:
    ours = screen_cells()
    drawn(ours, (0, 0, "a", COLOURED))
    ours.next(INF)
    drawn(ours, (0, 0, "b", COLOURED))
    ours.next(INF)
    ours.forget(Region(0, 0, 1, 1))
    assert ours.next(INF).text == "\x1b[1Hb"
    ours.forget()
    emulator = Emulator()
    emulator.take("\x1b[1;4;31m" + ours.next(INF).text)
    assert emulator.cells[0][0] == ("b", "a0b0c0", False, False, "204060", False)


def test_what_fits_is_written_look_by_look_and_pictures_last() -> None:
    ours, picture = screen_cells(), Region(0, 0, SIZE.width, 1)
    ours.next(INF)
    drawn(ours, *((y, 0, "ab", BOLD) for y in range(3)), *((y, 2, "c", PLAIN) for y in range(3)))
    spans = ours.next(INF, [(picture, LAST)]).spans
    assert spans == [(1, 2, 3), (2, 2, 3), (1, 0, 2), (2, 0, 2), (0, 0, 3)]


def test_most_important_comes_first() -> None:
    ours = screen_cells()
    drawn(ours, *((y, 0, "x" * SIZE.width, PLAIN) for y in range(SIZE.height)))
    box, picture = Region(4, 3, 8, 1), Region(0, 0, SIZE.width, 2)
    while (frame := ours.next(8, [(box, FIRST), (picture, LAST)])).lacks == FIRST:
        assert {y for y, *_ in frame.spans} == {3}
        assert ours.lacks(box)
    assert not ours.lacks(box)
    while (frame := ours.next(8, [(box, FIRST), (picture, LAST)])).lacks == USUAL:
        assert not any(y < 2 for y, *_ in frame.spans)
    assert frame.lacks == LAST
    assert ours.lacks(picture)


def test_frame_goes_on_where_last_one_ended() -> None:
    """Else what changes at the top would hide for ever what is below."""
    ours = screen_cells()
    rows = set()
    for turn in range(12 * SIZE.height):
        drawn(ours, *((y, 0, str(turn % 10) * 10, PLAIN) for y in range(SIZE.height)))
        rows |= {y for y, *_ in ours.next(12).spans}
    assert rows == set(range(SIZE.height))


def test_place_where_a_picture_was_cut_does_not_move_what_comes_first() -> None:
    ours = screen_cells()
    ours.next(INF)
    ranks = (Region(0, 0, 8, SIZE.height), FIRST), (Region(8, 0, 16, SIZE.height), LAST)
    drawn(ours, *((y, 8, "x" * 16, PLAIN) for y in range(SIZE.height)))
    while ours.next(8, ranks).spans[0][0] < 3:
        pass
    drawn(ours, *((y, 0, "a text", PLAIN) for y in range(SIZE.height)))
    assert ours.next(8, ranks).spans[0][:2] == (0, 0)


def test_frame_of_a_box_comes_after_its_text() -> None:
    ours, box = screen_cells(), Region(0, 0, 10, 3)
    ours.next(INF)
    drawn(ours, (0, 0, "╭─", COLOURED), (0, 2, "Help", BOLD), (0, 6, "───╮", COLOURED), (1, 1, "text", PLAIN))
    spans: list[tuple[int, int, int]] = []
    while (frame := ours.next(1, [(box, FIRST)])).lacks is not None:
        spans += frame.spans
        assert frame.lacks == (FIRST if len(spans) < 8 else LINES)
    assert [(y, left) for y, left, _ in spans[:8]] == [(0, x) for x in range(2, 6)] + [(1, x) for x in range(1, 5)]


def test_rest_of_a_screen_waits_unless_all_fits() -> None:
    ours, box, picture = screen_cells(), Region(0, 4, 8, 1), Region(0, 0, SIZE.width, 2)
    ranks = (box, FIRST), (picture, LAST)
    drawn(ours, *((y, 0, "x" * SIZE.width, PLAIN) for y in range(SIZE.height)))
    frame = ours.next(60, ranks, rest_waits=True)
    assert ({y for y, *_ in frame.spans}, frame.lacks) == ({4}, USUAL)
    assert ours.next(60, ranks, rest_waits=True).text == ""
    assert ours.next(INF, ranks, rest_waits=True).lacks is None


def test_text_in_the_place_of_a_picture_goes_before_the_picture_comes() -> None:
    """A question that was answered would else stand there for as long as a slow line takes for the picture."""
    ours, emulator, picture = screen_cells(), Emulator(), Region(1, 0, SIZE.width - 1, SIZE.height)
    drawn(ours, *((y, 3, "y yes   n no", PLAIN) for y in range(SIZE.height)))
    emulator.take(ours.next(INF, [(picture, USUAL)]).text)
    drawn(ours, *((y, x, "▀", Style(color=f"#{x:02}4060")) for y in range(SIZE.height) for x in range(1, SIZE.width)))
    shown = "yes"
    frames = 0
    while "yes" in shown:
        emulator.take(ours.next(40, [(picture, LAST)]).text)
        shown, frames = "".join(emulator.screen.display), frames + 1
        assert "▀" not in shown
    assert frames < SIZE.height
    while (frame := ours.next(40, [(picture, LAST)])).lacks is not None:
        assert "▀" in frame.text
        emulator.take(frame.text)
    emulator.take(frame.text)
    assert all(line.count("▀") == picture.width for line in emulator.screen.display)


def test_wide_character_may_reach_into_the_place_of_a_picture() -> None:
    ours, emulator, picture = screen_cells(), Emulator(), Region(4, 0, 8, SIZE.height)
    drawn(ours, *((y, 0, "x" * SIZE.width, PLAIN) for y in range(SIZE.height)))
    emulator.take(ours.next(INF, [(picture, USUAL)]).text)
    drawn(ours, *((y, 3, "世" + "▀" * 7, PLAIN) for y in range(SIZE.height)))
    while (frame := ours.next(10, [(picture, LAST)])).lacks is not None:
        emulator.take(frame.text)
    emulator.take(frame.text)
    assert all("xxx世" in line and line.count("▀") == 7 for line in emulator.screen.display)


def test_picture_waits_whose_cells_have_looks_of_their_own() -> None:
    ours, picture = screen_cells(), Region(0, 0, SIZE.width, SIZE.height)
    ours.next(INF)
    drawn(ours, *((0, x, "▀", Style(color=f"#{x:02}4060", bgcolor="#a0b0c0")) for x in range(SIZE.width)))
    frame = ours.next(200, [(picture, LAST)], rest_waits=True)
    assert (frame.text, frame.lacks) == ("", LAST)


@pytest.mark.parametrize("style", [PLAIN, COLOURED, REVERSE, Style(underline=True)])
def test_many_blanks_are_erased_where_that_looks_the_same(style: Style) -> None:
    ours, emulator = screen_cells(), Emulator()
    drawn(ours, *((y, 0, "x" * SIZE.width, BOLD) for y in range(SIZE.height)))
    emulator.take(ours.next(INF).text)
    ours.erases = True
    drawn(ours, (1, 2, " " * 15 + "end", style))
    frame = ours.next(INF)
    emulator.take(frame.text)
    assert emulator.screen.display[1] == "xx" + " " * 15 + "end" + "x" * 4
    marks = style.reverse or style.underline
    assert ("\x1b[15X" in frame.text) is not bool(marks)
    assert (" " * 15 in frame.text) is bool(marks)


def test_what_follows_erased_blanks_stands_in_its_place() -> None:
    """Erasing leaves the cursor where it is."""
    ours, emulator = screen_cells(), Emulator()
    ours.erases = True
    drawn(ours, *((y, 0, "z" * SIZE.width, PLAIN) for y in range(2)))
    emulator.take(ours.next(INF).text)
    drawn(ours, (1, 0, "a", PLAIN), (1, 3, " " * 14 + "b", COLOURED))
    emulator.take(ours.next(INF).text)
    assert emulator.screen.display[1] == "azz" + " " * 14 + "bzzzzzz"


def test_new_thing_is_written_from_its_top_on() -> None:
    ours = screen_cells()
    ours.next(INF)
    drawn(ours, *((y, 0, "x" * SIZE.width, PLAIN) for y in range(SIZE.height)))
    assert ours.next(60).spans[-1][0] == 2
    drawn(ours, *((y, 0, "y" * SIZE.width, PLAIN) for y in range(SIZE.height)))
    ours.begin_at_top()
    assert ours.next(60).spans[0] == (0, 0, SIZE.width)


@pytest.mark.parametrize("another", [SIZE, Size(30, 6)])
def test_all_is_written_again_to_a_terminal_that_lost_it(another: Size) -> None:
    ours = screen_cells()
    drawn(ours, (1, 2, "here", PLAIN))
    ours.next(INF)
    if another == SIZE:
        ours.forget()
        assert "here" in ours.next(INF).text
    else:
        ours.resize(another)
        drawn(ours, (1, 2, "here", PLAIN))
        assert "here" in ours.next(INF).text

"""A live pane redraws no more than it must, and never less."""

from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from tests.console.driving import on_main, until
from textual.pilot import Pilot
from textual.strip import Strip

from rsb_console.app import ConsoleApp
from rsb_console.widgets.lines import LOOKS, Line, changed_width, clip, fit, width_of

PIECES = st.tuples(st.text(st.sampled_from("ab ●日"), max_size=4), st.sampled_from(LOOKS))
LINES = st.lists(PIECES, max_size=6).map(tuple)


def cells(line: Line) -> list[tuple[str, str]]:
    """A line cell by cell; a wide character fills two."""
    return [(char, look) for text, look in line for char in text for _ in range(cell_len(char))]


@settings(deadline=None)
@given(LINES, LINES)
def test_all_beyond_the_changed_width_is_the_same(old: Line, new: Line) -> None:
    width = 60
    start = changed_width(old, new, width)
    padded = [(line + [(" ", "")] * width)[:width] for line in (cells(old), cells(new))]
    assert padded[0][start:] == padded[1][start:]


def test_change_at_start_costs_only_start() -> None:
    assert changed_width((("ab", ""), ("c" * 50, "")), (("xy", ""), ("c" * 50, "")), 80) == 2


@settings(deadline=None)
@given(LINES, st.integers(2, 20))
def test_a_fitted_line_fits(line: Line, width: int) -> None:
    fitted = fit(line, width)
    assert width_of(fitted) <= width
    assert fitted == line or fitted[-1][0] == "…"


def test_clip_never_cuts_a_wide_character_in_two() -> None:
    assert clip("日本", 3) == "日"


@on_main()
async def test_pane_keeps_its_drawing_until_look_changes(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """The line under the cursor changes with the focus, and all of it with the theme; else it is the very same."""

    def cursor_line() -> Strip:
        table = app.main.topics
        return table.render_lines(table.outer_size.region)[1 + table.sticky]  # below the border and the heading

    focused = cursor_line()
    assert cursor_line() is focused
    await pilot.press("l")
    await until(pilot, lambda: cursor_line() != focused, "a paler cursor")
    assert cursor_line().text == focused.text
    await pilot.press("l")
    await until(pilot, lambda: cursor_line() == focused, "the cursor as it was")
    await pilot.press("t")
    await until(pilot, lambda: cursor_line() != focused, "the other theme's colours")

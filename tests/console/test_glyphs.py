"""Signs and charts, and their ASCII stand-ins."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style
from textual.color import Color

from rsb_bridge.model.snapshot import State
from rsb_console.notation.ascii_signs import ASCII, to_ascii
from rsb_console.notation.glyphs import STATE_SIGN, STATE_WORD, AsciiFilter, braille_plot, sparkline


def test_every_state_has_its_own_sign_and_word() -> None:
    assert set(STATE_SIGN) == set(STATE_WORD) == set(State)
    assert len(set(STATE_SIGN.values())) == len(set(STATE_WORD.values())) == len(State)


def test_states_stay_apart_in_ascii() -> None:
    assert len({to_ascii(sign) for sign in STATE_SIGN.values()}) == len(State)


@settings(deadline=None)
@given(st.text(max_size=30))
def test_ascii_keeps_every_width(given_text: str) -> None:
    assert to_ascii(given_text).isascii()
    printable = "".join(c for c in given_text if c.isprintable())
    assert cell_len(to_ascii(printable, cell_len)) == cell_len(printable)


def test_the_filter_keeps_style_and_control() -> None:
    style = Style(bold=True)
    (segment,) = AsciiFilter().apply([Segment("● ok…", style)], Color.parse("black"))
    assert segment == Segment("o ok~", style)


def test_stand_ins_are_single_ascii_characters() -> None:
    assert all(len(sign) == 1 and sign.isascii() for sign in ASCII.values())


@pytest.mark.parametrize(
    ("values", "top", "expected"),
    [
        ([], 0, "     "),
        ([0, 0], 0, "     "),
        ([10, 10], 10, "   ▇▇"),
        ([1, 2, 3, 4, 5, 6, 7], 7, "▃▄▅▆▇"),
        ([0.001], 100, "    ▁"),
        ([200], 100, "    ▇"),
    ],
)
def test_sparkline(values: list[float], top: float, expected: str) -> None:
    assert sparkline(values, 5, top) == expected


def test_a_level_curve_is_one_line_of_dots() -> None:
    plot = braille_plot([1.0] * 8, 4, 2, top=1.0)
    assert plot == ["⠉⠉⠉⠉", "⠀⠀⠀⠀"]


def test_step_is_drawn_as_edge() -> None:
    first, second = braille_plot([0.0, 1.0], 3, 2, top=1.0)
    assert first.startswith("⠀⠀")
    assert first[2] != "⠀"
    assert second[2] != "⠀"


@settings(deadline=None)
@given(
    st.lists(st.floats(0, 1e6), max_size=50),
    st.integers(1, 30),
    st.integers(1, 8),
    st.floats(0, 1e6, allow_subnormal=False),
)
def test_a_plot_has_its_size_whatever_the_values(values: list[float], width: int, height: int, top: float) -> None:
    plot = braille_plot(values, width, height, top)
    assert [len(line) for line in plot] == [width] * height
    assert any(char != "⠀" for line in plot for char in line) == bool(values)


def test_plus_or_minus_is_no_ellipsis_in_ascii() -> None:
    assert to_ascii("3.1 ms ± 0.4 ms…") == "3.1 ms +-0.4 ms~"

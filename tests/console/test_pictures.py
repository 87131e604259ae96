"""Exact pictures, each proven to show the console and not a crash before it is compared."""

import pytest
from tests.console.driving import NARROW, WIDE, scripted_app
from tests.console.pictures_helpers import SnapCompare, after

THEMES = ("dark", "light", "high-contrast", "terminal")


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
def test_main(snap_compare: SnapCompare, theme: str, size: tuple[int, int]) -> None:
    assert snap_compare(scripted_app(theme=theme), terminal_size=size, run_before=after("● ok       /tf"))


@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
def test_ascii(snap_compare: SnapCompare, size: tuple[int, int]) -> None:
    app = scripted_app(theme="terminal", ascii_only=True)
    assert snap_compare(app, terminal_size=size, run_before=after("o ok       /tf"))


def test_detail_on_a_narrow_screen(snap_compare: SnapCompare) -> None:
    assert snap_compare(scripted_app(), terminal_size=NARROW, run_before=after("99.7 %", "G", "enter"))


def test_quit_dialog(snap_compare: SnapCompare) -> None:
    assert snap_compare(scripted_app(), terminal_size=NARROW, run_before=after("Quit?", "q"))


def test_filter(snap_compare: SnapCompare) -> None:
    assert snap_compare(scripted_app(), terminal_size=NARROW, run_before=after("3 of 8", "slash", *"robot1"))

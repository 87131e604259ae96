"""Every screen on a terminal without Unicode, and the characters of the program that have no ASCII."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from rich.cells import cell_len
from tests.console.driving import NARROW, WIDE, drive, ended, on_main, put, scripted_app, shown, text
from textual.keys import _character_to_key

import rsb_bridge
import rsb_console
import rsb_extras
from rsb_console.actions.all_actions import ACTIONS
from rsb_console.notation.ascii_signs import to_ascii
from rsb_console.notation.glyphs import AsciiFilter
from rsb_console.preferences import split_keys

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.segment import Segment
    from textual.color import Color
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp

LEAVES = {"quit", "demo", "bluetooth"}
"""Actions that end the console, or look for what is outside of it."""
DATA = {"rsb_bridge/model/text.py", "rsb_bridge/config/yaml_text.py", "rsb_console/session/exports.py"}
"""Modules that look for characters in texts of others, or write them into files; they show none."""


def characters(package: Path) -> Iterator[tuple[str, str]]:
    """Yield the characters of a package's texts that are not ASCII, with their places."""
    for file in package.rglob("*.py"):
        name = f"{package.name}/{file.relative_to(package)}"
        if "/tests/" in name or name in DATA:
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield from ((char, f"{name}:{node.lineno}") for char in node.value if not char.isascii())


@pytest.mark.parametrize("package", [rsb_bridge, rsb_console, rsb_extras], ids=lambda package: str(package.__name__))
def test_every_sign_of_this_program_has_ascii(package: object) -> None:
    found = [*characters(Path(package.__path__[0]))]  # type: ignore[attr-defined]
    lost = [(char, place) for char, place in found if "?" in to_ascii(char) and char != "\N{REPLACEMENT CHARACTER}"]
    assert found
    assert not lost


def test_frames_and_blocks_have_ascii() -> None:
    assert not {chr(code) for code in range(0x2500, 0x25A0) if "?" in to_ascii(chr(code))}


@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
def test_no_screen_loses_signs_or_names(size: tuple[int, int]) -> None:
    drawn: set[str] = set()

    class Seen(AsciiFilter):
        def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
            drawn.update(*(segment.text for segment in segments))
            return super().apply(segments, background)

    app = scripted_app(ascii_only=True, theme="terminal")
    app._to_ascii = Seen()

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        for action in ACTIONS:
            if action.id not in LEAVES:
                await _look(app, pilot, next(iter(split_keys(action.keys))))

    drive(app, steps, size)
    assert len(drawn) > 60
    assert not {char for char in drawn if char != "?" and "?" in to_ascii(char)}


@pytest.mark.parametrize(("name", "plain"), [("Küche", "Kuche"), ("Søren-Łódź", "Soren-Lodz"), ("größer", "groser")])
def test_operators_names_stay_readable(name: str, plain: str) -> None:
    app = scripted_app(ascii_only=True)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        put(app, name=name)
        await shown(pilot, plain)

    drive(app, steps)


@on_main(NARROW, ascii_only=True)
async def test_keys_are_named_by_words(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("c")
    await shown(pilot, "enter detail")
    await pilot.press("escape", "d")
    await shown(pilot, "arrows enter choose")


@on_main((54, 24))
async def test_a_key_and_its_meaning_stay_on_one_line(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("c")
    await shown(pilot, "esc close")
    for hint in ("⏎ detail", "r try again now", "i acknowledge"):
        await shown(pilot, hint)


def test_log_text_of_any_script_is_replaced_by_question_marks() -> None:
    assert to_ascii("温度 5° \N{NOT EQUAL TO} 4", cell_len) == "???? 5d ? 4"


async def _look(app: ConsoleApp, pilot: Pilot[None], key: str) -> None:
    """Press a key, look at the screen that it opens, and leave that."""
    await pilot.press(_character_to_key(key) if len(key) == 1 else key)
    await pilot.pause()
    assert not ended(app), key
    assert text(app).isascii(), key
    for _ in range(3):
        if len(app.screen_stack) > 1:
            await pilot.press("escape")

"""The pictures of the documentation show the present console, and the script that takes them still does."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from html import unescape
from pathlib import Path

import pytest
import yaml

from rsb_console.actions.action import Group
from rsb_console.actions.all_actions import ACTIONS

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "docs/screenshots.py"
OF_FEATURES = sorted(ROOT.glob("extras/rsb_extras/*/docs/*.py"))
FOLDERS = ("docs/pictures", "extras/rsb_extras/*/docs/pictures")
PICTURES = [each for folder in FOLDERS for each in ROOT.glob(f"{folder}/*.svg")]
WINDOWS = sorted(each for folder in FOLDERS for each in ROOT.glob(f"{folder}/*.png"))
PAGES = [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("extras/rsb_extras/*/docs/*.md")]
MOST_BYTES = 250_000
"""Of a picture of a window: a clone has all of them, and the README shows one before its text."""
TAKES = {"take": "svg", "keep": "svg", "photograph": "png"}


def taken(script: Path) -> set[str]:
    """Return the file names of the pictures that a script takes."""
    calls = [node for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    names = set()
    for call in calls:
        if isinstance(call.func, ast.Attribute) and (suffix := TAKES.get(call.func.attr)):
            values = [each.value for each in call.args[:2] if isinstance(each, ast.Constant)]
            names |= {f"{value}.{suffix}" for value in values if isinstance(value, str)}
    return names


@pytest.mark.parametrize("script", [SCRIPT, *OF_FEATURES], ids=lambda script: script.stem)
def test_each_picture_is_taken_by_script_beside(script: Path) -> None:
    pictures = (script.parent / "pictures").iterdir()
    assert taken(script) == {picture.name for picture in pictures if picture.suffix in (".svg", ".png")}


@pytest.mark.parametrize("window", WINDOWS, ids=lambda window: window.stem)
def test_window_is_small_and_in_colour(window: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    assert window.stat().st_size <= MOST_BYTES
    with image.open(window) as picture:
        found = picture.convert("RGB").getcolors(1 << 24)
    assert len([colour for _, colour in found if max(colour) - min(colour) > 40]) > 20, "make screenshots"


@pytest.mark.parametrize("window", WINDOWS, ids=lambda window: window.stem)
def test_window_is_shown_by_a_page(window: Path) -> None:
    shown = {
        (page.parent / name).resolve() for page in PAGES for name in re.findall(r"\]\(([^)]+\.png)\)", page.read_text())
    }
    assert window in shown


def words_of(name: str) -> str:
    picture = (ROOT / f"docs/pictures/{name}.svg").read_text(encoding="utf-8")
    return unescape(picture).replace("\xa0", " ")


def test_picture_of_help_has_present_keys() -> None:
    words = words_of("help")
    missing = [each.id for each in ACTIONS if each.group in (Group.MOVE, Group.VIEW) and each.help not in words]
    assert not missing, "make screenshots"


@pytest.mark.parametrize("name", ["main", "service", "light", "narrow", "detail"])
def test_pictures_of_the_demo_have_one_fault(name: str) -> None:
    words = words_of(name)
    assert re.search(r"■ ?1\b", words), "make screenshots"
    assert not re.search(r"[≈◔▲✗◇] ?1\b", words), "make screenshots"


@pytest.mark.parametrize("picture", sorted(PICTURES), ids=lambda picture: picture.stem)
def test_pictures_have_the_colours_of_their_theme(picture: Path) -> None:
    theme = "light" if picture.stem == "light" else "dark"
    primary = yaml.safe_load((ROOT / f"themes/{theme}.yaml").read_text(encoding="utf-8"))["primary"]
    assert f"fill: {primary}" in picture.read_text(encoding="utf-8"), "make screenshots"


@pytest.mark.skipif(not OF_FEATURES, reason="the core alone")
def test_missing_terminal_leaves_its_pictures_out(tmp_path: Path) -> None:
    command = (sys.executable, SCRIPT, "tiles", "--folder", tmp_path)
    environment = {"PATH": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    ran = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120, check=True)
    assert "xvfb kitty imagemagick" in ran.stderr
    assert not list(tmp_path.iterdir())


def test_it_starts_and_names_its_parts() -> None:
    ran = subprocess.run((sys.executable, SCRIPT, "--help"), capture_output=True, text=True, timeout=120, check=True)
    assert "--folder" in ran.stdout


@pytest.mark.long
@pytest.mark.parametrize("part", ["robot", "fleet", "drive", "look"] if OF_FEATURES else [])
def test_it_takes_its_pictures(part: str, tmp_path: Path) -> None:
    """Without a terminal, and in 24-bit colours."""
    command = (sys.executable, SCRIPT, part, "--folder", tmp_path)
    subprocess.run(command, capture_output=True, env={"PATH": "/usr/bin:/bin", "TERM": "dumb"}, timeout=600, check=True)
    pictures = {each.name for each in tmp_path.glob("*.svg")}
    assert pictures
    assert pictures <= {name for script in (SCRIPT, *OF_FEATURES) for name in taken(script)}

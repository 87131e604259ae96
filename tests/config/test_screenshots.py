"""The pictures of the documentation show the present console, and the script that takes them still does."""

from __future__ import annotations

import ast
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
PICTURES = [each for folder in ("docs", "extras/rsb_extras/*/docs") for each in ROOT.glob(f"{folder}/pictures/*.svg")]


def taken(script: Path) -> set[str]:
    """Return the names of the pictures that a script takes."""
    calls = [node for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    names = set()
    for call in calls:
        if isinstance(call.func, ast.Attribute) and call.func.attr in ("take", "keep"):
            names |= {each.value for each in call.args[:2] if isinstance(each, ast.Constant)}
    return {name for name in names if isinstance(name, str)}


@pytest.mark.parametrize("script", [SCRIPT, *OF_FEATURES], ids=lambda script: script.stem)
def test_each_picture_is_taken_by_script_beside(script: Path) -> None:
    assert taken(script) == {picture.stem for picture in (script.parent / "pictures").glob("*.svg")}


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


def test_it_starts_and_names_its_parts() -> None:
    ran = subprocess.run((sys.executable, SCRIPT, "--help"), capture_output=True, text=True, timeout=120, check=True)
    assert "--folder" in ran.stdout


@pytest.mark.long
@pytest.mark.parametrize("part", ["robot", "fleet", *(["drive", "look"] if OF_FEATURES else [])])
def test_it_takes_its_pictures(part: str, tmp_path: Path) -> None:
    """Without a terminal, and in 24-bit colours."""
    command = (sys.executable, SCRIPT, part, "--folder", tmp_path)
    subprocess.run(command, capture_output=True, env={"PATH": "/usr/bin:/bin", "TERM": "dumb"}, timeout=600, check=True)
    pictures = {each.stem: each.read_text(encoding="utf-8") for each in tmp_path.glob("*.svg")}
    assert pictures
    assert set(pictures) <= {name for script in (SCRIPT, *OF_FEATURES) for name in taken(script)}

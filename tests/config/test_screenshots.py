"""The script that takes the pictures of the documentation: they are its own, and it still takes them."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "docs/screenshots.py"


def taken() -> set[str]:
    """Return the names of the pictures that the script takes."""
    calls = [node for node in ast.walk(ast.parse(SCRIPT.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    names = set()
    for call in calls:
        if isinstance(call.func, ast.Attribute) and call.func.attr in ("take", "keep"):
            names |= {each.value for each in call.args[:2] if isinstance(each, ast.Constant)}
    return {name for name in names if isinstance(name, str)}


def test_each_picture_is_taken_by_the_script() -> None:
    assert taken() == {picture.stem for picture in (ROOT / "docs/pictures").glob("*.svg")}


def test_it_starts_and_names_its_parts() -> None:
    ran = subprocess.run((sys.executable, SCRIPT, "--help"), capture_output=True, text=True, timeout=120, check=True)
    assert "--folder" in ran.stdout


@pytest.mark.long
@pytest.mark.parametrize("part", ["robot", "look", "fleet"])
def test_it_takes_its_pictures(part: str, tmp_path: Path) -> None:
    """Without a terminal, and in 24-bit colours."""
    command = (sys.executable, SCRIPT, part, "--folder", tmp_path)
    subprocess.run(command, capture_output=True, env={"PATH": "/usr/bin:/bin", "TERM": "dumb"}, timeout=600, check=True)
    pictures = {each.stem: each.read_text(encoding="utf-8") for each in tmp_path.glob("*.svg")}
    assert pictures
    assert set(pictures) <= taken()

"""A feature that judges, rings and has keys of its own is installed as a package, and tried on both sides of a link."""

from __future__ import annotations

import ast
import re
import shutil
from typing import TYPE_CHECKING

from tests.feature.own_process import ROOT, describe, passed

if TYPE_CHECKING:
    from pathlib import Path

PAGES = ("a-feature", "feature-reference", "testing-a-feature")
OTHERS = {
    "add_argument", "append", "default", "format", "items", "keys", "pop", "setdefault", "sleep", "strict", "values",
}  # fmt: skip
"""What it uses of other packages."""
OWN = {"BACK", "LEFT", "high", "low", "once"}
"""Its codes and arguments."""


def test_band_works(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "tests/feature/band", tmp_path / "rsb_band", ignore=shutil.ignore_patterns("__pycache__"))
    describe(tmp_path, "rsb-band", "band = rsb_band:FEATURE\n")
    assert "5 passed" in passed(tmp_path, "band_inside.py")


def test_the_pages_name_all_that_it_uses() -> None:
    """A reader of only these pages can write it: each name and member of rsb-console that it uses is on one."""
    pages = " ".join((ROOT / f"docs/{page}.md").read_text() for page in PAGES)
    words = set(re.findall(r"\w+", pages))
    own, used = set(OWN), set[str]()
    for path in (ROOT / "tests/feature/band").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            match node:
                case ast.ImportFrom(module=str(module), level=0) if module.startswith("rsb_"):
                    used |= {each.name for each in node.names}
                case ast.Attribute(attr=name) | ast.keyword(arg=str(name)):
                    used.add(name)
                case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                    own.add(name)
    assert {name for name in used - own - OTHERS if not name.startswith("_")} - words == set()

"""Helpers stand in modules of their own: a reader of a test has no other tests to read."""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING

from tests.checks.class_bases import ROOT

if TYPE_CHECKING:
    from collections.abc import Iterator

FOLDERS = [ROOT / "tests", ROOT / "bench", ROOT / "docs", *ROOT.glob("extras/rsb_extras/*/tests")]
_MAY_IMPORT = re.compile(r"^\s*(from|import) .*\btest_", re.MULTILINE)
OTHERS = {"test_msgs"}
"""Packages of ROS."""


def imported_tests(text: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            names = {*(node.module or "").split("."), *(each.name for each in node.names)}
        elif isinstance(node, ast.Import):
            names = {part for each in node.names for part in each.name.split(".")}
        else:
            continue
        yield from (name for name in names - OTHERS if name.startswith("test_"))


def test_no_module_imports_a_test_module() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {name}"
        for folder in FOLDERS
        for path in folder.rglob("*.py")
        if _MAY_IMPORT.search(text := path.read_text(encoding="utf-8"))  # to parse all takes seconds
        for name in imported_tests(text)
    ]
    assert found == []

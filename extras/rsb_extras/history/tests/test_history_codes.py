"""Every code of the history's events is documented, and only those; its times come from its clock."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from rsb_extras.history.history_codes import HistoryCode

_FOLDER = Path(__file__).parents[1]


def test_page_lists_every_code_in_order() -> None:
    table = (_FOLDER / "docs/history.md").read_text(encoding="utf-8").partition("## Events\n")[2].partition("\n## ")[0]
    cells = re.findall(r"^\| (`[^|]+`) \|", table, re.MULTILINE)
    assert [code for cell in cells for code in re.findall(r"`([^`]+)`", cell)] == list(HistoryCode)


@pytest.mark.parametrize("name", ["keeper", "recorder", "timeline", "track_record", "history_files"])
def test_recording_modules_import_no_clock(name: str) -> None:
    tree = ast.parse((_FOLDER / f"{name}.py").read_text(encoding="utf-8"))
    names = {each.name for node in ast.walk(tree) if isinstance(node, ast.Import) for each in node.names}
    names |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not names & {"time", "datetime", "random"}

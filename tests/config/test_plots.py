"""The picture and the tables of figures are those of the figures in this tree."""

from __future__ import annotations

import runpy
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_picture_is_up_to_date() -> None:
    drawn = runpy.run_path(str(DOCS / "plots.py"))["drawn"]()
    assert (DOCS / "figures/beside.svg").read_text(encoding="utf-8") == drawn, "make plots"
    assert drawn.count("<circle") == 7  # a bridge each


def test_tables_are_up_to_date() -> None:
    page = runpy.run_path(str(DOCS / "foreign_table.py"))["page"]()
    assert (DOCS / "foreign.md").read_text(encoding="utf-8") == page, "make plots"

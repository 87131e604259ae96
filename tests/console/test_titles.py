"""Titles of borders are plain text: Textual reads a `str` as markup, which a peer's name may break."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

import pytest
from tests.support.screen_sources import FOLDERS, found_in

if TYPE_CHECKING:
    from pathlib import Path


def markup(source: str) -> list[str]:
    """The titles that are neither written out nor `Content`."""
    given = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Assign)]
    titles = [each for each in given if ast.unparse(each.targets[0]).endswith((".border_title", ".border_subtitle"))]
    return [
        ast.unparse(each)
        for each in titles
        if not isinstance(each.value, ast.Constant) and not ast.unparse(each.value).startswith("Content(")
    ]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_titles_are_plain(folder: Path) -> None:
    assert found_in(folder, markup) == {}


def test_markup_is_found() -> None:
    source = "self.border_title = name\nself.border_title = 'Help'\nself.border_subtitle = Content(name)"
    assert markup(source) == ["self.border_title = name"]

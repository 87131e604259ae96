"""The feature that docs/a-feature.md shows is built from that page, installed, and tried on both sides of a link."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from tests.feature.own_process import ROOT, describe, passed

if TYPE_CHECKING:
    from pathlib import Path

_FILE = re.compile(r"^```(?:python|toml)\n# (?P<path>\S+)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)


def built(folder: Path) -> Path:
    """Write the package of the page to a folder, with the metadata that its installation would leave."""
    files = {each["path"]: each["text"] for each in _FILE.finditer((ROOT / "docs/a-feature.md").read_text())}
    assert set(files) == {"pyproject.toml", "rsb_note/__init__.py", "rsb_note/bridge.py", "rsb_note/console.py"}
    (entry,) = re.findall(r'^note = "(.+)"$', files.pop("pyproject.toml"), re.MULTILINE)
    describe(folder, "rsb-note", f"note = {entry}\n")
    for path, text in files.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(text)
    return folder


def test_the_feature_of_the_page_works(tmp_path: Path) -> None:
    assert "7 passed" in passed(built(tmp_path), "note_inside.py")

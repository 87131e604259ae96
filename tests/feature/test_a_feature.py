"""The feature that docs/a-feature.md shows is built from that page, installed, and tried on both sides of a link."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
_FILE = re.compile(r"^```(?:python|toml)\n# (?P<path>\S+)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)


def built(folder: Path) -> Path:
    """Write the package of the page to a folder, with the metadata that its installation would leave."""
    files = {each["path"]: each["text"] for each in _FILE.finditer((ROOT / "docs/a-feature.md").read_text())}
    assert set(files) == {"pyproject.toml", "rsb_note/__init__.py", "rsb_note/bridge.py", "rsb_note/console.py"}
    (entry,) = re.findall(r'^note = "(.+)"$', files.pop("pyproject.toml"), re.MULTILINE)
    metadata = folder / "rsb_note-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: rsb-note\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(f"[rsb_console.feature]\nnote = {entry}\n")
    for path, text in files.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(text)
    return folder


def test_the_feature_of_the_page_works(tmp_path: Path) -> None:
    environ = os.environ | {"PYTHONPATH": f"{built(tmp_path)}:{os.environ.get('PYTHONPATH', '')}"}
    environ = {name: value for name, value in environ.items() if not name.startswith("PYTEST_")}
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/feature/note_inside.py"],
        cwd=ROOT, env=environ, capture_output=True, text=True, timeout=900, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "7 passed" in ran.stdout

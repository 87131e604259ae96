"""Features that fail in each method, or take names of each kind, stop no command, no bridge and no console."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
_ENTRIES = """\
[rsb_console.feature]
failing = rsb_door:FAILING
greedy = rsb_door:GREEDY
twin = rsb_door:TWIN
nonsense = rsb_door:METHODS
unloadable = rsb_door:NOTHING
needy = rsb_door:NEEDY
"""


def test_no_feature_stops_a_bridge(tmp_path: Path) -> None:
    package, metadata = tmp_path / "rsb_door", tmp_path / "rsb_door-1.0.dist-info"
    package.mkdir()
    (package / "__init__.py").write_text((ROOT / "tests/feature/door_features.py").read_text())
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: rsb-door\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(_ENTRIES)
    environ = os.environ | {"PYTHONPATH": f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"}
    environ = {name: value for name, value in environ.items() if not name.startswith("PYTEST_")}
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/feature/door_inside.py"],
        cwd=ROOT, env=environ, capture_output=True, text=True, timeout=900, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "failed" not in ran.stdout

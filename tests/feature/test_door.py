"""Features that fail in each method, or take names of each kind, stop no command, no bridge and no console."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.feature.own_process import ROOT, describe, passed

if TYPE_CHECKING:
    from pathlib import Path

_ENTRIES = """\
failing = rsb_door:FAILING
greedy = rsb_door:GREEDY
twin = rsb_door:TWIN
nonsense = rsb_door:METHODS
unloadable = rsb_door:NOTHING
needy = rsb_door:NEEDY
older = rsb_door:OLDER
"""


def test_no_feature_stops_a_bridge(tmp_path: Path) -> None:
    package = tmp_path / "rsb_door"
    package.mkdir()
    (package / "__init__.py").write_text((ROOT / "tests/feature/door_features.py").read_text())
    describe(tmp_path, "rsb-door", _ENTRIES)
    assert "failed" not in passed(tmp_path, "door_inside.py")

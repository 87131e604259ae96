"""Groups of tests that `make test` runs in one worker."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

from tests.support import lanes


def test_folders_and_files_that_lanes_name_exist() -> None:
    tests = Path(__file__).parents[1]
    named = {*lanes.COMPUTING, *lanes.ALONE, *lanes.SHARED, *(set(lanes.FIRST) - set(lanes.COMPUTING.values()))}
    assert [name for name in named if not any((folder / name).exists() for folder in (tests, tests.parent))] == []


def test_folders_have_few_lanes_and_other_files_their_own() -> None:
    computing = {lanes.lane_of(f"tests/{folder}/test_x.py::test_y[a::b]") for folder in lanes.COMPUTING}
    assert {lane.split("/")[0] for lane in computing} == {"simulation", "checks", "pure"}
    files = [f"tests/simulation/test_{letter}.py::test_y" for letter in "abcdefg"]
    assert len({lanes.lane_of(each) for each in files}) == lanes.SHARED["simulation"]
    assert lanes.lane_of("tests/engine/test_late.py::test_y[a/b::c]") == "tests/engine/test_late.py"
    assert lanes.lane_of("tests/network/test_x.py::test_y") == lanes.lane_of("tests/network/test_z.py::test_y")


def test_longest_first_waiting_and_computing_alternate() -> None:
    names = [
        f"tests/{folder}/test_{number}.py::test" for folder in ("engine", "console", "simulation") for number in (1, 2)
    ]
    items = [SimpleNamespace(nodeid=name) for name in names]
    lanes.sort_by_lane(items)  # type: ignore[arg-type]  # it reads their ids only
    assert [lanes.folder_of(each.nodeid) for each in items] == [
        "simulation", "simulation", "engine", "console", "engine", "console"
    ]  # fmt: skip

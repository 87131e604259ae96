"""Names as people sort them."""

from __future__ import annotations

from rsb_bridge.model.names import natural_order


def test_numbers_count_as_such() -> None:
    names = ["robot10", "arm", "robot2", "robot", "robot2b", "robot02", "2", "10", "robot2a10", "robot2a9"]
    assert sorted(names, key=natural_order) == [
        "2", "10", "arm", "robot", "robot2", "robot02", "robot2a9", "robot2a10", "robot2b", "robot10",
    ]  # fmt: skip


def test_any_name_has_its_place() -> None:
    assert sorted(["é5", "", "9" * 40, "x" + "1" * 40], key=natural_order)[0] == ""

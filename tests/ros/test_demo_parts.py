"""The demo's robot and desk, as processes of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.waiting import eventually

from rsb_console.session.demo_session import SimulatedPart

if TYPE_CHECKING:
    from pathlib import Path

    import pytest
    from tests.support.domain import Domain


def test_robot_publishes_without_home(robot: Domain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under a service manager, or with ``env -i``, ROS has no folder for its log."""
    for name in ("HOME", "ROS_HOME", "ROS_LOG_DIR"):
        monkeypatch.delenv(name, raising=False)
    part = SimulatedPart.start("robot", robot.id, tmp_path)
    try:
        eventually(lambda: part.published.get("/odom"), what="published")
    finally:
        part.stop()
    assert [each.name for each in tmp_path.iterdir()] == ["robot.log"], "no log of ROS"

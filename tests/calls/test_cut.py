"""An action over a short outage; `python -m tests.calls.cutting 30` plays longer ones, and bridges that are killed.

`tests/system/test_actions_killed.py` kills bridges in the middle of goals, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

pytest.importorskip("test_msgs", reason="no package with an action is installed (ros-jazzy-test-msgs)")

from tests.calls.cutting import OUTAGES, happen

if TYPE_CHECKING:
    from tests.support.domain import Domain


def test_goals_outlive_a_link_that_is_cut(robot: Domain, pc: Domain) -> None:
    cut, *_ = OUTAGES
    assert happen(cut, 1.0, robot, pc).numbers > 2

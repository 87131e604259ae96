"""An action over short outages: the link is cut, and either bridge is killed.

`python -m tests.calls.cutting 30` plays longer ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

pytest.importorskip("test_msgs", reason="no package with an action is installed (ros-jazzy-test-msgs)")

from tests.calls.cutting import OUTAGES, happen

if TYPE_CHECKING:
    from tests.calls.cutting import Outage
    from tests.support.domain import Domain


@pytest.mark.parametrize("outage", OUTAGES, ids=[outage.words for outage in OUTAGES])
def test_goals_outlive(outage: Outage, robot: Domain, pc: Domain) -> None:
    assert happen(outage, 1.0, robot, pc).numbers > 2

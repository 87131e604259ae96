"""Keys that a hung line delivers late move no robot: a real console in terminals and in tmux, counted in ROS.

A part of what ``python -m tests.system.torture.hands`` does.
"""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest
from tests.support.long import long_cases
from tests.system.torture import hands

if TYPE_CHECKING:
    from tests.system.torture.hands import Place


@pytest.mark.parametrize(("place", "hang"), [("direct", 2.5), *long_cases(("behind-tmux", 8.0), ("mute", 8.0))])
def test_late_keys_do_nothing(place: Place, hang: float, tmp_path_factory: pytest.TempPathFactory) -> None:
    if place == "behind-tmux" and shutil.which("tmux") is None:
        pytest.skip("needs tmux")
    names = ["3 keys", "arm and drive"]
    if place != "direct":
        names += ["9 in 3, 0.3 s", "y to a question"]
    with hands.Bed(place, tmp_path_factory.mktemp("hands")) as bed:
        found = {name: bed.late(hands.CASES[name], hang) for name in names}
    assert {name: result for name, result in found.items() if not result.is_harmless} == {}

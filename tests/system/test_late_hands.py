"""Keys that a hung line delivers late move no robot: a real console in a pseudo-terminal and in tmux, counted in ROS.

A part of what ``python -m tests.system.torture.hands`` does.
"""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest
from tests.support.long import long
from tests.system.torture import hands

if TYPE_CHECKING:
    from tests.system.torture.hands import Place


@pytest.mark.parametrize("place", ["direct", *long("behind-tmux")])
def test_late_keys_do_nothing(place: Place, tmp_path_factory: pytest.TempPathFactory) -> None:
    if place == "behind-tmux" and shutil.which("tmux") is None:
        pytest.skip("needs tmux")
    with hands.Bed(place, tmp_path_factory.mktemp("hands")) as bed:
        found = {name: bed.late(hands.CASES[name], 2.5) for name in ("3 keys", "arm and drive")}
    assert {name: result for name, result in found.items() if not result.is_harmless} == {}

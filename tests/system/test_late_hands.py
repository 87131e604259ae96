"""Keys that a hung line delivers late move no robot: a real console in terminals and in tmux, counted in ROS.

A part of what ``python -m tests.system.torture.hands`` does.
"""

from __future__ import annotations

import re
import shutil
from typing import TYPE_CHECKING

import pytest
from tests.support.long import long, long_cases
from tests.system.torture import hands

if TYPE_CHECKING:
    from tests.system.torture.hands import Place


def need(place: Place) -> None:
    for tool in hands.TOOLS.get(place, []):
        if shutil.which(tool) is None:
            pytest.skip(f"needs {tool}")


@pytest.mark.parametrize(
    ("place", "hang"),
    [("direct", 2.5), ("dtach-mosh", 2.5), *long_cases(("behind-tmux", 8.0), ("mute", 8.0), ("mosh", 8.0))],
)
def test_late_keys_do_nothing(place: Place, hang: float, tmp_path_factory: pytest.TempPathFactory) -> None:
    need(place)
    names = ["3 keys", "arm and drive"]
    if place.endswith("mosh"):
        names += ["1 key", "held for 8 s"]
    elif place != "direct":
        names += ["9 in 3, 0.3 s", "y to a question"]
    with hands.Bed(place, tmp_path_factory.mktemp("hands")) as bed:
        found = {name: bed.late(hands.CASES[name], hang) for name in names}
    assert {name: result for name, result in found.items() if not result.is_harmless} == {}


@pytest.mark.parametrize("round_trip", [0.2, *long(0.06, 0.4)])
def test_key_held_over_mosh_drives_until_let_go(round_trip: float, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Once of several times: on a busy machine, the hand that holds it here stands still, too."""
    need("mosh")
    with hands.Bed("mosh", tmp_path_factory.mktemp("hands"), round_trip) as bed:
        found: list[str] = []
        for _ in range(10):
            if not bed.armed:
                bed.to_list()
                bed.arm_and_drive()
            found.append("".join("m" if each.number else "." for each in bed.hold(3.0)))
            if re.fullmatch(r"m{10,}\.+", found[-1]):
                break
        else:
            pytest.fail(f"moved in parts: {found}")

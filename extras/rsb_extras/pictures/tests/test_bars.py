"""Batteries and joints as bars."""

from __future__ import annotations

import math

import msgspec
import pytest
from sensor_msgs.msg import BatteryState, JointState
from tests.support.wording import has_text

from rsb_extras.pictures.picture import Cells, Picture, Series, Wish
from rsb_extras.pictures.tests.samples import cells_of, drawn, task
from rsb_extras.pictures.value_bars import BarProblem
from rsb_extras.pictures.worker import Artist

WISH = Wish(width=60, height=12)


def rows(picture: Picture) -> list[str]:
    return [row.rstrip() for row in cells_of(picture).rows]


def styles(picture: Picture, character: str) -> set[str]:
    """Return the styles of a character."""
    cells: Cells = cells_of(picture)
    each = zip("".join(cells.rows), cells.styles, strict=True)
    return {cells.palette[style] for found, style in each if found == character}


def battery(charge: float, **about: float) -> Picture:
    return drawn(WISH, BatteryState(percentage=charge, **about))


@pytest.mark.parametrize(("charge", "style"), [(0.8, "ok"), (0.25, "warning"), (0.1, "error")])
def test_bar_of_battery_is_as_long_as_its_charge(charge: float, style: str) -> None:
    picture = battery(charge)
    bar = rows(picture)[1]
    assert bar.count("█") == pytest.approx(charge * 58, abs=1)
    assert len(bar) == 59
    assert styles(picture, "█") == {style}
    assert f"{charge:.0%}" in rows(picture)[0]


def test_battery_has_its_state_and_its_figures() -> None:
    message = BatteryState(
        percentage=62.0, voltage=24.5, current=-2.0, charge=6.0, capacity=10.0, power_supply_status=2,
        power_supply_health=2, cell_voltage=[3.5, 3.6], temperature=math.nan,
    )  # fmt: skip
    picture = drawn(WISH, message)
    text = "\n".join(rows(picture))
    for part in ("62%", "discharging", "OVERHEATED", "24.5 V", "-49 W", "6 Ah of 10 Ah", "3.0 h", "3.500 to 3.600 V"):
        assert part in text
    assert "°C" not in text


def test_battery_without_charge_says_so() -> None:
    picture = battery(math.nan, voltage=12.0)
    assert "unknown" in rows(picture)[0]
    assert not styles(picture, "█")
    assert any("12 V" in row for row in rows(picture))


JOINTS = JointState(name=["elbow", "wrist"], position=[1.0, -0.5], velocity=[0.0, 2.0])


def test_bars_of_joints_are_full_at_largest_value_seen() -> None:
    artist, wish = Artist(), Wish(width=80, height=6)
    artist.do(task(wish, JOINTS))
    half = artist.do(task(wish, JointState(name=["elbow", "wrist"], position=[0.5, 0.0], velocity=[0.0, 0.0])))
    assert half is not None
    full = rows(drawn(wish, JOINTS))
    assert full[1].startswith("elbow")
    assert rows(half)[1].count("█") == pytest.approx(full[1].count("█") / 2, abs=1)
    left, _, right = full[2].partition("│")
    assert left.count("█") == pytest.approx(full[1].count("█") / 2, abs=1)
    assert right.partition("│")[2].count("█") > 0
    assert {"position", "velocity/s"} == set(full[0].split())


def test_narrow_joints_are_values_alone() -> None:
    picture = drawn(Wish(width=36, height=6), JOINTS)
    assert not styles(picture, "█")
    assert "-0.5" in rows(picture)[2]


def test_joints_are_found_and_scrolled() -> None:
    many = JointState(name=[f"joint{at}" for at in range(50)], position=[1.0] * 50)
    assert rows(drawn(msgspec.structs.replace(WISH, match="joint7"), many))[1].startswith("joint7")
    assert rows(drawn(msgspec.structs.replace(WISH, y=-1.0), many))[1].startswith("joint12")
    picture = drawn(msgspec.structs.replace(WISH, match="knee"), many)
    assert has_text(picture.problem, BarProblem.NO_MATCH, joint="knee")


def test_joints_without_names_or_values() -> None:
    assert has_text(drawn(WISH, JointState()).problem, BarProblem.NO_JOINTS)
    assert rows(drawn(WISH, JointState(effort=[1.0])))[1].startswith("[0]")
    nothing = JointState(name=["a"], position=[math.nan])
    assert "nan" in rows(drawn(WISH, nothing))[1]


def test_chosen_numbers_of_joints_are_plotted() -> None:
    assert isinstance(
        drawn(msgspec.structs.replace(WISH, how="plot", fields=("position[elbow]",)), JOINTS).content, Series
    )

"""A goal on a map: its cell, its arrow, and the fields of its pose."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_bridge.config.fields_text import read_fields
from rsb_extras.pictures.goal_on_map import Goal
from rsb_extras.pictures.picture import Scale

SCALE = Scale("map", -2.0, 3.0, 0.1, 0.2)


@pytest.mark.parametrize("cell", [(0, 0), (7, 3), (-4, -1), (100, 50)])
def test_a_goal_lies_in_its_cell(cell: tuple[int, int]) -> None:
    goal = Goal.at(SCALE, cell[0] + 0.5, cell[1] + 0.5)
    assert goal.cell(SCALE) == cell
    assert (goal.frame, goal.heading) == ("map", 0.0)
    assert goal[1:3] == pytest.approx((-1.95 + 0.1 * cell[0], 2.9 - 0.2 * cell[1]))
    assert goal.moved(SCALE, 2, -1).cell(SCALE) == (cell[0] + 2, cell[1] - 1)


@pytest.mark.parametrize(
    ("degrees", "arrow"),
    [(0, "→"), (45, "↗"), (90, "↑"), (135, "↖"), (180, "←"), (-135, "↙"), (-90, "↓"), (-45, "↘"), (15, "→"), (30, "↗")],
)
def test_the_arrow_points_to_the_heading(degrees: float, arrow: str) -> None:
    assert Goal("map", 0.0, 0.0).turned(degrees).arrow == arrow
    assert Goal("map", 0.0, 0.0).turned(degrees + 720).arrow == arrow


def test_a_goal_has_the_fields_of_a_pose() -> None:
    goal = Goal("map", 1.25, -0.5).turned(90)
    assert read_fields(goal.fields()) == {
        "header": {"stamp": "now", "frame_id": "map"},
        "pose": {
            "position": {"x": "1.250", "y": "-0.500"},
            "orientation": {"z": f"{math.sqrt(0.5):.6f}", "w": f"{math.sqrt(0.5):.6f}"},
        },
    }


@pytest.mark.parametrize(
    "frame",
    [
        "", "~", "null", "1.0", "yes", "a: b", "a, b}", "# none", "'", '"', '"\\', "\\n", "a\nb: 1", "{x: 1}", "- a",
        "&a", "*a", "!tag x", "%", "@", "`", "\x1b[2J", "\x7f", "\x85", "\u2028", "\u202e", "\ufeff", "地図", "😀",
    ],
)  # fmt: skip
def test_a_frame_is_one_value(frame: str) -> None:
    is_one_value(frame)


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_any_frame_is_one_value(frame: str) -> None:
    is_one_value(frame)


def is_one_value(frame: str) -> None:
    fields = read_fields(Goal(frame, 0.0, 0.0).fields())
    assert isinstance(fields, dict)
    assert fields.keys() == {"header", "pose"}
    assert fields["header"] == {"stamp": "now", "frame_id": frame}


def test_goal_on_map_of_any_scale_has_cell() -> None:
    goal = Goal("map", 1e302, -1e302)
    for size in (1e-300, 1.0, 1e300):
        assert all(abs(each) < 1e5 for each in goal.cell(Scale("map", -1e300, 1e300, size, size)))

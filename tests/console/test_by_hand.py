"""Goals as the fields of messages, and tickets."""

from __future__ import annotations

import asyncio
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.console.scripted import ScriptedEngine
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.config.fields_text import read_fields
from rsb_bridge.model.by_hand import Published
from rsb_bridge.model.pictures import Scale
from rsb_console.session.manual_messages import POSE, ByHandText, Goal, publish

SCALE = Scale("map", -2.0, 3.0, 0.1, 0.2)


# -- goals


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
    _is_one_value(frame)


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_any_frame_is_one_value(frame: str) -> None:
    _is_one_value(frame)


def _is_one_value(frame: str) -> None:
    fields = read_fields(Goal(frame, 0.0, 0.0).fields())
    assert isinstance(fields, dict)
    assert fields.keys() == {"header", "pose"}
    assert fields["header"] == {"stamp": "now", "frame_id": frame}


# -- tickets

DONE, OLD = Published(is_done=True, ticket=9), Published(is_done=False, ticket=7)


def published_with(*answers: Published | EngineError) -> tuple[Published, list[int]]:
    """Publish on an engine that gives these answers. Return the result, and the ticket of each command."""
    engine = ScriptedEngine()
    engine.published = [*answers]
    result = asyncio.run(publish(engine, "/cmd", "data: x", POSE))
    sent = [each[1] for each in engine.commands]
    assert {(each.topic, each.fields, each.type_name) for each in sent} == {("/cmd", "data: x", POSE)}  # type: ignore[attr-defined]
    return result, [each.ticket for each in sent]  # type: ignore[attr-defined]


def test_a_command_is_repeated_with_the_ticket_of_its_answer() -> None:
    assert published_with(DONE) == (DONE, [0])
    assert published_with(OLD, DONE) == (DONE, [0, 7])
    assert published_with(OLD, OLD, DONE) == (DONE, [0, 7, 7])


def test_a_bridge_that_answers_too_slowly_publishes_nothing() -> None:
    with pytest.raises(EngineError, match=pattern(ByHandText.TOO_SLOW, topic="/cmd")):
        published_with(OLD, OLD, OLD, DONE)


def test_a_refusal_is_not_repeated() -> None:
    with pytest.raises(EngineError, match="no luck"):
        published_with(EngineError("no luck"), DONE)


def test_without_a_session_nothing_is_published() -> None:
    with pytest.raises(EngineError, match=pattern(ByHandText.NO_SESSION)):
        asyncio.run(publish(None, "/cmd", ""))

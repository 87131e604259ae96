"""Numbers over time."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, JointState, LaserScan, Temperature
from std_msgs.msg import Float64, Float64MultiArray, Header, String
from tests.support.held import held_by
from tests.support.wording import has_text

from rsb_extras.pictures.drawing import TakenMessage, UndrawableError
from rsb_extras.pictures.picture import (
    MOST_NUMBERS,
    Curve,
    Picture,
    Series,
    Wish,
    decode_picture,
    encode_picture,
    field_of,
)
from rsb_extras.pictures.picture_rows import AXIS, picture_rows
from rsb_extras.pictures.plots import NUMBERS, VALUES, NumbersView, PlotProblem, PlotView
from rsb_extras.pictures.tests.samples import drawn, task
from rsb_extras.pictures.worker import Artist

WISH = Wish(width=20, height=10, how="plot", seconds=10.0)


def series(picture: Picture) -> Series:
    assert isinstance(picture.content, Series), picture.problem
    return picture.content


def test_values_are_in_their_columns() -> None:
    messages = [Float64(data=float(at)) for at in range(11)]
    artist = Artist()
    picture = artist.do(task(WISH, *messages, every=1.0))
    assert picture is not None
    (curve,) = series(picture).curves
    values = [value for value in curve.lows if value is not None]
    assert values == sorted(values)
    assert (values[0], values[-1], curve.last, curve.mean) == (0.0, 10.0, 10.0, 5.0)
    assert len(curve.lows) == len(curve.highs) == 40


def test_a_column_keeps_the_lowest_and_the_highest() -> None:
    (curve,) = series(drawn(WISH, *[Float64(data=value) for value in (3.0, -1.0, 2.0)])).curves
    assert min(value for value in curve.lows if value is not None) == -1.0
    assert max(value for value in curve.highs if value is not None) == 3.0


def test_chosen_fields_and_joints_by_name() -> None:
    message = JointState(name=["arm", "hand"], position=[1.0, 2.0])
    wish = Wish(width=20, height=10, how="plot", fields=("position[hand]",))
    assert [(curve.name, curve.last) for curve in series(drawn(wish, message)).curves] == [("position[hand]", 2.0)]


def test_usual_fields() -> None:
    assert [curve.name for curve in series(drawn(WISH, BatteryState())).curves][:2] == ["percentage", "voltage"]
    assert all("covariance" not in curve.name for curve in series(drawn(WISH, Odometry())).curves)


def test_what_never_changes_is_not_offered_first() -> None:
    scan = LaserScan(angle_min=1.0, angle_max=2.0, time_increment=3.0, ranges=[5.0, 4.0, math.inf, *[6.0] * 20])
    assert [(curve.name, curve.last) for curve in series(drawn(WISH, scan)).curves] == [("min(ranges)", 4.0)]
    image = [curve.name for curve in series(drawn(WISH, Temperature(temperature=20.0, variance=1.0))).curves]
    assert image == ["temperature"]
    assert series(drawn(WISH, Header())).curves, "there is nothing else"


def test_long_array_has_lowest_mean_and_highest() -> None:
    wish = Wish(width=20, height=10, how="plot", fields=("min(data)", "mean(data)", "max(data)"))
    message = Float64MultiArray(data=[float(at) for at in range(101)])
    assert [curve.last for curve in series(drawn(wish, message)).curves] == [0.0, 50.0, 100.0]
    assert "min(data)" not in numbers(Float64MultiArray(data=[1.0, 2.0]))


# -- several topics


def taken(topic: str, value: float, at: float = 1.0, type_name: str = "std_msgs/msg/Float64") -> TakenMessage:
    return TakenMessage(topic, type_name, {"data": value, "other": value}, at)


def plotted(*fields: str, view: PlotView | None = None) -> list[tuple[str, float | None]]:
    if view is None:
        view = PlotView()
        for message in (taken("/a", 1.0), taken("/b", 2.0)):
            view.receive(message)
    content = view.draw(msgspec.structs.replace(WISH, fields=fields)).content
    assert isinstance(content, Series)
    return [(curve.name, curve.last) for curve in content.curves]


def test_curves_of_several_topics_are_named_by_them() -> None:
    assert plotted("/b:data", "/a:other") == [("/b data", 2.0), ("/a other", 1.0)]
    assert plotted("data") == [("/a data", 1.0)]
    assert plotted() == [("/a data", 1.0), ("/a other", 1.0), ("/b data", 2.0), ("/b other", 2.0)]


def test_topic_without_message_is_named() -> None:
    with pytest.raises(UndrawableError) as caught:
        plotted("/a:data", "/c:data")
    assert has_text(str(caught.value), PlotProblem.NO_MESSAGE, topic="/c")


def test_chosen_number_is_remembered_beyond_the_limit() -> None:
    view = PlotView()
    many = TakenMessage("/a", "x", {f"f{at}": 1.0 for at in range(NUMBERS)}, 1.0)
    view.receive(many)
    view.draw(msgspec.structs.replace(WISH, fields=("f1",)))
    with pytest.raises(UndrawableError):
        plotted("/b:data", view=view)
    view.receive(taken("/b", 2.0))
    assert plotted("/b:data", view=view) == [("/b data", 2.0)]


# -- the numbers to choose from


def numbers(*messages: Any, match: str = "") -> dict[str, float | None]:
    picture = drawn(Wish(how="fields", match=match), *messages)
    assert picture.content is None
    assert decode_picture(encode_picture(picture)) == picture
    return {each.path: each.value for each in picture.numbers}


def test_numbers_are_listed_with_newest_values() -> None:
    found = numbers(Odometry(), Odometry())
    assert found["twist.twist.linear.x"] == 0.0
    assert numbers(Float64(data=1.0), Float64(data=3.0)) == {"data": 3.0}
    assert numbers(Float64(data=math.nan)) == {"data": None}
    assert set(numbers(Odometry(), match="angular")) == {f"twist.twist.angular.{axis}" for axis in "xyz"}


def test_listed_numbers_are_bounded() -> None:
    view = NumbersView()
    for at in range(3):
        view.receive(TakenMessage(f"/t{at}", "x", {f"f{n}{'x' * n}": 1.0 for n in range(400)}, 1.0))
    listed = view.draw(Wish()).numbers
    assert len(listed) <= MOST_NUMBERS
    assert max(len(field_of(each.topic, each.path)) for each in listed) <= 255


def test_misspelt_field_is_named_with_next_ones() -> None:
    wish = Wish(width=20, height=10, how="plot", fields=("pose.pose.positon.x",))
    picture = drawn(wish, Odometry())
    assert has_text(picture.problem, PlotProblem.UNKNOWN_FIELD)
    assert "pose.pose.position.x" in picture.problem


def test_a_message_without_numbers() -> None:
    assert has_text(drawn(WISH, String(data="x")).problem, PlotProblem.NO_NUMBERS)


def test_what_is_no_number_is_left_out() -> None:
    (curve,) = series(drawn(WISH, Float64(data=math.nan), Float64(data=math.inf), Float64(data=1.0))).curves
    assert (curve.last, curve.mean) == (1.0, 1.0)


def test_memory_is_bounded() -> None:
    view = PlotView()
    for at in range(2 * VALUES):
        view.receive(TakenMessage("/t", "std_msgs/msg/Float64", {"data": float(at)}, at * 1e-3))
    assert held_by(view) <= 1 + 2 * (1.25 * VALUES + 1), "a topic, and the time and the number of each value"


CURVES = (
    Curve(
        "a", tuple(math.sin(at / 5) for at in range(40)), tuple(math.sin(at / 5) + 0.1 for at in range(40)), 0.5, 0.1
    ),
    Curve("b", (None,) * 40, (None,) * 40),
)


@pytest.mark.parametrize(("width", "height"), [(80, 24), (20, 6), (1, 1), (300, 100)])
def test_rows_fit_the_window(width: int, height: int) -> None:
    rows = picture_rows(Series(0.0, 0.25, CURVES), width, height)
    assert len(rows) <= height
    if width >= 20:
        assert all(sum(len(part.text) for part in row) <= width for row in rows)


def test_labels_of_large_values_leave_the_axis_straight() -> None:
    *rows, _axis, _times, _legend = picture_rows(Series(0.0, 1.0, (Curve("a", (-3e200,), (3e200,)),)), 40, 24)
    assert {len(row[0].text) for row in rows} == {AXIS - 1}


@pytest.mark.parametrize("value", [1.7e308, -1.7e308, math.inf, math.nan, 5e-324])
def test_extreme_values_are_drawn_or_left_out(value: float) -> None:
    content = series(decode_picture(encode_picture(drawn(WISH, Float64(data=value), Float64(data=1.0)))))
    assert len(picture_rows(content, 40, 10)) == 10


def test_names_of_joints_are_fit_for_terminals() -> None:
    picture = drawn(WISH, JointState(name=["\x1b[2J", "x" * 300], position=[1.0, 2.0]))
    assert len(series(decode_picture(encode_picture(picture))).curves) == 1

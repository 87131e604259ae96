"""How the clocks of two recordings compare, and what ages follow."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from rsb_extras.audit.tests.conftest import Audited, Sides
from rsb_extras.audit.tests.written import LATCHED

Run = Callable[..., Audited]


@pytest.fixture(params=[0.0, 3.5, -7200.0])
def ahead(request: pytest.FixtureRequest) -> float:
    found: float = request.param
    return found


def test_messages_both_ways_tell_the_offset(ahead: float, sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"), age=0.020)
    sides.stream(sides.topic("/cmd_vel"), age=0.030, back=True)
    found = audited("--back", "/cmd_*")
    assert (found.json["offset_by"], found.code) == ("two_ways", 0)
    assert found.json["offset"] == pytest.approx(ahead - 0.005, abs=1e-5)  # as the ways differ by 10 ms
    assert found.json["offset_uncertainty"] == pytest.approx(0.025, abs=1e-5)
    assert (found["/scan"]["way"], found["/cmd_vel"]["way"]) == ("to_far", "to_near")
    assert found["/scan"]["age_p50"] == pytest.approx(0.029, abs=1e-5)
    assert found["/cmd_vel"]["age_p50"] == pytest.approx(0.029, abs=1e-5)
    assert found["/scan"]["age_p99"] == pytest.approx(0.034, abs=1e-5)


@pytest.mark.parametrize("by", ["delays", "alone"])
def test_messages_tell_their_way(by: str, ahead: float, sides: Sides, audited: Run) -> None:
    sides.spans(15)
    lost = {20, 50} if by == "alone" else set[int]()
    tail = 0.3 if by == "delays" else 0.0
    sides.stream(sides.topic("/scan"), lost=lost, tail=tail)
    sides.stream(sides.topic("/cmd_vel"), back=True, lost=lost, tail=tail)
    sides.stream(sides.topic("/odom"))
    found = audited()
    ways = {topic: (found[topic]["way"], found[topic]["way_by"]) for topic in ("/scan", "/cmd_vel", "/odom")}
    assert ways == {"/scan": ("to_far", by), "/cmd_vel": ("to_near", by), "/odom": ("to_far", "clocks")}
    assert found.json["offset"] == pytest.approx(ahead, abs=1e-5)


def test_way_is_said_to_be_assumed(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    found = audited()
    assert (found["/scan"]["way"], found["/scan"]["way_by"]) == ("to_far", "assumed")


def test_one_way_tells_ages_above_the_least(ahead: float, sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    sides.stream(sides.topic("/far_scan"), age=0.120)
    found = audited()
    assert (found.json["offset_by"], found.json["offset_uncertainty"]) == ("least_age", None)
    assert found.json["offset"] == pytest.approx(ahead + 0.020, abs=1e-5)
    assert found["/scan"]["age_p50"] == pytest.approx(0.004, abs=1e-5)
    assert found["/far_scan"]["age_p50"] == pytest.approx(0.104, abs=1e-5)


def test_given_offset_tells_ages_and_ways(ahead: float, sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    sides.stream(sides.topic("/cmd_vel"), back=True, lost={50})
    found = audited(f"--offset={ahead}")
    assert found.json["offset_by"] == "option"
    assert found["/scan"]["age_p50"] == pytest.approx(0.024, abs=1e-5)
    assert (found["/cmd_vel"]["way"], found["/cmd_vel"]["lost"]) == ("to_near", 1)
    assert found.breaches == {("lost", "/cmd_vel", 1)}


def test_latched_messages_tell_no_offset(ahead: float, sides: Sides, audited: Run) -> None:
    """NEAR's recorder came 3 s after FAR's, and got the message then."""
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    topic = sides.topic("/map", durability=LATCHED)
    sides.near.add(topic, 4.0, 1)
    sides.far.add(topic, 1.0, 1)
    for side, name in zip(sides, ("/near_map", "/far_map"), strict=True):
        for each in sides:
            each.topic(name, durability=LATCHED if each is side else "volatile")
        sides.near.add(name, 4.0, 1)
        sides.far.add(name, 1.0, 1)
    found = audited()
    assert found.json["offset"] == pytest.approx(ahead + 0.020, abs=1e-5)
    assert (found["/map"]["latched_value"], found["/map"]["age_p50"]) == ("same", None)
    assert "/map" not in {name for _, name, _ in found.breaches}


def test_repeated_messages_tell_no_offset(ahead: float, sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    topic = sides.topic("/mode")
    sides.far.add(topic, 3.0, 1)
    for at in (5.0, 6.0):
        sides.near.add(topic, at, 1)
    assert audited().json["offset"] == pytest.approx(ahead + 0.020, abs=1e-5)


@pytest.mark.parametrize("which", ["near", "far"])
@pytest.mark.parametrize("back", [1.0, 3.0])
def test_clock_set_back_disorders_nothing(which: str, back: float, sides: Sides, audited: Run) -> None:
    """Times of messages before it and after it mix, on the side that sends or on the other one."""
    sides.spans(15)
    topic = sides.topic("/scan")
    for number in range(200):
        at = 2 + number * 0.05
        later = {side: at - back * (number >= 100 and side == which) for side in ("near", "far")}
        sides.near.add(topic, later["near"], number)
        sides.far.add(topic, later["far"] + 0.02 + 0.06 * (number == 150), number)
    found = audited()
    assert (found["/scan"]["matched"], found["/scan"]["disordered"]) == (200, 1)

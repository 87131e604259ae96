"""The rate limit of a link's profile is shown on both sides, as the limits of the entry and of the rights are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import route
from tests.support.domain import BEST_EFFORT
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic
from rsb_console.notation.formats import beside_rate

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain


@pytest.mark.parametrize(
    ("entry", "shown"), [(Topic("/scan", "transmit"), "≤10"), (Topic("/scan", "transmit", max_rate=2.0), "≤2")]
)
def test_profile_limits_on_both_sides(entry: Topic, shown: str, bridge: Bridge, robot: Domain) -> None:
    robot.publisher("/scan", qos=BEST_EFFORT)
    both = bridge.both(entry, profile="lte")
    eventually(lambda: [beside_rate(route(each, "/scan")) for each in both] == [shown] * 2)
    for engine in both:
        engine.restart().result(60)
        eventually(lambda: [beside_rate(route(each, "/scan")) for each in both] == [shown] * 2)


def test_pattern_limits_on_both_sides(bridge: Bridge, robot: Domain) -> None:
    robot.publisher("/scan", qos=BEST_EFFORT)
    both = bridge.both(Topic("/sc*", "transmit", max_rate=5.0), profile="lte")
    eventually(lambda: [beside_rate(found) for each in both for found in each.snapshot().routes] == ["≤5"] * 2)

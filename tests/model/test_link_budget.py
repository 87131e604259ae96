"""The cost of a topic on a link, by the measured figures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from tests.console.scripted import NOW, route
from tests.model.link_budget_helpers import snapshot
from tests.support.wording import says

from rsb_bridge.model.capacity import LASTS, Capacity, CapacitySource, newer
from rsb_bridge.model.link_budget import (
    PER_MESSAGE,
    TYPICAL,
    CostText,
    LinkLoad,
    LoadSource,
    amount,
    as_report,
    cost_of,
    describe_cost,
    load_of,
)
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import RouteSnapshot, State
from rsb_bridge.telemetry.meters import Throughput

_SCAN = "sensor_msgs/msg/LaserScan"
_IMAGE = "sensor_msgs/msg/Image"


def sent(topic: str, priority: str, rate: float, size: float, **changes: Any) -> RouteSnapshot:
    spec = Topic(topic, "transmit", priority="high" if priority == "high" else "low" if priority == "low" else "normal")
    return route(topic, outgoing=True, spec=spec, rate=rate, bytes_per_second=rate * size, **changes)


def test_it_fits() -> None:
    now = snapshot(sent("/scan", "normal", 10.0, 4_000), carries=1e6)
    cost = cost_of(now, "robot1", Topic("/odom", "transmit"), rate=50.0, size=700.0)
    assert cost.load.bytes_per_second == pytest.approx(50.0 * (700.0 + PER_MESSAGE))
    assert (cost.over, cost.sufferers, cost.load.source) == (0.0, (), LoadSource.GIVEN)
    assert cost.gets == cost.load.bytes_per_second
    assert len(describe_cost(cost, NOW)) == 1


def test_who_suffers() -> None:
    """Lower priorities yield, the lowest first; the same one is crowded."""
    now = snapshot(
        sent("/scan", "high", 10.0, 4_000), sent("/map", "normal", 1.0, 200_000), sent("/camera", "low", 10.0, 60_000),
        carries=1e6,
    )  # fmt: skip
    cost = cost_of(now, "robot1", Topic("/points", "transmit"), rate=5.0, size=100_000.0)
    assert [each.topic for each in cost.sufferers] == ["/camera"]
    assert cost.gets == pytest.approx(cost.load.bytes_per_second)
    assert cost.over > 300_000
    first, second = describe_cost(cost, NOW)
    assert "3 min" in first
    assert "/camera" in second


def test_a_lower_one_yields_itself() -> None:
    now = snapshot(sent("/camera", "normal", 10.0, 60_000), carries=0.8e6)
    cost = cost_of(now, "robot1", Topic("/points", "transmit", priority="low"), rate=5.0, size=100_000.0)
    assert cost.sufferers == ()
    assert cost.gets < 0.5 * cost.load.bytes_per_second


def test_other_direction_and_other_links_do_not_count() -> None:
    now = snapshot(
        route("/cmd_vel", bytes_per_second=9e5), sent("/scan", "normal", 10.0, 9e4, link="robot2"), carries=1e6
    )
    assert cost_of(now, "robot1", Topic("/odom", "transmit"), rate=50.0, size=700.0).used == 0.0


def test_what_it_replaces_does_not_count() -> None:
    now = snapshot(sent("/scan", "normal", 10.0, 4_000), carries=1e6)
    assert cost_of(now, "robot1", Topic("/scan", "transmit", max_rate=5.0), replaces="/scan").used == 0.0


def test_nothing_is_known_of_the_link() -> None:
    cost = cost_of(snapshot(), "robot1", Topic("/scan", "transmit", type=_SCAN))
    assert (cost.capacity, cost.over, cost.sufferers) == (None, 0.0, ())
    assert len(describe_cost(cost, NOW)) == 1


def test_more_than_was_ever_seen() -> None:
    now = snapshot(sent("/other", "normal", 30.0, 500_000), carries=28e6, source=CapacitySource.SEEN)
    cost = cost_of(now, "robot1", Topic("/image", "transmit", type=_IMAGE))
    assert cost.over > 0
    assert as_report(cost)["capacity_source"] == "seen"
    assert len(describe_cost(cost, NOW)) == 2


def test_link_with_little_traffic_tells_nothing() -> None:
    """One that has just come up, for example."""
    now = snapshot(carries=1e3, source=CapacitySource.SEEN)
    cost = cost_of(now, "robot1", Topic("/image", "transmit", type=_IMAGE))
    assert (cost.capacity, cost.over, cost.sufferers) == (None, 0.0, ())
    assert cost.gets == cost.load.bytes_per_second
    measured = cost_of(snapshot(carries=1e3), "robot1", Topic("/image", "transmit", type=_IMAGE))
    assert measured.over > 0


def test_what_a_topic_brings() -> None:
    """Measured on the topic itself, else on one of its type, else what is usual, else nothing; limits hold for all."""
    routes = (sent("/scan", "normal", 12.0, 3_000), sent("/front", "normal", 8.0, 9_000))
    now = snapshot(*routes)
    assert load_of(now, Topic("/scan", "transmit"))[:3] == (12.0, 3_000.0, LoadSource.HERE)
    alike = load_of(now, Topic("/rear", "transmit"), type_name=_SCAN)
    assert (alike.source, alike.like) == (LoadSource.ALIKE, "/scan")
    usual = load_of(now, Topic("/image", "transmit", type=_IMAGE))
    assert usual == LinkLoad(*TYPICAL[_IMAGE], LoadSource.TYPICAL)
    assert load_of(now, Topic("/image", "transmit", type="Image")) == usual
    assert load_of(now, Topic("/image", "transmit", type=_IMAGE, max_rate=5.0)).rate == 5.0
    assert load_of(now, Topic("/image", "transmit", type=_IMAGE, expected_rate=7.0)).rate == 7.0
    unknown = cost_of(now, "robot1", Topic("/x", "transmit", type="my_msgs/msg/X"))
    assert unknown.load.source is LoadSource.UNKNOWN
    assert len(describe_cost(unknown, NOW)) == 1


def test_old_measurements_give_way() -> None:
    full = Capacity(1e6, CapacitySource.FULL, 100.0)
    less, more = (Capacity(rate, CapacitySource.SEEN, 200.0) for rate in (5e5, 2e6))
    assert newer(None, less) is less
    assert newer(full, less) is full
    assert newer(full, more) is more
    assert newer(full, Capacity(5e5, CapacitySource.SEEN, 101.0 + LASTS)).source == CapacitySource.SEEN
    assert newer(more, full) is full
    assert newer(Capacity(1e6, CapacitySource.FULL, 201.0 + LASTS), less) is less, "the clock was set back"


def test_throughput() -> None:
    """A link's capacity is measured within some seconds; a full link's figure replaces earlier ones."""
    meter = Throughput()
    for second in range(10):
        meter.measure(2e6, float(second), float(second), full=False)
    assert meter.capacity is not None
    assert (meter.capacity.bytes_per_second, meter.capacity.source) == (2e6, CapacitySource.SEEN)
    for second in range(10, 20):
        meter.measure(1e6, float(second), float(second), full=True)
    assert meter.capacity is not None
    assert (meter.capacity.bytes_per_second, meter.capacity.source) == (1e6, CapacitySource.FULL)


def test_present_traffic_shows_possible_and_more_may_fit() -> None:
    now = snapshot(sent("/camera", "low", 10.0, 60_000), carries=1e5, source=CapacitySource.SEEN)
    cost = cost_of(now, "robot1", Topic("/points", "transmit"), rate=5.0, size=100_000.0)
    assert cost.capacity is not None
    assert cost.capacity.bytes_per_second == cost.used
    assert cost.over == pytest.approx(cost.load.bytes_per_second)
    _, second = describe_cost(cost, NOW)
    assert says(second, CostText.PERHAPS_TOO_MUCH, amount=amount(cost.over))
    assert "/camera" in second


@pytest.mark.parametrize("state", [State.DISARMED, State.PAUSED, State.WAITING])
def test_stopped_flow_counts_as_before(state: State) -> None:
    """Its rate and its bytes fade, each in its own time."""
    fading = replace(
        sent("/cmd_vel", "normal", 0.037, 1.0), state=state, expected_rate=20.0, messages_total=100, bytes_total=5_200
    )
    assert load_of(snapshot(fading), Topic("/cmd_vel", "transmit"))[:3] == (20.0, 52.0, LoadSource.HERE)
    unknown = replace(fading, expected_rate=None)
    assert load_of(snapshot(unknown), Topic("/cmd_vel", "transmit")).source is LoadSource.UNKNOWN

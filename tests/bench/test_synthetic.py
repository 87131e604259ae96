"""Messages that no node publishes, on a clock that the test owns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from rsb_bridge.model.benchmark import bench_topic
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.ros.stand_in import NoRos
from rsb_bridge.ros.synthetic import Synthetic, SyntheticReader, SyntheticSource, Time, percentiles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.ros.ros_interface import RawMessage

TOPIC = bench_topic("tcp", "transmit")


class Clocks(Time):
    """Goes on only when somebody sleeps."""

    def __init__(self) -> None:
        self.passed = 0.0
        self.wall_ns = lambda: 10**18 + round(self.passed * 1e9)
        self.now = lambda: self.passed
        self.sleep = self._sleep

    def _sleep(self, seconds: Any) -> None:
        self.passed += seconds


@pytest.mark.parametrize(("rate", "count"), [(100.0, 50), (20_000.0, 4_000), (0.5, 1)])
def test_messages_come_at_their_rate_and_in_batches(rate: float, count: int) -> None:
    clocks, batches = Clocks(), list[list["RawMessage"]]()
    source = SyntheticSource(lambda batch: batches.append([*batch]), clocks, lambda: None)
    source.send(2500, rate, count)
    messages = [message for batch in batches for message in batch]
    assert [message.number for message in messages] == [*range(1, count + 1)]
    assert {len(message.payload) for message in messages} == {2500}
    assert max(map(len, batches)) <= 64
    assert source.sent == count
    assert source.rate == pytest.approx(rate, rel=0.1)


def test_large_messages_go_one_by_one() -> None:
    sizes: list[int] = []
    SyntheticSource(lambda batch: sizes.append(len(batch)), Clocks(), lambda: None).send(6_000_000, 1e6, 5)
    assert sizes == [1] * 5


def test_a_sender_that_does_not_keep_up_ends_and_says_how_fast_it_was() -> None:
    clocks = Clocks()

    def slow(_: Sequence[RawMessage]) -> None:
        clocks.passed += 64.0

    source = SyntheticSource(slow, clocks, lambda: None)
    source.send(100, 100.0, 10_000)
    assert 64 < source.sent < 300
    assert 0.5 < source.rate < 1.5


def test_what_arrives_is_counted_with_its_latency() -> None:
    clocks = Clocks()
    drain = SyntheticReader(clocks, lambda: None)

    def late(batch: Sequence[RawMessage]) -> None:
        clocks.passed += 0.25
        for message in batch:
            drain.publish(message.payload)

    source = SyntheticSource(late, clocks, lambda: None)
    source.send(100, 1.0, 8)
    assert drain.arrived == (8, (0.25, 0.25, 0.25))
    assert drain.bytes == 800
    drain.reset()
    assert drain.arrived == (0, (0.0, 0.0, 0.0))


def test_only_these_topics_are_synthetic_and_only_as_long_as_they_are_open() -> None:
    ros = Synthetic(NoRos(), Clocks())
    assert ros.publishers(TOPIC)
    assert ros.subscriptions(TOPIC)
    assert ros.publishers("/scan") == []
    with pytest.raises(RosError):
        ros.advertise("/scan", "a/msg/B", "", Qos(), "")
    publisher = ros.advertise(TOPIC, "a/msg/B", "", Qos(), "")
    subscription = ros.subscribe(TOPIC, "a/msg/B", "", Qos(), lambda _: None, "")
    assert [*ros.drains, *ros.sources] == [(TOPIC, ""), (TOPIC, "")]
    newer = ros.advertise(TOPIC, "a/msg/B", "", Qos(), "")
    publisher.close()
    assert ros.drains == {(TOPIC, ""): newer}
    newer.close()
    subscription.close()
    assert not ros.drains
    assert not ros.sources
    assert ros.node_name == NoRos.node_name


def test_percentiles() -> None:
    assert percentiles([]) == (0, 0, 0)
    assert percentiles([5]) == (5, 5, 5)
    assert percentiles(range(1000)) == (500, 990, 999)
    assert percentiles([*reversed(range(100))]) == (50, 99, 99)

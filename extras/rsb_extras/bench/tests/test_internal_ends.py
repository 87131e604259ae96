"""Messages that no node publishes, on a clock that the test owns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.internal_ends import InternalEnds
from rsb_bridge.ros.ros_interface import RawMessage, RosError, TopicSpec
from rsb_extras.bench.bench_ends import BenchDrain, BenchSource, Time, percentiles
from rsb_extras.bench.benchmark import BENCH

NAME = BENCH.route_name("tcp", "transmit")
SPEC = TopicSpec(NAME, "", "", Qos())


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
    source = BenchSource(lambda batch: batches.append([*batch]), clocks, lambda: None)
    source.send(2500, rate, count)
    messages = [message for batch in batches for message in batch]
    assert [message.number for message in messages] == [*range(1, count + 1)]
    assert {len(message.payload) for message in messages} == {2500}
    assert max(map(len, batches)) <= 64
    assert source.sent == count
    assert source.rate == pytest.approx(rate, rel=0.1)


def test_large_messages_go_one_by_one() -> None:
    sizes: list[int] = []
    BenchSource(lambda batch: sizes.append(len(batch)), Clocks(), lambda: None).send(6_000_000, 1e6, 5)
    assert sizes == [1] * 5


def test_slow_sender_ends_and_says_its_speed() -> None:
    clocks = Clocks()

    def slow(_: Sequence[RawMessage]) -> None:
        clocks.passed += 64.0

    source = BenchSource(slow, clocks, lambda: None)
    source.send(100, 100.0, 10_000)
    assert 64 < source.sent < 300
    assert 0.5 < source.rate < 1.5


def test_what_arrives_is_counted_with_its_latency() -> None:
    clocks = Clocks()
    drain = BenchDrain(clocks, lambda: None)

    def late(batch: Sequence[RawMessage]) -> None:
        clocks.passed += 0.25
        for message in batch:
            drain.publish(message.payload)

    source = BenchSource(late, clocks, lambda: None)
    source.send(100, 1.0, 8)
    assert drain.arrived == (8, (0.25, 0.25, 0.25))
    assert drain.bytes == 800
    drain.reset()
    assert drain.arrived == (0, (0.0, 0.0, 0.0))


def test_internal_route_has_ends_while_open_and_served() -> None:
    clocks, ends = Clocks(), InternalEnds[BenchSource, BenchDrain](BENCH)
    assert [each.type_name for each in ends.publishers(NAME) + ends.subscriptions(NAME)] == [BENCH.type_name] * 2
    for stranger in ("/scan", "/bench/tcp/transmit", "view/1", "bench", "bench/../scan"):
        assert ends.publishers(stranger) == ends.subscriptions(stranger) == []
    with pytest.raises(RosError):
        ends.advertise(SPEC, "robot1")
    with pytest.raises(RosError):
        ends.subscribe(SPEC, lambda _: None, "robot1")
    ends.serve(
        "robot1", lambda sink, closed: BenchSource(sink, clocks, closed), lambda closed: BenchDrain(clocks, closed)
    )
    publisher = ends.advertise(SPEC, "robot1")
    subscription = ends.subscribe(SPEC, lambda _: None, "robot1")
    assert [*ends.drains, *ends.sources] == [(NAME, "robot1")] * 2
    newer = ends.advertise(SPEC, "robot1")
    publisher.close()
    assert ends.drains == {(NAME, "robot1"): newer}
    newer.close()
    subscription.close()
    assert not ends.drains
    assert not ends.sources


def test_percentiles() -> None:
    assert percentiles([]) == (0, 0, 0)
    assert percentiles([5]) == (5, 5, 5)
    assert percentiles(range(1000)) == (500, 990, 999)
    assert percentiles([*reversed(range(100))]) == (50, 99, 99)

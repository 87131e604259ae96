"""The memory that DDS holds for slow subscribers of volatile topics is counted, on a simulated DDS."""

from __future__ import annotations

import contextlib
from collections import deque
from random import Random

import pytest
from tests.route.volatile_helpers import unwanted

from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.source_publishers import BURST_DEPTH, FREE, SlowSubscriberError, VolatileTopic
from rsb_bridge.wire.framing import Budget

LIMIT = 40_000_000


class Pool:
    """A publisher's memory as Fast DDS has it: the block freed last is used first, grows as needed, and stays.

    Attributes:
        stopped: whether the subscriber acknowledges nothing.
        held: bytes.
    """

    gid = b"pool"
    subscriber_count = 1
    refuses = False
    closed = False

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self.stopped = False
        self.held = 0
        self.asked = 0
        self.history: deque[int] = deque()
        self._free: list[int] = []

    @property
    def acknowledged(self) -> bool:
        self.asked += 1
        if not self.stopped:
            self._free.extend(self.history)
            self.history.clear()
        return not self.history

    def assert_liveliness(self) -> None:
        pass

    def publish(self, payload: bytes) -> None:
        if len(self.history) >= self.depth:
            self._free.append(self.history.popleft())
        memory = self._free.pop() if self._free else 0
        self.held += max(0, len(payload) - memory)
        self.history.append(max(memory, len(payload)))

    def close(self) -> None:
        self.held = 0
        self.closed = True


class Time:
    def __init__(self) -> None:
        self.s = 0.0

    def __call__(self) -> float:
        return self.s


def fill(topic: VolatileTopic) -> None:
    with contextlib.suppress(SlowSubscriberError):
        for _ in range(1000):
            topic.publish(bytes(1_000_000))
        pytest.fail("it takes everything")


@pytest.mark.parametrize("seed", range(5))
def test_it_never_holds_more_than_is_counted(seed: int) -> None:
    """Large and small messages, subscribers that stop and go on, in any order."""
    random, now, budget = Random(seed), Time(), Budget(LIMIT)
    pools = [Pool(random.choice((1, 10, 100, 10_000))) for _ in range(4)]
    topics = [VolatileTopic(pool, pool.depth, budget, now) for pool in pools]
    refused = 0
    looks = (None, None, lambda: None, unwanted)
    for _ in range(3000):
        now.s += random.choice((0.0, 0.001, 0.1))
        pool, topic = random.choice(list(zip(pools, topics, strict=True)))
        if random.random() < 0.01:
            pool.stopped = not pool.stopped
        try:
            topic.publish(bytes(random.choice((100, 1_000, 1_000, 500_000, 3_000_000))), random.choice(looks))
        except SlowSubscriberError:
            refused += 1
        assert sum(each.held for each in pools) <= budget.held + len(pools) * FREE
        assert budget.held < LIMIT
    assert refused
    for topic in topics:
        topic.close()
    assert budget.held == 0


def test_small_messages_pass_beside_full_topics() -> None:
    now, budget = Time(), Budget(LIMIT)
    hogs = [Pool(1000) for _ in range(8)]
    for hog in hogs:
        hog.stopped = True
        topic = VolatileTopic(hog, hog.depth, budget, now)
        fill(topic)
    commands = Pool(10)
    topic = VolatileTopic(commands, commands.depth, budget, now)
    for _ in range(1000):
        topic.publish(bytes(1_000))


def test_it_goes_on_once_the_subscriber_does() -> None:
    now, budget = Time(), Budget(LIMIT)
    pool = Pool(1000)
    topic = VolatileTopic(pool, pool.depth, budget, now)
    pool.stopped = True
    fill(topic)
    assert LIMIT / 4 < pool.held <= LIMIT / 2
    asked = pool.asked
    for _ in range(1000):
        with pytest.raises(SlowSubscriberError):
            topic.publish(bytes(1_000_000))
    assert pool.asked == asked, "asking costs something, so it is not done for each message"
    pool.stopped = False
    now.s += 1.0
    for _ in range(1000):
        topic.publish(bytes(1_000_000))
        now.s += 0.01
    assert pool.held <= LIMIT / 2


def test_larger_messages_than_fill_go_on() -> None:
    """DDS has memory enough, but none of it is large enough, and it never gives any back."""
    now, budget = Time(), Budget(LIMIT)
    pools = [Pool(1000)]

    def renew(depth: int) -> Pool:
        pools.append(Pool(depth))
        return pools[-1]

    topic = VolatileTopic(pools[0], 1000, budget, now, renew)
    pools[0].stopped = True
    fill(topic)
    for _ in range(3):
        with pytest.raises(SlowSubscriberError):
            topic.publish(bytes(6_000_000))
    pools[0].stopped = False
    now.s += 1.0
    for _ in range(100):
        topic.publish(bytes(6_000_000))
        now.s += 0.01
    assert len(pools) == 2
    assert not pools[0].held
    assert pools[1].held <= LIMIT / 2
    topic.close()
    assert budget.held == 0


class Burst:
    """A topic for which nobody has chosen a depth.

    Attributes:
        pools: its publishers so far.
    """

    def __init__(self) -> None:
        self.now, self.budget = Time(), Budget(LIMIT)
        self.pools = [Pool(BURST_DEPTH)]
        self.matched = 1  # subscriptions that have found a new publisher
        self.topic = VolatileTopic(self.pools[0], BURST_DEPTH, self.budget, self.now, self._next, lasting_depth=10)

    def _next(self, depth: int) -> Pool:
        return self.renew(depth)

    def renew(self, depth: int) -> Pool:
        self.pools.append(Pool(depth))
        self.pools[-1].stopped = self.pools[-2].stopped
        self.pools[-1].subscriber_count = self.matched
        return self.pools[-1]

    def publish(self, count: int, size: int, rate: float) -> None:
        for _ in range(count):
            self.topic.publish(bytes(size))
            self.now.s += 1 / rate


def stalled_burst() -> Burst:
    burst = Burst()
    burst.matched = 0
    burst.pools[0].stopped = True
    while len(burst.pools) == 1:
        burst.publish(1, 100_000, 30.0)
    return burst


def test_a_burst_is_kept_until_it_is_acknowledged() -> None:
    burst = Burst()
    burst.pools[0].stopped = True
    burst.publish(2000, 2_500, 30_000.0)
    assert len(burst.pools[0].history) == 2000
    burst.pools[0].stopped = False
    burst.publish(20_000, 2_500, 2_000.0)
    assert len(burst.pools) == 1
    assert burst.budget.held < 6_000_000


def test_stuck_subscriber_costs_no_more_than_before() -> None:
    """After two seconds the publisher keeps few messages, and all others still get theirs."""
    burst = Burst()
    burst.pools[0].stopped = True
    burst.publish(100, 100_000, 30.0)
    assert [each.depth for each in burst.pools] == [BURST_DEPTH, 10]
    assert burst.budget.held <= 1_100_000
    burst.publish(100, 100_000, 30.0)
    assert len(burst.pools) == 2


def test_subscriptions_find_new_publisher_before_it_takes_over() -> None:
    """A message on a publisher that no subscription has found yet is lost, for reliable ones too."""
    burst = stalled_burst()
    burst.publish(5, 100_000, 30.0)
    first, second = burst.pools
    assert not second.history
    second.subscriber_count = 1
    burst.publish(2, 100_000, 30.0)
    assert second.history
    assert first.closed


def test_a_publisher_whose_subscribers_catch_up_stays() -> None:
    burst = stalled_burst()
    burst.pools[0].stopped = False
    burst.publish(10, 100_000, 30.0)
    first, second = burst.pools
    assert second.closed
    assert not first.closed
    burst.topic.close()
    assert first.closed
    assert burst.budget.held == 0


def test_healthy_subscribers_cost_little() -> None:
    burst = Burst()
    burst.publish(10_000, 10_000, 1_000.0)
    assert len(burst.pools) == 1
    assert burst.budget.held <= 2 << 20
    assert burst.pools[0].asked < 200


def test_large_messages_are_not_asked_about_one_by_one() -> None:
    burst = Burst()
    burst.publish(1_000, 100_000, 30.0)
    assert burst.pools[0].asked < 150
    assert burst.budget.held <= 2 << 20


def test_topic_that_its_budget_stops_has_asked() -> None:
    """What DDS holds no more is not counted against it, though it is asked rarely."""
    now, budget = Time(), Budget(1_000_000)
    pool = Pool(1_000)
    topic = VolatileTopic(pool, pool.depth, budget, now)
    for _ in range(100):
        topic.publish(bytes(90_000))
        now.s += 0.1
    assert pool.held <= budget.limit / 2 + FREE


def test_a_full_budget_ends_the_burst_at_once() -> None:
    burst = Burst()
    burst.pools[0].stopped = True
    burst.publish(21, 1_000_000, 1_000.0)
    assert [each.depth for each in burst.pools] == [BURST_DEPTH, 10]


def test_irreplaceable_publisher_is_still_counted() -> None:
    burst = Burst()

    def refuse(_: int) -> Pool:
        raise RosError("no more publishers")

    burst.renew = refuse  # type: ignore[assignment]
    burst.pools[0].stopped = True
    refused = 0
    for _ in range(30):
        try:
            burst.publish(1, 1_000_000, 1_000.0)
        except (RosError, SlowSubscriberError):
            refused += 1
    assert refused
    assert burst.pools[0].held <= burst.budget.held + FREE
    del burst.renew
    with contextlib.suppress(SlowSubscriberError):
        burst.publish(1, 1_000_000, 1_000.0)
    assert [each.depth for each in burst.pools] == [BURST_DEPTH, 10]

"""The QoS that a route subscribes with."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
from tests.support.offline import FakePeer

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.keep import Keep
from rsb_bridge.model.qos import Qos, auto_depth
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.publication_numbers import Untaken
from rsb_bridge.ros.ros_interface import Endpoint, Liveliness, RawMessage, TopicSpec
from rsb_bridge.route.topic_subscription import TopicSubscription
from rsb_bridge.telemetry.meters import RateMeter

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.route.sending import OutgoingPath


STRING = "std_msgs/msg/String"
LEASE = 2.0
LEASED = Qos(liveliness="manual_by_topic", liveliness_lease_duration=LEASE)


class FakeRos(NoRos):
    """A ROS side that records what is subscribed to.

    Attributes:
        made: every subscription so far.
    """

    def __init__(self) -> None:
        self.made: list[FakeSubscription] = []

    def subscribe(self, spec: TopicSpec, sink: Any, *_: Any, express: bool = False) -> Any:
        self.made.append(FakeSubscription(spec.qos, sink, express=express))
        return self.made[-1]


class FakeSubscription:
    def __init__(self, qos: Qos, sink: Any, *, express: bool) -> None:
        self.qos = qos
        self.hear = sink
        self.express = express
        self.matched = 1
        self.liveliness = Liveliness(alive=0, unjudged=1)
        self.closed = False

    def close(self) -> None:
        self.closed = True


class Path:
    def offer(self, batch: object) -> None: ...

    def emit(self, samples: object) -> None: ...

    def too_late(self, batch: object) -> None: ...


class Owner:
    """The route that subscribes.

    Attributes:
        meter: the rates so far.
        events: codes of the events.
    """

    def __init__(self) -> None:
        self.meter = RateMeter(0.0)
        self.events: list[EventCode] = []
        self.peer = FakePeer()
        self.arming = SimpleNamespace(required=False, lease=None)
        self.proposal = SimpleNamespace(keep=None, qos=None, express=False)
        self.spec = SimpleNamespace(expected_rate=None)
        self.notices = SimpleNamespace(record=lambda text: None)
        self.context: Any = None
        self.ends: Any = None

    def wake(self) -> None: ...

    def log(self, level: object, code: EventCode, text: str) -> None:
        self.events.append(code)


def make_subscription(
    context: Context,
    owner: Owner,
    qos: Qos,
    *,
    automatic: bool,
    expected_rate: float | None = None,
    type_name: str = STRING,
) -> TopicSubscription:
    owner.context, owner.ends = context, context.ros
    owner.proposal.qos, owner.spec.expected_rate = None if automatic else qos, expected_rate
    loop_filter: Any = SimpleNamespace(alive_left_out=lambda qos: 0)
    subscription = TopicSubscription(cast("Any", owner), cast("OutgoingPath", Path()), loop_filter, lambda: None)
    spec = TopicSpec("/fast", type_name, "", qos)
    subscription.begin(spec, known={})
    subscription.subscribe(missed=False)
    return subscription


@pytest.mark.parametrize(
    ("rate", "mean_size", "depth"),
    [
        (None, 0.0, 2500),
        (0.5, 100.0, 10),
        (100.0, 100.0, 500),
        (1000.0, 1000.0, 5000),
        (100_000.0, 10.0, 10_000),
        (30.0, 1_000_000.0, 33),
        (30.0, 50_000_000.0, 10),
    ],
)
def test_auto_keeps_five_seconds_within_bounds(rate: float | None, mean_size: float, depth: int) -> None:
    assert auto_depth("reliable", rate, mean_size) == depth


def test_best_effort_begins_with_what_is_worth_sending() -> None:
    """Of which only the newest second is."""
    assert auto_depth("best_effort", None, 0.0) == 500


@pytest.mark.parametrize(
    ("keep", "rate", "mean_size", "depth"),
    [
        (Keep(180.0), None, 0.0, 10_000),
        (Keep(180.0), 20.0, 100.0, 3600),
        (Keep(180.0), 100.0, 100.0, 10_000),
        (Keep(1.0), 100.0, 100.0, 500),
        (Keep(180.0), 100.0, 32_768.0, 1024),
        (Keep(180.0, megabytes=100.0), 100.0, 100_000.0, 1000),
    ],
)
def test_depth_covers_what_is_kept(
    keep: Keep, rate: float | None, mean_size: float, depth: int, make_context: Callable[..., Context]
) -> None:
    """All of it comes at once when the bridge goes on after it stood still."""
    assert auto_depth("reliable", rate, mean_size, keep) == depth
    if not mean_size:
        ros, owner = FakeRos(), Owner()
        owner.proposal.keep = keep
        make_subscription(make_context(ros), owner, Qos(), automatic=True, expected_rate=rate)
        owner.arming.required, owner.arming.lease = True, None  # such topics keep nothing
        make_subscription(make_context(ros), owner, Qos(), automatic=True, expected_rate=rate)
        assert [each.qos.depth for each in ros.made] == [depth, 2500]


@pytest.mark.parametrize(
    ("qos", "automatic"),
    [
        (Qos(durability="transient_local", depth=0), True),
        (Qos(history="keep_all", depth=0), True),
        (Qos(history="keep_all", depth=0), False),
        (Qos(depth=0), False),
    ],
)
def test_losses_reopen_nothing_that_gets_no_deeper(
    qos: Qos, automatic: bool, make_context: Callable[..., Context]
) -> None:
    ros, owner = FakeRos(), Owner()
    subscription = make_subscription(make_context(ros), owner, qos, automatic=automatic)
    subscription.numbers.lose(7)
    subscription.tick()
    assert (len(ros.made), owner.events) == (1, [])


def test_losses_deepen_subscription_of_busy_topic(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    ros, owner = FakeRos(), Owner()
    subscription = make_subscription(make_context(ros), owner, Qos(depth=0), automatic=True)
    assert [each.qos.depth for each in ros.made] == [2500]

    def second_passes() -> None:
        owner.meter.add(1000, 100_000, loop.time())
        owner.meter.tick(loop.time())
        subscription.tick()
        loop.run_until_complete(asyncio.sleep(1))

    for _ in range(10):
        second_passes()
    assert len(ros.made) == 1
    subscription.numbers.lose(7)
    for _ in range(10):
        second_passes()
    assert [(each.qos.depth, each.closed) for each in ros.made] == [(2500, True), (5000, False)]
    subscription.numbers.lose(2)
    second_passes()
    assert len(ros.made) == 2
    assert subscription.numbers.counts[Untaken.LOST] == 9
    assert owner.events == [EventCode.ROUTE_DEEPENED]
    assert subscription.close() == 0
    assert ros.made[1].closed


@pytest.mark.parametrize(
    ("vendor", "hears", "heard", "asked"),
    [
        (b"\x01\x12", False, True, ["reliable", "best_effort", "best_effort", "reliable"]),
        (b"\x01\x12", False, False, ["reliable", "best_effort"]),
        (b"\x01\x12", True, True, ["reliable"]),
        (b"\x01\x0f", False, True, ["reliable"]),
        (b"ta", False, True, ["reliable"]),
    ],
)
def test_publisher_that_is_reliable_in_name_only(
    vendor: bytes,
    hears: bool,
    heard: bool,
    asked: list[str],
    loop: VirtualLoop,
    make_context: Callable[..., Context],
) -> None:
    """Once it has gone, a reliable subscription serves the others again."""
    ros, owner = FakeRos(), Owner()
    subscription = make_subscription(make_context(ros), owner, Qos(), automatic=True)
    rust = Endpoint("/rust", STRING, "", Qos(), vendor.ljust(16, b"\1"))
    for second in range(12):
        if hears and second == 3:
            subscription.numbers.newest[rust.gid] = 1
        if heard and len(ros.made) == 2 and not ros.made[1].closed:
            ros.made[1].hear([RawMessage(b"", 0, rust.gid, 1)])
        subscription.tick([rust])
        loop.run_until_complete(asyncio.sleep(1))
    assert owner.events == ([EventCode.ROUTE_UNRELIABLE] if len(asked) > 2 else [])
    subscription.tick()
    assert [each.qos.reliability for each in ros.made] == asked
    # Only the further subscription comes and goes beside the first.
    open_now = [each.qos.reliability for each in ros.made if not each.closed]
    assert open_now == ["reliable"]
    subscription.close()


@pytest.mark.parametrize("latched", [False, True])
def test_silent_publisher_is_not_asked_about_for_ever(
    latched: bool, loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    """A busy one beside it would come twice; and a latched topic's history comes to reliable subscriptions only."""
    ros, owner = FakeRos(), Owner()
    qos = Qos(durability="transient_local") if latched else Qos()
    subscription = make_subscription(make_context(ros), owner, qos, automatic=not latched)
    silent = Endpoint("/standby", STRING, "", qos, b"\x01\x01".ljust(16, b"\1"))
    asked = 0
    for _ in range(600):
        subscription.tick([silent])
        asked += any(not each.closed and each.qos.reliability == "best_effort" for each in ros.made)
        loop.run_until_complete(asyncio.sleep(1))
    assert asked == 0 if latched else 30 <= asked <= 65
    assert owner.events == []
    subscription.close()


def test_dds_is_asked_anew_who_is_alive(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    """A subscription that missed an assertion while it was made calls its publisher not alive for ever."""
    ros = FakeRos()
    subscription = make_subscription(make_context(ros), Owner(), LEASED, automatic=False)

    def alive_after(seconds: float) -> bool:
        loop.run_until_complete(asyncio.sleep(seconds))
        return subscription.alive

    def taking() -> list[int]:
        return [number for number, made in enumerate(ros.made) if not made.closed]

    assert not alive_after(0.9 * LEASE)
    assert taking() == [0]
    assert not alive_after(0.6 * LEASE)
    assert taking() == [0, 1]
    assert not alive_after(60.0)  # the second one has missed it, too
    asked = len(ros.made)
    assert asked in range(4, 8)
    assert taking() == [0, asked - 1]
    ros.made[-1].liveliness = Liveliness(alive=1)
    assert alive_after(LEASE)
    ros.made[-1].liveliness = Liveliness(alive=0)
    assert not alive_after(LEASE)
    ros.made[-1].liveliness = Liveliness(alive=1)
    assert alive_after(100.0)
    assert taking() == [0, asked - 1]
    ros.made[0].liveliness = Liveliness(alive=1, unjudged=1)  # by another publisher
    assert alive_after(LEASE)
    assert taking() == [0]
    ros.made[0].liveliness = Liveliness(alive=0, unjudged=1)
    assert not alive_after(LEASE)
    assert taking() == [0, asked]  # at once, this time
    subscription.unsubscribe()
    assert not taking()


def test_dds_is_believed_that_has_judged_all(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    ros = FakeRos()
    subscription = make_subscription(make_context(ros), Owner(), LEASED, automatic=False)
    ros.made[0].liveliness = Liveliness(alive=0, unjudged=0)
    loop.run_until_complete(asyncio.sleep(1000.0))
    assert not subscription.alive
    assert len(ros.made) == 1


def test_what_an_operator_gave_stands(make_context: Callable[..., Context]) -> None:
    ros = FakeRos()
    make_subscription(make_context(ros), Owner(), Qos(depth=3), automatic=False, expected_rate=1000.0)
    make_subscription(make_context(ros), Owner(), Qos(depth=0), automatic=True, expected_rate=1000.0)
    assert [each.qos.depth for each in ros.made] == [3, 5000]


def test_everything_publishers_keep_is_taken(make_context: Callable[..., Context]) -> None:
    ros = FakeRos()
    latched = Qos(durability="transient_local", depth=1)
    make_subscription(make_context(ros), Owner(), latched, automatic=False)
    assert ros.made[0].qos == Qos(durability="transient_local", history="keep_all", depth=1)


@pytest.mark.parametrize(
    ("express", "armed", "type_name", "qos", "expected"),
    [
        (False, False, STRING, Qos(), False),
        (True, False, STRING, Qos(), True),
        (False, True, STRING, Qos(), True),
        (False, False, "rosgraph_msgs/msg/Clock", Qos(), True),
        (False, False, STRING, Qos(depth=1), True),
        (False, False, STRING, Qos(history="keep_all", depth=1), False),
    ],
)
def test_what_cannot_wait_is_express(
    make_context: Callable[..., Context], *, express: bool, armed: bool, type_name: str, qos: Qos, expected: bool
) -> None:
    owner, ros = Owner(), FakeRos()
    owner.proposal.express, owner.arming.required = express, armed
    make_subscription(make_context(ros), owner, qos, automatic=False, type_name=type_name)
    assert [each.express for each in ros.made] == [expected]

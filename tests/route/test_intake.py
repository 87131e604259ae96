"""What a route subscribes with."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos, auto_depth
from rsb_bridge.route.intake import Intake
from rsb_bridge.telemetry.meters import RateMeter
from rsb_bridge.wire.messages import Describe

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.ros.api import OnFailure


class FakeRos:
    """A ROS side that records what is subscribed to.

    Attributes:
        subscriptions: every one so far.
    """

    def __init__(self) -> None:
        self.subscriptions: list[FakeSubscription] = []

    def subscribe(
        self, topic: str, type_name: str, type_hash: str, qos: Qos, sink: Any, origin: Any, on_failure: OnFailure
    ) -> FakeSubscription:
        self.subscriptions.append(FakeSubscription(qos))
        return self.subscriptions[-1]


class FakeSubscription:
    def __init__(self, qos: Qos) -> None:
        self.qos = qos
        self.lost = 0
        self.closed = False

    def close(self) -> None:
        self.closed = True


class Nobody:
    def offer(self, batch: object) -> None:
        """Take nothing."""


@pytest.mark.parametrize(
    ("rate", "mean_size", "depth"),
    [
        (None, 0.0, 500),
        (0.5, 100.0, 10),
        (100.0, 100.0, 500),
        (1000.0, 1000.0, 5000),
        (100_000.0, 10.0, 10_000),
        (30.0, 1_000_000.0, 33),
        (30.0, 50_000_000.0, 10),
    ],
)
def test_auto_keeps_five_seconds_within_bounds(rate: float | None, mean_size: float, depth: int) -> None:
    assert auto_depth(rate, mean_size) == depth


def test_a_busier_topic_gets_a_deeper_subscription_once_messages_are_lost(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    ros, rates, events = FakeRos(), RateMeter(0.0), list[EventCode]()
    described = Describe(route=1, type="std_msgs/msg/String", type_hash="", qos=Qos())
    intake = Intake(
        make_context(ros),
        Nobody(),
        "/fast",
        described,
        "robot1",
        log=lambda _, code, __: events.append(code),
        rates=rates,
        expected_rate=None,
    )
    assert [each.qos.depth for each in ros.subscriptions] == [500]

    def second_passes() -> None:
        rates.add(1000, 100_000, loop.time())
        rates.tick(loop.time())
        intake.tick()
        loop.run_until_complete(asyncio.sleep(1))

    for _ in range(10):
        second_passes()
    assert len(ros.subscriptions) == 1
    ros.subscriptions[0].lost = 7
    for _ in range(10):
        second_passes()
    assert [(each.qos.depth, each.closed) for each in ros.subscriptions] == [(500, True), (5000, False)]
    ros.subscriptions[1].lost = 2
    second_passes()
    assert len(ros.subscriptions) == 2
    assert intake.lost == 9
    assert events == [EventCode.ROUTE_DEEPENED]
    intake.close()
    assert ros.subscriptions[1].closed


def test_a_depth_that_an_operator_gave_stands(make_context: Callable[..., Context]) -> None:
    ros = FakeRos()
    described = Describe(route=1, type="std_msgs/msg/String", type_hash="", qos=Qos(depth=3))
    Intake(
        make_context(ros),
        Nobody(),
        "/slow",
        described,
        "robot1",
        log=lambda *_: None,
        rates=None,
        expected_rate=1000.0,
    )
    assert ros.subscriptions[0].qos == Qos(depth=3)

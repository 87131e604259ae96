"""When a topic's subscription is renewed: as the far side's subscriptions grow, and not too often."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from rsb_bridge.route.renewal import APART, Renewal

if TYPE_CHECKING:
    from tests.support.virtual_time import VirtualLoop


class Subscription:
    """Notes when it is renewed."""

    receives = True

    def __init__(self, loop: VirtualLoop) -> None:
        self._loop = loop
        self.renewed: list[float] = []

    def renew(self) -> None:
        self.renewed.append(self._loop.time())


@pytest.fixture
def subscription(loop: VirtualLoop) -> Subscription:
    return Subscription(loop)


def renewal_of(subscription: Any, loop: VirtualLoop, *, renew: bool = True) -> Renewal:
    context = SimpleNamespace(loop=loop, now=loop.time)
    proposal = SimpleNamespace(renew=renew)
    route: Any = SimpleNamespace(context=context, proposal=proposal, far_topic="/map", log=lambda *_: None)
    return Renewal(route, subscription)


def pass_time(loop: VirtualLoop, seconds: float) -> None:
    loop.run_until_complete(asyncio.sleep(seconds))


def test_growth_renews_at_most_every_two_seconds(subscription: Subscription, loop: VirtualLoop) -> None:
    renewal = renewal_of(subscription, loop)
    for count in (1, 2, 3, 4):
        renewal.told(count, rests=False)
        pass_time(loop, 0.1)
    assert len(subscription.renewed) == 1
    pass_time(loop, APART)
    first, second = subscription.renewed
    assert second - first == APART


def test_others_changes_renew_nothing(subscription: Subscription, loop: VirtualLoop) -> None:
    renewal = renewal_of(subscription, loop)
    renewal.told(3, rests=True)  # it subscribes now, for the first time
    for count in (3, 1, 1, 0):
        renewal.told(count, rests=False)
    renewal_of(subscription, loop, renew=False).told(7, rests=False)
    pass_time(loop, 10.0)
    assert subscription.renewed == []


def test_opening_that_ends_renews_no_more(subscription: Subscription, loop: VirtualLoop) -> None:
    renewal = renewal_of(subscription, loop)
    renewal.told(1, rests=False)
    renewal.end()
    pass_time(loop, 10.0)
    assert subscription.renewed == []

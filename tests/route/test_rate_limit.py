"""The rates that the two sides allow, limits that hold for all stamps, and a peer that keeps to none."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

import pytest
from tests.route.unpacking_helpers import OnePublisher, opened
from tests.support.held import held_by
from tests.support.offline import FakePeer

from rsb_bridge.route.gates import NO_SAMPLE, rate_gate
from rsb_bridge.route.ledger import THROTTLED, RouteLedger
from rsb_bridge.route.rate_limit import AllowedRates, RateLimit, Throttle
from rsb_bridge.wire.records import ReceivedCounts

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.model.codes import EventCode
    from rsb_bridge.model.snapshot import Level

S = 1_000_000_000


def limit(max_rate: float = 0.0) -> RateLimit:
    return RateLimit(max_rate, ignore)


def ignore(level: Level, code: EventCode, text: str) -> None:
    pass


def test_lowest_rate_counts_and_sender_is_told() -> None:
    told: list[float] = []
    route = limit(20.0)
    route.switched = lambda: told.append(route.rate)
    route.allow_here(10.0)
    route.allow_there(5.0)
    assert (told, route.rate) == ([10.0, 5.0], 5.0)
    route.set_max_rate(2.0)
    assert route.rate == 2.0
    route.opened()  # the other side says again what it allows
    route.set_max_rate(0.0)
    assert route.rate == 10.0
    assert not route.allow_here(10.0)
    assert route.allow_here(0.0)
    assert (route.rate, told[-1]) == (0.0, 0.0)


@pytest.mark.parametrize("rate", [0.01, 1.0, 10.0, 1000.0])
def test_peer_that_keeps_to_its_rate_loses_nothing(rate: float) -> None:
    """Also where its clock goes fast, its messages come unevenly, and the link stalls for a while."""
    gate = rate_gate(AllowedRates(), "/chat", rate)
    times = [(number + (number % 2) * 0.9) / (rate * 1.0005) for number in range(2000)]
    assert not any(gate(NO_SAMPLE, at) for at in times)
    stalled = times[-1] + 1 / rate + 1.0
    assert not any(gate(NO_SAMPLE, stalled) for _ in range(int(rate)))


def test_rate_is_of_topic_across_all_routes(
    make_context: Callable[..., Context],
) -> None:
    """A peer can propose the same topic under many names of its own, and remove and propose it again at once."""
    ros, peer = OnePublisher(), FakePeer()
    context = make_context(ros=ros)
    for number in range(100):
        receiver = opened(context, peer, "/chat")
        receiver.route.limit.allow_here(1.0)
        receiver.deliver([(b"forward", 0, 0)] * 10)
        if number % 2:
            receiver.route.destroy()
    assert len(ros.published.sizes) == 2
    other = opened(context, peer, "/other")
    other.route.limit.allow_here(1.0)
    other.deliver([(b"hello", 0, 0)])
    assert len(ros.published.sizes) == 3


def test_known_rates_are_bounded_and_forgotten() -> None:
    rates = AllowedRates()
    for number in range(10_000):
        rates.admits(f"/made_up{number}", 1.0, 0.0)
    assert held_by(rates) == 2000
    assert not rates.admits("/honest", 1.0, 0.5), "what cannot be counted is left out"
    assert rates.admits("/honest", 1.0, 5.0)
    assert held_by(rates) == 1


def test_receivers_omissions_are_throttled_in_senders_ledger() -> None:
    ledger = RouteLedger()
    ledger.opened(1, "there")
    ledger.offered = 10
    ledger.sent(10)
    report = ReceivedCounts(
        route=1, received=10, delivered=3, expired=0, incomplete=0, newest=10, dropped={THROTTLED: 7}
    )
    assert ledger.reported(report, 0.0)
    balance = ledger.ledger({})
    assert (balance.delivered, balance.throttled, balance.dropped, balance.in_flight) == (3, 7, {}, 0)


def passed(throttle: Throttle, stamps: list[int]) -> int:
    return sum(throttle.passes(stamp) for stamp in stamps)


def test_topic_just_above_limit_keeps_limit() -> None:
    """50 Hz throttled to 20 Hz gives 20, not 16.7."""
    assert passed(Throttle(20.0), [number * S // 50 for number in range(500)]) == 200


@pytest.mark.parametrize("back", [1, S // 10, S, 10 * S, 3600 * S])
def test_stamps_that_go_back_do_not_end_limit(back: int) -> None:
    """Two publishers' stamps may cross, and a clock may be set."""
    throttle = Throttle(2.0)
    start = 10_000 * S
    assert throttle.passes(start)
    throttle.passes(start - back)
    stamps = [start - back + number * S // 5 for number in range(1, 301)]
    assert 115 <= passed(throttle, stamps) <= 121


def test_stamps_of_two_publishers_that_cross() -> None:
    random = Random(1)
    stamps = [10_000 * S + number * S // 20 - random.randrange(S // 10) for number in range(1200)]
    assert 115 <= passed(Throttle(2.0), stamps) <= 121

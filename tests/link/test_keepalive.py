"""A silent peer is given up in time, and rates are right whenever they are looked at."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
from tests.support.virtual_time import set_clock

from rsb_bridge.link.keepalive import Keepalive
from rsb_bridge.link.link import LinkTraffic
from rsb_bridge.model.transports import LinkProfile
from rsb_bridge.wire.messages import Pong

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context


class Carrier:
    def __init__(self, loop: VirtualLoop) -> None:
        self.received_at = loop.time()
        self.received_bytes = 0
        self.sent_bytes = 0
        self._loop = loop

    def receive(self, size: int) -> None:
        self.received_at = self._loop.time()
        self.received_bytes += size


class Link:
    """A link with these carriers, which notes when its connection is silent."""

    def __init__(self, context: Context, *carriers: Any, patience: float | None = None) -> None:
        self.context = context
        self.profile = LinkProfile(patience=patience)
        self.is_client = True
        self.doubted: list[float] = []
        self.ended: list[float] = []
        self._carriers = carriers

    def carriers(self) -> tuple[Any, ...]:
        return self._carriers

    def doubts(self) -> None:
        self.doubted.append(self.context.loop.time())

    def silent(self) -> None:
        self.ended.append(self.context.loop.time())


def wait(loop: VirtualLoop, seconds: float) -> None:
    loop.run_until_complete(asyncio.sleep(seconds))


def test_peer_is_given_up_after_five_seconds(loop: VirtualLoop, context: Context) -> None:
    control: Any = Carrier(loop)
    link = Link(context, Carrier(loop), control)
    Keepalive(link, control)
    for _ in range(1000):
        wait(loop, 0.9)
        control.receive(1)
    last = loop.time()
    wait(loop, 60.0)
    assert link.ended == [pytest.approx(last + 5.0)]


def test_silent_control_connection_ends_link(loop: VirtualLoop, context: Context) -> None:
    """Something holds it, while datagrams pass."""
    control: Any = Carrier(loop)
    datagrams: Any = Carrier(loop)
    link = Link(context, control, datagrams)
    keepalive = Keepalive(link, control)
    wait(loop, 3.0)
    control.receive(1)
    last = loop.time()
    for _ in range(30):
        assert keepalive.control_is_silent == (keepalive.control_quiet > 5.0)
        datagrams.receive(1)
        wait(loop, 0.7)
    assert link.ended == [pytest.approx(last + 10.0)]


def test_peer_is_given_up_despite_rounding(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    """The rest of five seconds can be too little to move the clock."""
    for number in range(300):
        wait(loop, 0.1 + number / 7)
        control: Any = Carrier(loop)
        link = Link(make_context())
        Keepalive(link, control)
        wait(loop, 5.1)
        assert len(link.ended) == 1


def test_a_link_that_has_ended_is_not_watched(loop: VirtualLoop, context: Context) -> None:
    control: Any = Carrier(loop)
    link = Link(context)
    keepalive = Keepalive(link, control)
    wait(loop, 3.0)
    keepalive.stop()
    wait(loop, 60.0)
    assert link.ended == []


@pytest.mark.parametrize(
    ("rtt", "patience", "after"), [(None, None, 1.25), (0.5, None, 2.0), (3.0, None, None), (0.01, 15.0, 3.25)]
)
def test_connection_is_doubted_after_a_missed_ping(
    rtt: float | None, patience: float | None, after: float | None, loop: VirtualLoop, context: Context
) -> None:
    """A slow path is not doubted before it is given up."""
    control: Any = Carrier(loop)
    link = Link(context, control, patience=patience)
    keepalive = Keepalive(link, control)
    keepalive.stamps.rtt = rtt
    for _ in range(100):
        wait(loop, 1.05)
        control.receive(1)
    assert not link.doubted
    last = loop.time()
    wait(loop, 4.9)
    assert link.doubted[:1] == ([] if after is None else [pytest.approx(last + after)])
    assert keepalive.in_doubt is (after is not None)
    control.receive(1)
    assert not keepalive.in_doubt


def test_changed_network_is_doubted_unless_a_ping_is_answered(loop: VirtualLoop, context: Context) -> None:
    control: Any = Carrier(loop)
    link = Link(context, control)
    keepalive = Keepalive(link, control)
    wait(loop, 0.5)
    keepalive.hurry()
    wait(loop, 0.05)
    control.receive(1)
    wait(loop, 0.5)
    assert not link.doubted
    keepalive.hurry()
    wait(loop, 0.11)
    assert len(link.doubted) == 1


@pytest.mark.parametrize("late", [0.0, 0.25, 2.4])
def test_tick_that_comes_late_makes_no_rate_high(late: float, loop: VirtualLoop, context: Context) -> None:
    carrier = Carrier(loop)
    traffic = LinkTraffic(cast("Any", SimpleNamespace(context=context, carriers=lambda: [carrier])))
    for _ in range(20):
        wait(loop, 1.0 + late)
        carrier.receive(round(1000 * (1.0 + late)))
        carrier.sent_bytes += round(500 * (1.0 + late))
        traffic.tick()
    assert traffic.rx.rate == pytest.approx(1000, rel=0.01)
    assert traffic.tx.rate == pytest.approx(500, rel=0.01)


def test_a_profile_s_patience(loop: VirtualLoop, context: Context) -> None:
    link = Link(context, patience=15.0)
    began = loop.time()
    control: Any = Carrier(loop)
    Keepalive(link, control)
    wait(loop, 60.0)
    assert link.ended == [pytest.approx(began + 15.0)]


@pytest.mark.parametrize("step", [0, -5])
def test_how_long_a_ping_takes(step: int, loop: VirtualLoop, context: Context) -> None:
    """The last answer's time, or how long the oldest ping has waited for one, though a clock is set meanwhile."""
    keepalive = Keepalive(Link(context))
    assert keepalive.round_trip is None
    ping = keepalive.tick(0)
    wait(loop, 0.3)
    set_clock(context.clock, step)
    keepalive.answered(Pong(n=ping.n, sent=ping.sent, received=ping.sent, answered=ping.sent))
    assert keepalive.round_trip == pytest.approx(0.3, abs=0.01)
    for _ in range(3):
        keepalive.tick(0)
        wait(loop, 1.0)
    assert keepalive.round_trip == pytest.approx(3.0)

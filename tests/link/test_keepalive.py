"""A silent peer is given up in time, and rates are right whenever they are looked at."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
from tests.support.virtual_time import set_clock

from rsb_bridge.link.keepalive import Keepalive
from rsb_bridge.link.link import LinkTraffic
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


def wait(loop: VirtualLoop, seconds: float) -> None:
    loop.run_until_complete(asyncio.sleep(seconds))


def test_a_peer_is_given_up_five_seconds_after_its_last_byte(loop: VirtualLoop, context: Context) -> None:
    carriers: list[Any] = [Carrier(loop), Carrier(loop)]
    silent: list[float] = []
    keepalive = Keepalive(context, lambda: carriers)
    keepalive.watch(carriers[1], lambda: silent.append(loop.time()))
    for _ in range(1000):
        wait(loop, 0.9)
        carriers[1].receive(1)
    last = loop.time()
    wait(loop, 60.0)
    assert silent == [pytest.approx(last + 5.0)]


def test_silent_control_connection_ends_link(loop: VirtualLoop, context: Context) -> None:
    """Something holds it, while datagrams pass."""
    control: Any = Carrier(loop)
    datagrams: Any = Carrier(loop)
    silent: list[float] = []
    keepalive = Keepalive(context, lambda: [control, datagrams])
    keepalive.watch(control, lambda: silent.append(loop.time()))
    wait(loop, 3.0)
    control.receive(1)
    last = loop.time()
    for _ in range(30):
        assert keepalive.control_is_silent == (keepalive.control_quiet > 5.0)
        datagrams.receive(1)
        wait(loop, 0.7)
    assert silent == [pytest.approx(last + 10.0)]


def test_a_peer_is_given_up_with_any_rounding_of_the_clock(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    """The rest of five seconds can be too little to move the clock."""
    for number in range(300):
        wait(loop, 0.1 + number / 7)
        silent: list[float] = []
        control: Any = Carrier(loop)
        keepalive = Keepalive(make_context(), list)
        keepalive.watch(control, lambda silent=silent: silent.append(loop.time()))  # type: ignore[misc]
        wait(loop, 5.1)
        assert len(silent) == 1


def test_a_link_that_has_ended_is_not_watched(loop: VirtualLoop, context: Context) -> None:
    silent: list[float] = []
    control: Any = Carrier(loop)
    keepalive = Keepalive(context, list)
    keepalive.watch(control, lambda: silent.append(loop.time()))
    wait(loop, 3.0)
    keepalive.stop()
    wait(loop, 60.0)
    assert silent == []


@pytest.mark.parametrize("late", [0.0, 0.25, 2.4])
def test_a_tick_that_comes_late_makes_no_rate_high(late: float, loop: VirtualLoop, context: Context) -> None:
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
    silent: list[float] = []
    keepalive = Keepalive(context, list, patience=15.0)
    began = loop.time()
    control: Any = Carrier(loop)
    keepalive.watch(control, lambda: silent.append(loop.time()))
    wait(loop, 60.0)
    assert silent == [pytest.approx(began + 15.0)]


@pytest.mark.parametrize("step", [0, -5])
def test_how_long_a_ping_takes(step: int, loop: VirtualLoop, context: Context) -> None:
    """The last answer's time, or how long the oldest ping has waited for one, though a clock is set meanwhile."""
    keepalive = Keepalive(context, list)
    assert keepalive.round_trip is None
    ping = keepalive.tick()
    wait(loop, 0.3)
    set_clock(context.clock, step)
    keepalive.answered(Pong(n=ping.n, sent=ping.sent, received=ping.sent, answered=ping.sent))
    assert keepalive.round_trip == pytest.approx(0.3, abs=0.01)
    for _ in range(3):
        keepalive.tick()
        wait(loop, 1.0)
    assert keepalive.round_trip == pytest.approx(3.0)

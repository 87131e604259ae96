"""A route without events is ticked seldom, and notices each event within a second."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Any

import pytest
from tests.route.idle_routes_helpers import TALKER, Channel
from tests.support.offline import FakePeer, half_of

from rsb_bridge.model.capacity import Fullness
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.faults import PathFault
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, LinkCause
from rsb_bridge.route.idling import POLLED_EVERY, SETTLES, Idling, tick_if_due
from rsb_bridge.route.sender import Sender
from rsb_bridge.wire.records import ReceivedCounts, ReceivedReport, VerdictRecord

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context


class World:
    """A route that is open and flows, and that its link ticks once a second unless it is idle.

    Attributes:
        ticks: the times (s) of the route's ticks.
    """

    def __init__(self, loop: VirtualLoop, context: Context, **fields: Any) -> None:
        self.peer = FakePeer()
        self.sender = half_of(Sender, context, Topic("/scan", "transmit", **fields), self.peer)
        self.ticks: list[float] = []
        self.loop = loop
        self.sender.route.open(1)
        self.sender.route.on_accepted()
        self.sender.carried.channel = Channel()  # type: ignore[assignment]

    def wait(self, seconds: float) -> None:
        for _ in range(int(seconds)):
            self.loop.jump(1.0)
            now = self.loop.time()
            for route in self.peer.timetable.look(now):
                tick_if_due(route, now, looked_at=False)
                if not route.idling.goes_on_now:
                    self.ticks.append(now)

    def wait_until_idle(self) -> None:
        """Wait until the route is idle, and start counting its ticks."""
        self.wait(SETTLES + 5)
        assert self.sender.route.idle
        self.ticks.clear()

    def find_talker(self, node: str = "/talker") -> None:
        self.sender.carried.endpoints = [TALKER._replace(node=node)]

    def lose_packets(self) -> None:
        self.peer.path.fault = PathFault(LinkCause.LOSSY, "the path loses packets")

    def fill_link(self) -> None:
        self.peer.fullness.out = Fullness(5e3, 15e3)


def test_quiet_route_is_not_ticked_at_all(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    world = World(loop, make_context())
    world.find_talker()
    world.wait_until_idle()
    world.wait(86_400)
    assert not world.ticks
    world.sender.flow.count(300, 30_000, world.sender.route.context.now())
    world.wait(1)
    assert len(world.ticks) == 1
    assert world.sender.route.meter.rate == 100.0, "300 messages in three seconds, and not in a day"


def test_route_without_publisher_is_ticked_seldom_but_ticked(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    world = World(loop, make_context())
    world.wait(SETTLES)
    assert len(world.ticks) == SETTLES
    world.wait_until_idle()
    began = world.loop.time()
    world.wait(100 * POLLED_EVERY)
    assert 100 <= len(world.ticks) <= 250
    pairs = zip([began, *world.ticks], world.ticks, strict=False)
    assert max(after - before for before, after in pairs) <= POLLED_EVERY + 1


DOWN = VerdictRecord("DOWN", Cause.NOT_PUBLISHED, "refused by the middleware")


def test_counts_without_latency_do_not_keep_it_awake(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    """Such as the first ones of an opening, which nothing has come on."""
    world = World(loop, make_context())
    world.find_talker()
    world.wait_until_idle()
    world.sender.reported(ReceivedCounts(route=1))
    world.wait(SETTLES)
    assert len(world.ticks) <= 2


def test_calm_route_rests_at_next_tick_though_that_is_early() -> None:
    idling = Idling(0.0)
    for now, until in ((10.003, 10.003), (11.0, inf)):
        idling.ticked(("changed",), 0, now, lambda: inf, lambda _: True)
        assert idling.until == until


@pytest.mark.parametrize(
    "happens",
    [
        lambda world: world.sender.flow.count(1, 100, world.sender.route.context.now()),
        lambda world: world.find_talker("/other"),
        lambda world: world.sender.route.limit.set_max_rate(7.0),
        lambda world: world.sender.reported(ReceivedReport(route=1, verdict=DOWN)),
        lambda world: world.sender.route.judge_again(),
    ],
    ids=["message", "endpoint", "limit", "report", "again"],
)
def test_whatever_happens_has_it_ticked_each_second_for_a_while(
    happens: Callable[[World], None], loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    world = World(loop, make_context())
    world.find_talker()
    world.wait_until_idle()
    happens(world)
    world.sender.route.advance()
    world.wait(SETTLES)
    assert len(world.ticks) == SETTLES
    world.wait(200)
    assert len(world.ticks) < SETTLES + 100, "a message is in the rate for half a minute"


def test_route_that_nothing_counts_against_rests_soon(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    world = World(loop, make_context())
    world.find_talker()
    world.wait_until_idle()
    world.sender.route.pausing.change(paused=True)
    world.wait(SETTLES)
    assert len(world.ticks) < SETTLES / 2
    assert world.sender.route.idle


@pytest.mark.parametrize("lasts", [World.fill_link, World.lose_packets], ids=["full", "path"])
def test_route_of_a_link_at_fault_is_not_idle(
    lasts: Callable[[World], None], loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    world = World(loop, make_context())
    world.find_talker()
    world.wait_until_idle()
    lasts(world)
    world.sender.route.judge_again()
    world.wait(100)
    assert len(world.ticks) == 100


@pytest.mark.parametrize(
    ("fields", "state"),
    [({"expected_rate": 1.0}, State.STOPPED), ({"stale_after": 20.0}, State.STALE), ({}, State.WAITING)],
    ids=lambda value: " ".join(value) if isinstance(value, dict) else "",
)
def test_missing_publisher_is_fault_where_entry_demands(
    fields: dict[str, float], state: State, loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    """Without one, type and QoS are unknown, so that nothing is described and there is no channel."""
    world = World(loop, make_context(), **fields)
    world.sender.carried.channel = None
    world.wait(12)
    assert world.sender.route.verdict().state is State.WAITING
    world.wait(20)
    assert (world.sender.route.verdict().state, world.sender.route.verdict().cause) == (state, Cause.NO_PUBLISHER)


def test_long_silence_is_noticed_in_time(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    after = 167.0
    world = World(loop, make_context(), stale_after=after)
    world.find_talker()
    world.sender.flow.count(1, 100, loop.time())
    came = loop.time()
    world.wait(after - 1)
    assert (world.sender.route.verdict().state, len(world.ticks) < after / 2) == (State.OK, True)
    world.wait(1)
    assert (world.sender.route.verdict().state, loop.time()) == (State.STALE, came + after)


def test_route_that_is_stale_is_ticked_for_its_warnings(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    world = World(loop, make_context(), stale_after=50.0)
    world.find_talker()
    world.wait(1000)
    warned = [event for event in world.sender.route.context.events.after(0) if event.code is EventCode.ROUTE_STALE]
    assert world.sender.route.verdict().state is State.STALE
    assert len(warned) == world.sender.flow.silence.watch.times
    assert len(world.ticks) < 1000 / 4, "it settles after each warning"

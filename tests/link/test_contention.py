"""The shares of a link's topics while it carries less than they ask for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
from rsb_bridge.route.thinning import Share, Thinning, Traffic

from rsb_bridge.link.contention import Contention, LinkFullness, _Asking
from rsb_bridge.link.proposals import proposal_of
from rsb_bridge.model.profiles import PLAIN
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.ros_interface import RawMessage
from rsb_bridge.route.ledger import RouteLedger
from rsb_bridge.route.sending import OutgoingPath
from rsb_bridge.transport.registry import default_transports

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.route.loop_filter import LoopFilter
    from rsb_bridge.route.outgoing import OutgoingRoute
    from rsb_bridge.route.route import Route

ASKED = 100_000.0
"""Bytes/s, by each topic."""


class Clock:
    time = 1000.0

    def now(self) -> float:
        return self.time

    wall = now


class Sends:
    """The part of a route that the test needs."""

    def __init__(self, rank: int) -> None:
        self.rank = rank
        self.topic = f"/{rank}"
        self.qos = Qos(reliability="best_effort")
        self.thinning = Thinning(1000.0)


class Link:
    """Two topics, of which one goes first."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.first, self.last = Sends(1), Sends(-1)
        self.contention = Contention(cast("Context", self.clock), list, list, LinkFullness(lambda *_: None))

    def second(self, crossed: float, *, full: bool) -> float | None:
        """One passes in which so many bytes crossed; gives what the second topic has, None: all that it likes."""
        self.clock.time += 1.0
        asking = [
            _Asking(cast("OutgoingRoute", route), Traffic(ASKED, 1_000.0, 1.0)) for route in (self.first, self.last)
        ]
        self.contention._divide(asking, crossed, self.clock.time, full=full, held_up=False)
        share = self.last.thinning.share
        return None if share is None else share.bytes_per_second


def test_a_link_that_stalls_is_not_taken_for_one_that_carries_nothing() -> None:
    link = Link()
    before = link.second(120_000.0, full=True)
    assert before
    assert link.second(0.0, full=True) == before
    link = Link()
    assert link.second(0.0, full=True) is None


def test_who_yields_gets_back_what_crosses_again() -> None:
    """For example after some seconds in which next to nothing crossed."""
    link = Link()
    assert (link.second(10.0, full=True) or 0.0) < 10.0
    assert (link.second(ASKED, full=False) or 0.0) >= 0.04 * ASKED


def test_the_next_connection_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rsb_bridge.link.contention.OutgoingRoute", Sends)
    link = Link()
    assert link.second(50_000.0, full=True) is not None
    for second in range(4):
        link.contention.sending.look(1e5, second, second, full=True)
    link.contention._routes = lambda: cast("list[Route]", [link.first, link.last])
    link.contention.disconnected()
    assert link.last.thinning.share is None
    link.contention._routes = list
    assert link.second(50_000.0, full=False) is None
    link.contention.sending.look(1e5, 1000.0, 1000.0, full=True)
    assert link.contention.sending.look(1e5, 1001.0, 1001.0, full=True) == 1e5, "the time without a link does not count"


def test_a_message_that_was_held_back_goes_once_there_is_room_for_it() -> None:
    """However little there was when the one before it went."""
    thinning, reliable = Thinning(0.0), Qos()
    for share in (0.0, 1e5):
        thinning.take_share(Share(share, 1e5, 2e5, "/first"), low=False, qos=reliable, now=10.0)
        if not share:
            thinning.sent(1_000_000, 10.0)
    assert thinning.wait(10.0) == pytest.approx(10.0)
    thinning.take_share(None, low=False, qos=reliable, now=10.0)
    thinning.take_share(Share(1e5, 1e5, 2e5, "/first"), low=False, qos=reliable, now=11.0)
    assert thinning.wait(11.0) == 0.0


def test_what_is_held_back_is_looked_at_again_as_often_as_shares_change() -> None:
    """Not only once its time has come by the share that it had when it began to wait."""
    delays: list[float] = []
    clock = SimpleNamespace(call_later=lambda delay, _: delays.append(delay), now=lambda: 1000.0)
    clock.loop = clock
    thinning = Thinning(1000.0)
    thinning.take_share(Share(0.0, 1e5, 2e5, "/first"), low=False, qos=Qos(), now=1000.0)
    transport = default_transports()["tcp"]
    proposal = proposal_of(Topic("/map", "transmit"), transport, client_name="robot1", use_name=False)
    route = SimpleNamespace(
        transport=transport,
        proposal=proposal,
        channel=SimpleNamespace(congested=False, batch_bytes=1, ready=True, carrier=None, send=lambda _: None),
        qos=Qos(),
        notices=SimpleNamespace(message_error=pytest.fail),
        peek_slot=SimpleNamespace(wanted=False),
        thinning=thinning,
        arming=SimpleNamespace(required=False),
        age=SimpleNamespace(is_on=False, is_young=lambda _: True),
        peer=SimpleNamespace(profile=PLAIN, stamp_shift=0),
        life=SimpleNamespace(accepted=True),
        count=lambda *_: None,
    )
    loop_filter = SimpleNamespace(table=SimpleNamespace(flags={b"": 0}))
    path = OutgoingPath(cast("Context", clock), cast("Any", route), RouteLedger(), cast("LoopFilter", loop_filter))
    path.offer([RawMessage(bytes(100_000), 1, b"", number) for number in (1, 2)])
    assert thinning.wait(1000.0) > 3600.0
    assert delays == [1.0]

"""A route is judged once a second, and when somebody changes it; readers get the last verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.support import replaced
from tests.support.offline import FakePeer, half_of

from rsb_bridge.model.capacity import Fullness
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.route.blocking_rules import ACCEPTED, judge
from rsb_bridge.route.incoming import IncomingRoute
from rsb_bridge.route.outgoing import OutgoingRoute
from rsb_bridge.route.topic_verdict import waits_for
from rsb_bridge.wire.records import SentReport

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest

    from rsb_bridge.context import Context
    from rsb_bridge.route.crossing import Crossing


def test_snapshots_keep_verdict_until_change(
    make_context: Callable[..., Context], monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[Crossing] = []

    def counted(half: OutgoingRoute, crossing: Crossing, rules: Any) -> Verdict:
        judged.append(crossing)
        return judge(half, crossing, rules)

    replaced.JUDGE.set(monkeypatch, counted)
    route = half_of(OutgoingRoute, make_context(), Topic("/scan", "transmit"))
    route.open(1)
    route.on_accepted()
    route.tick()
    shown = [route.snapshot() for _ in range(8)]
    assert len(judged) == 1
    assert {each.state for each in shown} == {State.WAITING}
    route.pausing.change(paused=True)
    assert route.snapshot().state is State.PAUSED
    route.pausing.change(paused=False)
    assert route.snapshot().state is State.WAITING
    route.close("gone")
    assert route.snapshot().state is State.WAITING
    assert len(judged) == 4
    route.tick()
    assert len(judged) == 5


def test_route_learns_nothing_on_full_link(
    make_context: Callable[..., Context],
) -> None:
    halves: tuple[tuple[Callable[..., OutgoingRoute | IncomingRoute], Topic], ...] = (
        (OutgoingRoute, Topic("/scan", "transmit")),
        (IncomingRoute, Topic("/scan", "receive")),
    )
    for half, topic in halves:
        peer = FakePeer()
        route = half_of(half, make_context(), topic, peer)
        assert route.learns
        peer.fullness.out = peer.fullness.into = Fullness(5e3, 15e3)
        assert not route.learns
        peer.fullness.out = peer.fullness.into = None
        assert route.learns
        route.judged.announce(Verdict(State.SLOW, Cause.QUEUE_FULL, "lost"), 1.0)
        assert not route.learns
        route.judged.announce(Verdict(State.SLOW, Cause.SLOW, "the publisher is slow"), 2.0)
        assert route.learns


def test_receiver_does_not_claim_what_sender_knows(make_context: Callable[..., Context]) -> None:
    """Whenever a route was opened, its row said for seconds that no publisher was seen, or that it waits for one."""
    receiver = half_of(IncomingRoute, make_context(), Topic("/scan", "receive"))
    for number in (1, 3):
        receiver.close("reopened")
        receiver.open(number)
        assert waits_for(receiver) == ACCEPTED
        receiver.on_accepted()
        claims = {stage.name for stage in receiver.stages()}
        assert waits_for(receiver) not in claims
        assert {stage.name for stage in receiver.stages() if stage.done is False} == set()
        before = receiver.verdict()
        assert (before.state, before.cause) == (State.WAITING, Cause.NO_MESSAGE)
        receiver.reported(SentReport(route=number, publishers=0))
        assert receiver.verdict() != before, "judged again before the next tick"
        assert next(stage for stage in receiver.stages() if stage.done is False).name == "publisher seen"


def test_sender_knows_of_messages_before_start(make_context: Callable[..., Context]) -> None:
    """A client that was killed begins with nothing; the server has had messages of the one before."""
    sender = half_of(OutgoingRoute, make_context(), Topic("/scan", "transmit"))
    receiver = half_of(IncomingRoute, make_context(), Topic("/scan", "receive"))
    for route in (sender, receiver):
        route.open(1)
        route.on_accepted()
    assert not sender.came_before
    receiver.meter.last = receiver.opened_at - 46.0
    report = receiver.news()
    assert report is not None
    sender.reported(report)
    assert sender.came_before
    assert receiver.came_before
    sender.count(1, 10, sender.context.now())
    assert not sender.came_before

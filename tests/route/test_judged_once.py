"""A route is judged once a second, and when somebody changes it; readers get the last verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.support import replaced
from tests.support.offline import FakePeer, half_of
from tests.support.reports import told_words

from rsb_bridge.model.capacity import Fullness
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.route.blocking_rules import ACCEPTED, judge
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sender import Sender
from rsb_bridge.route.topic_verdict import waits_for
from rsb_bridge.wire.records import SentReport

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest

    from rsb_bridge.context import Context
    from rsb_bridge.route.crossing import Crossing
    from rsb_bridge.route.topic_facts import SenderFacts


def test_snapshots_keep_verdict_until_change(
    make_context: Callable[..., Context], monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[Crossing] = []

    def counted(half: SenderFacts, crossing: Crossing, rules: Any) -> tuple[Verdict, Verdict]:
        judged.append(crossing)
        return judge(half, crossing, rules)

    replaced.JUDGE.set(monkeypatch, counted)
    sender = half_of(Sender, make_context(), Topic("/scan", "transmit"))
    sender.route.open(1)
    sender.route.on_accepted()
    sender.route.tick()
    shown = [sender.route.snapshot() for _ in range(8)]
    assert len(judged) == 1
    assert {each.state for each in shown} == {State.WAITING}
    sender.route.pausing.change(paused=True)
    assert sender.route.snapshot().state is State.PAUSED
    sender.route.pausing.change(paused=False)
    assert sender.route.snapshot().state is State.WAITING
    sender.route.close("gone")
    assert sender.route.snapshot().state is State.WAITING
    assert len(judged) == 4
    sender.route.tick()
    assert len(judged) == 5


def test_feature_is_asked_once_for_both_sides(make_context: Callable[..., Context]) -> None:
    asked: list[Any] = []

    def verdicts(route: Any) -> list[Verdict]:
        asked.append(route)
        return [Verdict(State.SLOW, "watch.bent", "the mast is bent: straighten it", here=True)]

    peer = FakePeer()
    peer.verdicts = verdicts
    halves: tuple[tuple[type[Sender | Receiver], Topic], ...] = (
        (Sender, Topic("/scan", "transmit")),
        (Receiver, Topic("/scan", "receive")),
    )
    for kind, topic in halves:
        half = half_of(kind, make_context(), topic, peer)
        half.route.open(1)
        half.route.on_accepted()
        half.route.tick()
        asked.clear()
        half.route.judge_again()
        assert half.route.verdict().cause == "watch.bent"
        for _ in range(3):
            report = told_words(half)
            assert report is None or report.verdict is None or report.verdict.cause != "watch.bent"
        assert asked == [half.route]


def test_route_learns_nothing_on_full_link(
    make_context: Callable[..., Context],
) -> None:
    halves: tuple[tuple[type[Sender | Receiver], Topic], ...] = (
        (Sender, Topic("/scan", "transmit")),
        (Receiver, Topic("/scan", "receive")),
    )
    for kind, topic in halves:
        peer = FakePeer()
        half = half_of(kind, make_context(), topic, peer)
        assert half.facts.learns
        peer.fullness.out = peer.fullness.into = Fullness(5e3, 15e3)
        assert not half.facts.learns
        peer.fullness.out = peer.fullness.into = None
        assert half.facts.learns
        half.route.judged.announce(Verdict(State.SLOW, Cause.QUEUE_FULL, "lost"), 1.0)
        assert not half.facts.learns
        half.route.judged.announce(Verdict(State.SLOW, Cause.SLOW, "the publisher is slow"), 2.0)
        assert half.facts.learns


def test_receiver_does_not_claim_what_sender_knows(make_context: Callable[..., Context]) -> None:
    """Whenever a route was opened, its row said for seconds that no publisher was seen, or that it waits for one."""
    receiver = half_of(Receiver, make_context(), Topic("/scan", "receive"))
    for number in (1, 3):
        receiver.route.close("reopened")
        receiver.route.open(number)
        assert waits_for(receiver.facts) == f"not yet: {ACCEPTED}"
        receiver.route.on_accepted()
        claims = {f"not yet: {stage.name}" for stage in receiver.facts.stages()}
        assert waits_for(receiver.facts) not in claims
        assert {stage.name for stage in receiver.facts.stages() if stage.done is False} == set()
        before = receiver.route.verdict()
        assert (before.state, before.cause) == (State.WAITING, Cause.NO_MESSAGE)
        receiver.reported(SentReport(route=number, publishers=0))
        assert receiver.route.verdict() != before, "judged again before the next tick"
        assert next(stage for stage in receiver.facts.stages() if stage.done is False).name == "publisher seen"


def test_sender_knows_of_messages_before_start(make_context: Callable[..., Context]) -> None:
    """A client that was killed begins with nothing; the server has had messages of the one before."""
    sender = half_of(Sender, make_context(), Topic("/scan", "transmit"))
    receiver = half_of(Receiver, make_context(), Topic("/scan", "receive"))
    for route in (sender.route, receiver.route):
        route.open(1)
        route.on_accepted()
    assert not sender.facts.came_before
    receiver.route.meter.last = receiver.route.opened_at - 46.0
    report = told_words(receiver)
    sender.reported(report)
    assert sender.facts.came_before
    assert receiver.facts.came_before
    sender.flow.count(1, 10, sender.route.context.now())
    assert not sender.facts.came_before

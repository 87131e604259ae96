"""When a reliable topic with ``qos: auto`` keeps what a stall would lose, and when only what is new."""

from __future__ import annotations

import pytest

from rsb_bridge.channel.channel import Pace
from rsb_bridge.model.qos import Qos
from rsb_bridge.route.ledger import RouteLedger
from rsb_bridge.route.sending import Outbox, Overload, QueueLimits
from rsb_bridge.transport.registry import default_transports
from rsb_bridge.wire.messages import Propose

AUTO = Qos(depth=500)
"""As the engine chooses it before it knows the rate."""


def outbox(qos: Qos | None = None) -> Outbox:
    proposal = Propose(route=1, topic="/t", remote_topic="/t", from_client=True, qos=qos)
    return Outbox(default_transports()["tcp"], proposal, RouteLedger(), lambda *_: None)


def flood(box: Outbox, seconds: int, pace: Pace, qos: Qos = AUTO) -> QueueLimits:
    """Queue 10 messages a second, of which none is sent; the limits at the end."""
    limits = box.limits(qos, 0, pace, 0.0)
    for tick in range(10 * seconds):
        limits = box.limits(qos, 0, pace, tick / 10)
        box.add([(b"", 0, 0)], tick / 10, b"", limits)
    return limits


def test_overload_keeps_only_new_messages() -> None:
    box = outbox()
    assert flood(box, 10, Pace.SLOW).younger_than == 1.0
    assert len(box) <= 11


def test_stall_keeps_messages_for_seconds() -> None:
    box = outbox()
    limits = flood(box, 4, Pace.STOPPED)
    assert (limits.depth, limits.younger_than) == (500, 5.0)
    assert len(box) == 40


@pytest.mark.parametrize("pace", Pace)
def test_live_topic_sends_nothing_old(pace: Pace) -> None:
    """Whether the link is slow, stopped or has only begun."""
    box = outbox()
    flood(box, 10, pace, Qos(reliability="best_effort"))
    assert box.waits(9.9) <= 1.0
    flood(box := outbox(Qos(reliability="best_effort", depth=50)), 10, pace, Qos(reliability="best_effort", depth=50))
    assert box.waits(9.9) > 4.0


@pytest.mark.parametrize(
    ("own", "qos"), [(Qos(depth=20), Qos(depth=20)), (None, Qos(depth=20, durability="transient_local"))]
)
def test_depths_that_are_promised_are_kept(own: Qos | None, qos: Qos) -> None:
    box = outbox(own)
    assert flood(box, 10, Pace.SLOW, qos).depth == 20
    assert len(box) >= 20


def test_keep_all_keeps_all() -> None:
    box = outbox()
    flood(box, 10, Pace.SLOW, Qos(history="keep_all"))
    assert len(box) == 100


def test_queue_that_drains_after_a_stall_is_no_overload() -> None:
    overload = Overload()
    for tick in range(30):
        overload.judge(tick / 10, 0.0, tick, moves=False)
    for tick in range(30, 60):
        overload.judge(tick / 10, (tick - 30) / 10 * 2, 30 - (tick - 30), moves=True)
        assert not overload.lasts


def test_overload_ends_with_the_queue() -> None:
    overload = Overload()
    for tick in range(40):
        overload.judge(tick / 10, 0.0, tick, moves=True)
    assert overload.lasts
    overload.over()
    assert not overload.lasts

"""Messages that wait for a link: reliable ones that a stall would lose, or new ones; young best-effort ones."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
from tests.route.loop_filter_helpers import Channel

from rsb_bridge.channel.scheduler import SendingChannel
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.transports import NO_PROFILE
from rsb_bridge.route.catching_up import Backlog
from rsb_bridge.route.half import Carried
from rsb_bridge.route.ledger import RouteLedger
from rsb_bridge.route.peer_budget import PeerBudget
from rsb_bridge.route.sending import Outbox, Overload, QueueLimits
from rsb_bridge.route.topic_flow import AgreedEnd
from rsb_bridge.transport.registry import default_transports
from rsb_bridge.wire.messages import Propose

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.wire.framing import Message

AUTO = Qos(depth=500)
"""As the engine chooses it before it knows the rate."""


def outbox(qos: Qos | None = None, *, own: Qos | None = None) -> Outbox:
    """Make the queue of a route with a QoS, which its own session may name."""
    route: Any = SimpleNamespace(
        transport=default_transports()["tcp"],
        proposal=Propose(route=1, topic="/t", remote_topic="/t", from_client=True, qos=own),
        qos=qos or AUTO,
        arming=SimpleNamespace(required=False),
        age=SimpleNamespace(only_newest=False),
        peer=SimpleNamespace(
            profile=NO_PROFILE,
            linked=True,
            budget=PeerBudget(0.0),
            keepalive=SimpleNamespace(quiet=0.0, in_doubt=False),
        ),
    )
    route.route = route
    route.carried = Carried[SendingChannel]()
    route.end = AgreedEnd(route)
    return Outbox(route, RouteLedger(), Backlog())


class FullChannel(Channel):
    """It takes one message in a turn."""

    batch_bytes = 1

    def __init__(self, free: bool, *, behind: bool = False) -> None:
        super().__init__()
        self._free, self._behind = free, behind

    @property
    def free(self) -> bool:
        return self._free

    def behind(self, now: float) -> bool:
        return self._behind and now > 1.0

    def send(self, batch: Sequence[Message]) -> None:
        super().send(batch)
        self.congested = True


def flood(
    box: Outbox, seconds: int, free: bool, *, turn_every: int = 0, behind: bool = False
) -> tuple[QueueLimits, list[bytes]]:
    """Queue 10 numbered messages a second. Return the limits at the end, and the sent messages."""
    full = FullChannel(free, behind=behind)
    channel = cast("SendingChannel", full)
    limits = box.limits(channel, 0, 0.0)
    for tick in range(10 * seconds):
        limits = box.limits(channel, 0, tick / 10)
        box.add([(b"%d" % tick, 0, 0)], tick / 10, b"", limits)
        if turn_every and not tick % turn_every:
            full.congested = False
            box.flush(channel, tick / 10)
    return limits, [payload for payload, _ in full.sent]


def test_overload_keeps_only_new_messages() -> None:
    box = outbox()
    limits, sent = flood(box, 20, False, turn_every=3)
    assert limits.younger_than == 1.0
    assert len(box) <= 11
    assert int(sent[-1]) > 180, "no message is sent late"


def test_stall_keeps_messages_for_seconds() -> None:
    box = outbox()
    limits, _ = flood(box, 4, False)
    assert (limits.depth, limits.younger_than) == (500, 5.0)
    assert len(box) == 40


def test_live_topic_sends_newest_under_load() -> None:
    """Otherwise each one would wait for the whole depth of the queue."""
    qos = Qos(reliability="best_effort", depth=5)
    _, sent = flood(outbox(qos), 20, False, turn_every=3, behind=True)
    assert sent[-3:] == [b"191", b"194", b"197"]
    _, sent = flood(outbox(qos, own=qos), 20, False, turn_every=3, behind=True)
    assert sent[-1] == b"194", "a depth that is promised is kept"


def test_live_topic_loses_nothing_in_stall_below_second() -> None:
    box, channel = outbox(Qos(reliability="best_effort", depth=5)), FullChannel(False)
    limits = box.limits(cast("SendingChannel", channel), 0, 0.0)
    box.add([(b"%d" % number, 0, 0) for number in range(5)], 0.0, b"", limits)
    box.flush(cast("SendingChannel", channel), 0.9)
    assert channel.sent == [(b"0", 0)]
    channel.congested = False
    box.flush(cast("SendingChannel", channel), 1.1)
    assert [payload for payload, _ in channel.sent] == [b"0", b"4"], (
        "of what is older than a second, only the newest is sent"
    )


@pytest.mark.parametrize("free", [True, False])
def test_live_topic_sends_nothing_old(free: bool) -> None:
    """Whether the link is slow, stopped or has only begun."""
    flood(box := outbox(Qos(reliability="best_effort")), 10, free)
    assert box.waits(9.9) <= 1.0
    qos = Qos(reliability="best_effort", depth=50)
    flood(box := outbox(qos, own=qos), 10, free)
    assert box.waits(9.9) > 4.0


@pytest.mark.parametrize(
    ("own", "qos"), [(Qos(depth=20), Qos(depth=20)), (None, Qos(depth=20, durability="transient_local"))]
)
def test_depths_that_are_promised_are_kept(own: Qos | None, qos: Qos) -> None:
    box = outbox(qos, own=own)
    limits, _ = flood(box, 10, False)
    assert limits.depth == 20
    assert len(box) >= 20


def test_keep_all_keeps_all() -> None:
    flood(box := outbox(Qos(history="keep_all")), 10, False)
    assert len(box) == 100


def test_queue_that_drains_after_stall_is_no_overload() -> None:
    overload = Overload()
    for tick in range(30):
        overload.judge(tick / 10, 0.0, tick)
    for tick in range(30, 60):
        overload.turn()
        overload.judge(tick / 10, (tick - 30) / 10 * 2, 30 - (tick - 30))
        assert not overload.lasts(tick / 10)


def test_a_second_stall_is_no_overload() -> None:
    """Although the queue has had turns since the first one, and is older and longer."""
    overload = Overload()
    overload.judge(3.0, 0.0, 30)
    overload.turn()
    for tick in range(31, 60):
        overload.judge(tick / 10, 0.1, tick, still=(tick - 31) / 10)
    assert not overload.lasts(6.0)


def test_overload_ends_with_the_queue() -> None:
    overload = Overload()
    for tick in range(40):
        overload.turn()
        overload.judge(tick / 10, 0.0, tick)
    assert overload.lasts(4.0)
    overload.reset()
    assert not overload.lasts(4.0)


def test_drops_despite_turns_mean_overload() -> None:
    """A tunnel's window opens each few seconds, and lets through all that waits."""
    for turns in (False, True):
        overload = Overload()
        overload.turn()
        overload.dropped(10.0)
        if turns:
            overload.turn()
        overload.dropped(16.0)
        assert (overload.lasts(16.0), overload.lasts(27.0)) == (turns, False)

"""Compressed messages that grow: none is lost, the order stays, and others have their turn between them."""

from __future__ import annotations

import asyncio
import itertools
from typing import TYPE_CHECKING

import pytest
from tests.route.unpacking_helpers import HUGE, LARGE, HeldLoop, OnePublisher, Published, grown, loop, opened
from tests.support import constants
from tests.support.offline import FakePeer
from tests.support.reports import told_counts

from rsb_bridge.route.message_check import EXPANDED_ASIDE, EXPANSION_A_TURN, EXPANSION_AT_ONCE
from rsb_bridge.wire.framing import ZSTD

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

__all__ = ["loop"]

MEDIUM = EXPANDED_ASIDE - 100
"""Unpacked on the loop."""


def turns(loop: VirtualLoop, published: Published) -> list[int]:
    """Return the number of messages after each turn of the loop, until none is left."""
    counts = [len(published.sizes)]

    async def watch() -> None:
        for _ in range(20):
            counts.append(len(published.sizes))
            await asyncio.sleep(0)

    loop.run_until_complete(watch())
    return counts


def test_each_turn_has_one_that_grows_much(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    """The limit is per link; later messages of the same route wait, too."""
    ros, peer = OnePublisher(), FakePeer()
    context = make_context(ros=ros)
    one, other = opened(context, peer, "/one"), opened(context, peer, "/other")
    most = EXPANSION_A_TURN // MEDIUM
    first, second = ([grown(MEDIUM + number + offset) for number in range(most)] for offset in (0, 50))
    one.deliver([*first, (b"small", 0, 0)])
    other.deliver(second)
    one.deliver([(b"last", 0, 0)])
    counts = turns(loop, ros.published)
    assert counts[0] == most + 2
    assert max(after - before for before, after in itertools.pairwise(counts)) <= most
    assert ros.published.sizes == [*range(MEDIUM, MEDIUM + most), 5, 4, *range(MEDIUM + 50, MEDIUM + 50 + most)]
    assert not loop.errors


def test_long_messages_are_unpacked_off_loop_in_order(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    """One at a time of a link. Its other routes, and other links, have their turn meanwhile."""
    ros, peer, stranger = OnePublisher(), FakePeer(), FakePeer()
    context = make_context(ros=ros)
    one, other, third = opened(context, peer, "/one"), opened(context, peer, "/other"), opened(context, stranger, "/x")
    one.deliver([(b"first", 0, 0), grown(LARGE), grown(LARGE + 1), (b"small", 0, 0)])
    other.deliver([(b"by the way", 0, 0), grown(LARGE + 2)])
    third.deliver([grown(LARGE + 3)])
    one.deliver([(b"last", 0, 0)])
    assert ros.published.sizes == [5, 10]
    assert len(loop.held) == 2  # one of each link
    loop.finish_one()
    assert ros.published.sizes[2:] == [LARGE]
    loop.finish_one()
    assert ros.published.sizes[3:] == [LARGE + 3]
    while loop.held:
        loop.finish_one()
    assert ros.published.sizes[4:] == [LARGE + 2, LARGE + 1, 5, 4]
    assert not loop.errors


def test_longest_messages_are_published_off_the_loop(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    """They keep their order, and none is unpacked before the one that waits for DDS, as each takes memory."""
    ros, peer = OnePublisher(), FakePeer()
    context = make_context(ros=ros)
    one, other = opened(context, peer, "/one"), opened(context, peer, "/other")
    one.deliver([grown(HUGE), (b"small", 0, 0)])
    other.deliver([grown(LARGE)])
    loop.finish_one()
    one.deliver([(b"last", 0, 0)])
    assert not ros.published.sizes
    assert len(loop.held) == 1
    loop.finish_one()
    assert ros.published.sizes == [HUGE, 5, 4]
    loop.finish_one()
    assert ros.published.sizes == [HUGE, 5, 4, LARGE]
    assert not loop.errors


def test_refused_long_message_counts_as_dropped(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    ros = OnePublisher()
    receiver = opened(make_context(ros=ros), FakePeer(), "/one")
    receiver.deliver([grown(HUGE), (b"small", 0, 0)])
    loop.finish_one()
    ros.published.refuses = True
    work, done = loop.held.popleft()
    done.set_result(work())
    ros.published.refuses = False
    loop.run_until_complete(asyncio.sleep(0.1))
    assert ros.published.sizes == [5]
    report = told_counts(receiver)
    assert (report.delivered, sum(report.dropped.values())) == (1, 1)


def test_long_message_of_earlier_opening_holds_nothing_up(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    ros, peer = OnePublisher(), FakePeer()
    context = make_context(ros=ros)
    receiver, other = opened(context, peer, "/one"), opened(context, peer, "/other")
    receiver.deliver([grown(HUGE), (b"small", 0, 0)])
    loop.finish_one()
    other.deliver([grown(LARGE)])
    receiver.route.close("over")
    while loop.held:
        loop.finish_one()
    assert ros.published.sizes == [LARGE]
    assert not loop.errors


def test_a_backlog_is_bounded(
    loop: HeldLoop, make_context: Callable[..., Context], monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.CHECK_BACKLOG_LIMIT.set(monkeypatch, 100_000)
    ros = OnePublisher()
    receiver = opened(make_context(ros=ros), FakePeer(), "/one")
    receiver.deliver([grown(LARGE)])
    receiver.deliver([(bytes(90_000), 0, 0)])
    assert receiver.route.id
    receiver.deliver([(bytes(20_000), 0, 0)])
    assert not receiver.route.id
    while loop.held:
        loop.finish_one()
    assert not ros.published.sizes


def test_what_waits_is_neither_shown_nor_measured(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    """Operators see the last message that was published, and its latency counts."""
    receiver = opened(make_context(ros=OnePublisher()), FakePeer(), "/one")
    now = receiver.route.context.stamps.now()
    looking = loop.create_task(receiver.flow.peek_slot.next())
    loop.run_until_complete(asyncio.sleep(1.0))
    (first, _, flags), (second, _, _) = grown(LARGE), grown(LARGE + 1)
    receiver.deliver([(first, now + 700_000_000, flags), (second, now, flags)])
    loop.finish_one()
    shown = loop.run_until_complete(looking)
    assert shown.size == LARGE
    assert shown.latency == pytest.approx(0.3, abs=0.02)  # with the pace of late messages


def test_what_is_refused_waits_for_nothing(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    """The waiting bytes are bounded by the growth that a link's messages may have at once."""
    ros, peer = OnePublisher(), FakePeer()
    receiver = opened(make_context(ros=ros), peer, "/one")
    peer.budget.expansion.over_time.take(EXPANSION_AT_ONCE - LARGE, 0.0)
    receiver.deliver([grown(LARGE)] * 100 + [(b"damaged", 0, ZSTD), (b"last", 0, 0)])
    loop.finish_one()
    assert ros.published.sizes == [LARGE, 4]
    assert not loop.held


def test_an_opening_that_is_over_publishes_nothing_more(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    ros, peer = OnePublisher(), FakePeer()
    receiver = opened(make_context(ros=ros), peer, "/one")
    receiver.deliver([grown(LARGE), grown(LARGE)])
    receiver.route.close("over")
    loop.finish_one()
    assert not ros.published.sizes
    assert not loop.held

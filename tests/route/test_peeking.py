"""Looking at messages takes no more than its bounds, on a clock of its own."""

from __future__ import annotations

import asyncio
import itertools
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from rsb_bridge.channel.channel import DataChannel
from rsb_bridge.model.snapshot import PEEK_LIMIT
from rsb_bridge.route import peeking
from rsb_bridge.route.half import Carried
from rsb_bridge.route.peeking import Peeking, PeekSlot, peeked

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.model.qos import Qos

    Work = Callable[[Peeking], Coroutine[Any, Any, None]]


class Flow:
    """A volatile topic of which a message passes every 10 ms."""

    def __init__(self, loop: VirtualLoop, size: int) -> None:
        self.route: Any = SimpleNamespace(outgoing=True, local_topic="/b", peer=None)
        self.carried = Carried[DataChannel]()
        self.carried.type_name = "a_msgs/msg/B"
        self.qos: Qos | None = None
        self.peek_slot = PeekSlot()
        self.copies: list[float] = []
        self._loop, self._payload = loop, bytes(size)
        self.let_pass()

    def let_pass(self) -> None:
        if self.peek_slot.wanted:
            self.copies.append(self._loop.time())
            self.peek_slot.put(peeked(self, self._payload, 0), self._loop.time())
        self._loop.call_later(0.01, self.let_pass)


@pytest.fixture
def run(
    loop: VirtualLoop, make_context: Callable[..., Any]
) -> Callable[[Callable[[Peeking], Coroutine[Any, Any, None]]], None]:
    return lambda work: loop.run_until_complete(work(Peeking(make_context())))


async def look_on(peeks: Peeking, flow: Flow, times: int) -> None:
    for _ in range(times):
        assert await peeks.peek(flow, kept=False) is not None


def test_route_is_copied_from_twice_a_second(loop: VirtualLoop, run: Any) -> None:
    async def work(peeks: Peeking) -> None:
        flow = Flow(loop, 100)
        await asyncio.gather(*(look_on(peeks, flow, 20) for _ in range(peeking.LOOKERS)))
        assert len(flow.copies) == 20
        assert all(later - earlier >= peeking.EVERY for earlier, later in itertools.pairwise(flow.copies))

    run(work)


def test_large_messages_are_shown_within_bytes_second(loop: VirtualLoop, run: Any) -> None:
    async def work(peeks: Peeking) -> None:
        routes = [Flow(loop, 10 * PEEK_LIMIT) for _ in range(peeking.LOOKERS)]
        began = loop.time()
        await asyncio.gather(*(look_on(peeks, flow, 10) for flow in routes))
        shown = sum(len(flow.copies) for flow in routes) * PEEK_LIMIT
        at_once = peeking.LOOKERS * PEEK_LIMIT
        assert shown <= peeking.BYTES_A_SECOND * (loop.time() - began) + at_once

    run(work)


def test_nobody_holds_place_for_longer_than_its_time(loop: VirtualLoop, run: Any) -> None:
    async def work(peeks: Peeking) -> None:
        flow = Flow(loop, 100)
        flow.let_pass = lambda: None  # type: ignore[method-assign]
        await asyncio.sleep(1)
        began = loop.time()
        assert await peeks.peek(flow, kept=False) is None
        assert loop.time() - began == pytest.approx(peeking.WAITS_AT_MOST)
        assert not flow.peek_slot.wanted

    run(work)

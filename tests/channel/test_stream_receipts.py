"""Both ends of stream channels count the same bytes, so that a sender knows what is in transit."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, cast

import pytest
from tests.channel.test_duplex import CARRIERS, connected, on_its_own, until

from rsb_bridge.channel.receipts import ReceiptBook, ReceiptSender, WindowedSender
from rsb_bridge.channel.window import FIRST

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tests.channel.test_duplex import End, Place, Route

    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.messages import Receipts


@dataclass
class Sides:
    """Two ends that exchange receipts.

    Attributes:
        messages: with receipts, so far.
        silent: whether they get lost.
    """

    near: End
    far: End
    messages: list[Receipts] = field(default_factory=list)
    silent: bool = False

    def begin(self) -> None:
        for end, other in ((self.near, self.far), (self.far, self.near)):
            book = ReceiptBook(asyncio.get_running_loop(), partial(self._carry, other))
            for route in end.routes.values():
                channel = route.channel
                cast("WindowedSender", channel)._book = book
                if isinstance(channel, WindowedSender):
                    channel.begin_window()
                if isinstance(channel, ReceiptSender):
                    channel.begin_receipts()

    def _carry(self, other: End, message: Receipts) -> None:
        self.messages.append(message)
        if self.silent:
            return
        for route_id, count in message.received:
            channel = other.routes[route_id].channel
            assert isinstance(channel, WindowedSender)
            channel.acknowledge(count)
        for route_id, every in message.every:
            channel = other.routes[route_id].channel
            assert isinstance(channel, ReceiptSender)
            channel.set_interval(every)


def in_transit(route: Route) -> int:
    channel = route.channel
    assert isinstance(channel, WindowedSender)
    assert channel._window is not None
    return channel.sent - channel._window._acknowledged


@CARRIERS
@pytest.mark.parametrize("duplex", [False, True])
def test_all_bytes_are_acknowledged(place: Place, duplex: bool) -> None:
    """Small and large messages, on a stream of their own or in turn with another route's."""
    specs = [(1, duplex)] if place is on_its_own else [(1, duplex), (3, duplex)]

    async def live() -> None:
        async with connected(place, *specs) as (near, far):
            sides = Sides(near, far)
            sides.begin()
            payloads = [bytes(size) for size in (1, 5_000, 300_000, 17, 40_000, 1_000_000)]
            for route in near.routes.values():
                route.send(*payloads)
            await until(lambda: all(route.arrived == payloads for route in far.routes.values()))
            for route in far.routes.values():
                cast("ReceiptSender", route.channel).send_receipt()
            await until(lambda: all(in_transit(route) == 0 for route in near.routes.values()))
            assert len(sides.messages) < 200

    asyncio.run(live())


def test_without_receipts_little_is_in_transit() -> None:
    async def live() -> None:
        async with connected(on_its_own, (1, False)) as (near, far):
            sides = Sides(near, far, silent=True)
            sides.begin()
            near.routes[1].send(*[bytes(1000)] * 100)
            await until(lambda: len(far.routes[1].arrived) >= FIRST // 1100)
            assert in_transit(near.routes[1]) <= FIRST + 1100
            assert near.routes[1].waiting

    asyncio.run(live())


@CARRIERS
def test_a_route_that_ends_while_it_takes_messages_sends_no_receipt(place: Place) -> None:
    """Its id is 0 from then on, which in a receipt would break the format and end the link."""

    async def live() -> None:
        async with connected(place, (1, True)) as (near, far):
            sides = Sides(near, far)
            sides.begin()
            route = far.routes[1]

            def deliver(messages: Iterable[Message]) -> None:
                route.arrived += [payload for payload, _, _ in messages]
                route.channel.close("a message broke the format")
                route.id = 0

            route.deliver = deliver  # type: ignore[method-assign]
            near.routes[1].send(bytes(2_000))
            await until(lambda: route.id == 0)
            await asyncio.sleep(0.02)
            assert all(route_id for message in sides.messages for route_id, _ in message.received)

    asyncio.run(live())

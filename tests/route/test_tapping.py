"""Taps, which get all messages of a route: each once, in order, as it passes, beside viewers."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from tests.route.loop_filter_helpers import FIRST, World, world
from tests.route.unpacking_helpers import LARGE, HeldLoop, OnePublisher, grown, loop, opened
from tests.support.offline import FakePeer

from rsb_bridge.ros.ros_interface import RawMessage
from rsb_bridge.route.message_check import PUBLISHED_ASIDE

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from rsb_bridge.context import Context

__all__ = ["loop", "world"]
SOURCE = 5 * 10**9


class Tapped(list[tuple[bytes, int, int, bytes, int]]):
    """The messages that a context's routes have handed to their taps."""

    def __init__(self, context: Context) -> None:
        super().__init__()
        context.tap_of = lambda _, __: lambda *message: self.append(message)

    @property
    def sizes(self) -> list[int]:
        return [len(content) for content, *_ in self]


def test_each_of_messages_that_come_together_is_tapped(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    """Those behind one that is unpacked or published elsewhere follow it."""
    ros = OnePublisher()
    context = make_context(ros=ros)
    tapped = Tapped(context)
    receiver = opened(context, FakePeer(), "/one")
    receiver.deliver([(b"one", 0, 0), grown(LARGE), (b"three", 0, 0), (bytes(PUBLISHED_ASIDE + 1), 0, 0)])
    receiver.deliver([(b"later", 0, 0), grown(100)])
    while loop.held:
        loop.finish_one()
        loop.run_until_complete(asyncio.sleep(0.1))
    assert ros.published.sizes == [3, LARGE, 5, PUBLISHED_ASIDE + 1, 5, 100]
    assert tapped.sizes == ros.published.sizes
    assert [each[3:] for each in tapped] == [(b"", 0)] * 6


def test_what_is_not_published_is_not_tapped(loop: HeldLoop, make_context: Callable[..., Context]) -> None:
    ros = OnePublisher()
    context = make_context(ros=ros)
    tapped = Tapped(context)
    receiver = opened(context, FakePeer(), "/one")
    receiver.deliver([(b"one", 0, 0), (b"of an unknown source", 0, 15 << 4)])
    ros.published.refuses = True
    receiver.deliver([(b"refused", 0, 0)])
    assert tapped.sizes == [3]


def test_messages_from_ros_are_tapped_before_the_rate_limit(world: World) -> None:
    tapped = Tapped(world.context)
    world.sender.flow.renew_tap()
    world.sender.route.limit.set_max_rate(10.0)
    batch = [RawMessage(b"%d" % number, number, FIRST, number + 1, 0, SOURCE + number) for number in range(20)]
    world.path.offer(batch)
    assert len(world.sent) < 20
    now = world.context.wall_ns()
    assert tapped == [(each.payload, now, each.source, FIRST, each.number) for each in batch]


def test_tap_and_viewer_see_one_message(world: World) -> None:
    tapped = Tapped(world.context)
    world.sender.flow.renew_tap()
    looking = world.loop.create_task(world.sender.flow.peek_slot.next())
    world.wait(0.1)
    for word in (b"one", b"two"):
        world.comes(FIRST, word)
    assert world.loop.run_until_complete(looking).payload == b"one"
    assert tapped.sizes == [3, 3]
    assert world.sender.flow.peek_slot.wanted, "by the tap"


@pytest.mark.parametrize("is_viewed", [False, True])
def test_route_asks_nothing_once_its_tap_is_gone(is_viewed: bool, world: World) -> None:
    tapped = Tapped(world.context)
    world.sender.flow.renew_tap()
    if is_viewed:
        world.loop.create_task(world.sender.flow.peek_slot.next())
        world.wait(0.1)
    none: Any = lambda _, __: None  # noqa: E731
    world.context.tap_of = none
    world.sender.flow.renew_tap()
    assert world.sender.flow.peek_slot.wanted is is_viewed
    world.comes(FIRST, b"one")
    assert not tapped
    assert not world.sender.flow.peek_slot.wanted

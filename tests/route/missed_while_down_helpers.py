"""Helpers of `test_missed_while_down` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.route.loop_filter_helpers import FIRST, SCAN, Graph, Peer, World
from tests.support.offline import half_of

from rsb_bridge.model.session import Topic
from rsb_bridge.route.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.ros.publication_numbers import PublicationNumbers


class NumberedGraph(Graph):
    """A graph whose publisher has numbered messages before each subscription.

    Attributes:
        numbers: of the present subscription.
        published: messages so far.
    """

    numbers: PublicationNumbers
    published = 0

    def subscribe(self, _: object, sink: Any, *rest: Any, **__: Any) -> Any:
        self.numbers = rest[-1]
        self.numbers.begin(frozenset({FIRST}))
        return super().subscribe(_, sink)

    def publish(self, count: int, *, heard: bool) -> None:
        for _ in range(count):
            self.published += 1
            if not heard:
                continue
            if FIRST not in self.numbers.newest:
                self.numbers.first(FIRST, self.published)
            self.numbers.newest[FIRST] = self.published


@pytest.fixture
def world(loop: VirtualLoop, make_context: Callable[..., Context]) -> World:
    graph, peer = NumberedGraph(), Peer()
    context = make_context(graph)
    made = World(half_of(Sender, context, Topic(SCAN, "transmit"), peer), graph, peer, context, loop)
    graph.publish(100, heard=False)
    reopen(made)
    graph.publish(3, heard=True)
    assert counts(made) == (0, 100)
    return made


def reopen(world: World) -> None:
    world.sender.route.open(1)
    world.sender.route.on_accepted()
    world.peer.answer(world.sender)


def passes(world: World, seconds: int) -> None:
    """Let time pass, with the tick of each second."""
    for _ in range(seconds):
        world.wait(1.0)
        world.sender.route.tick()


def counts(world: World) -> tuple[int, int]:
    """Return the route's `missed_while_down` and `unsubscribed`."""
    ledger = world.sender.facts.ledger
    return ledger.missed_while_down, ledger.unsubscribed

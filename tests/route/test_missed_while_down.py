"""Messages that were published while a route took none: why, as its ledger has them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.route.test_loop_filter import FIRST, SCAN, Graph, Peer, World
from tests.support.offline import half_of

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.reason import EndCode, Reason
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


def publish(world: World, count: int, *, heard: bool) -> None:
    assert isinstance(world.graph, NumberedGraph)
    world.graph.publish(count, heard=heard)


def test_messages_of_each_outage_are_missed(world: World) -> None:
    for total in (11, 22):
        world.sender.route.close("link lost")
        publish(world, 7, heard=False)
        reopen(world)
        publish(world, 4, heard=False)  # DDS has not matched it yet
        assert counts(world) == (total - 11, 100), "only a further message tells"
        publish(world, 2, heard=True)
        assert counts(world) == (total, 100)
    report = world.sender.news()
    assert report is not None
    assert (report.missed_while_down, report.unsubscribed) == (22, 100)


def test_early_break_of_data_connection_refuses_nothing(world: World) -> None:
    world.sender.route.channel_lost(Reason("Broken pipe", EndCode.BROKE))
    publish(world, 5, heard=False)
    reopen(world)
    publish(world, 1, heard=True)
    assert counts(world) == (5, 100)


def test_messages_of_refused_topic_are_not_missed(world: World) -> None:
    world.sender.route.refuse(EventCode.ROUTE_REFUSED, Reason("not allowed"))
    publish(world, 5, heard=False)
    reopen(world)
    publish(world, 1, heard=True)
    assert counts(world) == (0, 105)


@pytest.mark.parametrize("first", ["paused", "lost"])
def test_messages_of_paused_topic_are_not_missed(world: World, first: str) -> None:
    if first == "paused":
        world.sender.route.pausing.change(paused=True)
    world.sender.route.close("link lost")
    world.sender.route.pausing.change(paused=True)
    publish(world, 5, heard=False)
    world.sender.route.pausing.change(paused=False)
    reopen(world)
    publish(world, 1, heard=True)
    assert counts(world) == (0, 105)

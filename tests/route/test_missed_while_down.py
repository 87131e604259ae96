"""The number of messages published while a route is down is estimated, as a figure of its own that never decreases."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.route.test_loop_filter import FIRST, SCAN, Graph, Peer, World
from tests.support.offline import half_of

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.session import Topic
from rsb_bridge.route.outgoing import OutgoingRoute

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context


@pytest.fixture
def world(loop: VirtualLoop, make_context: Callable[..., Context]) -> World:
    graph, peer, topic = Graph(), Peer(), Topic(SCAN, "transmit", expected_rate=20.0)
    context = make_context(graph)
    made = World(half_of(OutgoingRoute, context, topic, peer), graph, peer, context, loop)
    reopen(made)
    passes(made, 2)
    return made


def reopen(world: World) -> None:
    world.route.open(1)
    world.route.on_accepted()
    world.peer.answer(world.route)


def passes(world: World, seconds: int) -> None:
    """Let time pass, with the tick of each second."""
    for _ in range(seconds):
        world.wait(1.0)
        world.route.tick()


def missed(world: World) -> int:
    return world.route.ledger().missed_while_down


def test_estimate_grows_while_down_then_stays(world: World) -> None:
    assert missed(world) == 0
    world.route.close("link lost")
    passes(world, 5)
    assert missed(world) == 100
    reopen(world)
    world.wait(0.5)
    world.comes(FIRST, *[b"x"] * 10)
    world.wait(0.5)
    world.route.tick()
    assert missed(world) == 110
    passes(world, 5)
    assert missed(world) == 110
    report = world.route.news()
    assert report is not None
    assert report.missed_while_down == 110
    world.route.close("link lost")
    passes(world, 1)
    assert missed(world) == 130


def test_early_break_of_data_connection_refuses_nothing(world: World) -> None:
    world.route.channel_lost(Reason("Broken pipe", EndCode.BROKE))
    world.route.close("link lost")
    passes(world, 5)
    assert missed(world) == 100


def test_nothing_is_missed_of_topic_that_is_refused(world: World) -> None:
    world.route.refuse(EventCode.ROUTE_REFUSED, Reason("not allowed"))
    passes(world, 5)
    assert missed(world) == 0


def test_nothing_is_missed_of_topic_that_nobody_publishes(world: World) -> None:
    publishers, world.graph.nodes = world.graph.nodes, {}
    world.route.advance()
    world.route.close("link lost")
    passes(world, 5)
    world.graph.nodes = publishers
    reopen(world)
    assert missed(world) == 0


def test_nothing_is_missed_once_the_publisher_is_gone(world: World) -> None:
    world.route.close("link lost")
    passes(world, 2)
    world.graph.nodes = {}
    passes(world, 5)
    assert missed(world) == 40


@pytest.mark.parametrize("first", ["paused", "lost"])
def test_nothing_is_missed_while_operator_has_paused_it(world: World, first: str) -> None:
    if first == "paused":
        world.route.pausing.change(paused=True)
    world.route.close("link lost")
    world.route.pausing.change(paused=True)
    passes(world, 5)
    assert missed(world) == 0


def test_a_limit_is_no_miss(world: World) -> None:
    world.route.limit.set_max_rate(5.0)
    passes(world, 1)
    world.route.close("link lost")
    passes(world, 2)
    assert missed(world) == 10

"""Messages that were published while a route took none: why, as its ledger has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.route.missed_while_down_helpers import NumberedGraph, counts, reopen, world
from tests.support.reports import told_counts

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.reason import EndCode, Reason

if TYPE_CHECKING:
    from tests.route.loop_filter_helpers import World

__all__ = ["world"]


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
    report = told_counts(world.sender)
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

"""A data connection that breaks while its link stays up: the topic waits for a while, and is down after that."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.route.missed_while_down_helpers import passes, reopen, world

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from tests.route.loop_filter_helpers import World

__all__ = ["world"]
TIMED_OUT = Reason("it has timed out", EndCode.TIMED_OUT)
WAITS, NO_PATH = (State.WAITING, Cause.AWAITS_LINK), (State.DOWN, Cause.NO_PATH)


def shown(world: World) -> tuple[State, str]:
    verdict = world.sender.route.verdict()
    return verdict.state, verdict.cause


def test_topic_waits_for_reopened_data_connection(world: World) -> None:
    for _ in range(2):
        world.sender.route.channel_lost(TIMED_OUT)
        assert shown(world) == WAITS
        passes(world, 9)
        assert shown(world) == WAITS
        passes(world, 2)
        assert shown(world) == NO_PATH
        reopen(world)
        world.sender.route.tick()
        assert world.sender.route.connected
        assert shown(world) not in (WAITS, NO_PATH)


def test_timed_out_attempts_do_not_extend_wait(world: World) -> None:
    for _ in range(3):
        world.sender.route.channel_lost(TIMED_OUT)
        passes(world, 4)
        world.sender.route.open(1)
        world.sender.route.on_accepted()
    world.sender.route.channel_lost(TIMED_OUT)
    assert shown(world) == NO_PATH


def test_the_other_side_shows_the_same(world: World) -> None:
    world.sender.route.refuse(EventCode.ROUTE_CLOSED, TIMED_OUT)
    assert shown(world) == WAITS


@pytest.mark.parametrize("reason", ["Connection refused", "too many open files"])
def test_failing_data_connection_is_fault_at_once(world: World, reason: str) -> None:
    world.sender.route.close("link lost")
    world.sender.route.open(1)
    world.sender.route.channel_lost(Reason(reason, EndCode.BROKE))
    assert shown(world) == NO_PATH

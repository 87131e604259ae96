"""Helpers of `test_arming` and others."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from tests.link.route_table_helpers import Pair, Side, hear_all, pair_of

from rsb_bridge.model.commands import acting
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.model.codes import EventCode
    from rsb_bridge.model.snapshot import Event
    from rsb_bridge.route.route import Route


DEADMAN = 30.0


COMMANDS = Topic("/cmd_vel", "receive", arm=True, deadman=DEADMAN)


CONSOLE = "anna's"


@pytest.fixture
def make_armable(make_context: Callable[..., Context]) -> Callable[..., Pair]:
    """Makes a robot, which is the client, and a control PC, with the topic between them."""

    def make(topic: Topic = COMMANDS) -> Pair:
        pair = robot, _ = pair_of(make_context(), make_context(role="server"))
        propose(robot, topic)
        hear_all(pair)
        return pair

    return make


@pytest.fixture
def pair(make_armable: Callable[..., Pair]) -> Pair:
    return make_armable()


def propose(side: Side, topic: Topic) -> None:
    side.proposed.add(topic)


def let_time_pass(pair: Pair, seconds: float) -> None:
    """Let the lease's numbers go to and fro, and then the tables tick."""
    hear_all(pair)
    loop = pair[0].context.loop
    until = loop.time() + seconds
    while loop.time() < until:
        sleep(pair[0], min(0.125, until - loop.time()))
        hear_all(pair)
    for side in pair:
        side.table.tick()


def route(side: Side) -> Route:
    (found,) = side.routes.values()
    return found


def arm(side: Side, *, console: str = CONSOLE, answered: bool = True) -> asyncio.Task[None]:
    async def ask() -> None:
        with acting("anna"):
            await side.table.arming.arm(route(side), console)

    task = side.context.loop.create_task(ask())
    turn(side)
    if answered:
        hear_all((side, side.other))
        turn(side)
    return task


def turn(side: Side) -> None:
    for _ in range(3):
        sleep(side, 0.0)


def sleep(side: Side, seconds: float) -> None:
    side.context.loop.run_until_complete(asyncio.sleep(seconds))


def events(side: Side, *codes: EventCode) -> list[Event]:
    return [event for event in side.context.events.after(0) if event.code in codes]

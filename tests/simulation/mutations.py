"""Mistakes put back on purpose, to show that the simulation finds them.

Some stood in the program until somebody looked (the first three), the others are of the kind that nobody sees in a
minute: something that is never cleared, closed, or told.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest.mock import patch

import msgspec
from tests.simulation.climate import LIVELY, STILL, STORM, Climate
from tests.simulation.episodes import restarted_while_cut, server_away, type_differs_for

from rsb_bridge.channel.stream import StreamReceiver, StreamSender
from rsb_bridge.channel.udp_channel import UdpChannel
from rsb_bridge.link.keepalive import Keepalive
from rsb_bridge.link.route_table import RouteTable
from rsb_bridge.model.backoff import Backoff
from rsb_bridge.route.incoming import IncomingRoute
from rsb_bridge.route.ledger import RouteLedger
from rsb_bridge.route.send_queue import SendQueue
from rsb_bridge.tasks import Tasks

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from tests.simulation.world import World


class Mutation(NamedTuple):
    """A mistake, and the worlds that find it.

    Attributes:
        what: it is.
        patches: that make it.
        climate: of the worlds.
        hours: that each world lives, at most.
        doing: what is made to happen in them.
        finds: part of what is found.
    """

    what: str
    patches: tuple[Any, ...]
    climate: Climate
    hours: float
    finds: str
    doing: Callable[[World], Coroutine[None, None, None]] | None = None

    @contextlib.contextmanager
    def made(self) -> Iterator[None]:
        """Have the mistake in the program."""
        with contextlib.ExitStack() as stack:
            for each in self.patches:
                stack.enter_context(each)
            yield


def _overflowing(self: Any, at_most: float = float("inf")) -> float:
    """As `Backoff.next` was: from the 1,025th attempt on it raises OverflowError."""
    self.attempts = getattr(self, "attempts", 0) + 1
    delay: float = min(at_most, self._longest, 0.5 * 2 ** (self.attempts - 1))
    return delay


def _unsupervised(self: Any, make: Callable[[], Coroutine[None, None, None]], _: Backoff) -> None:
    """As tasks were: they ended, and nobody looked."""
    self.kept = [*getattr(self, "kept", []), self._loop.create_task(make())]


def _settled_by_id(self: Any, final: Any, _: str) -> bool:
    """As `RouteLedger.settle` was: the report of whatever process has the same route id."""
    opening = self._unsettled
    if opening is not None and final is not None and final.route == opening.route_id:
        opening.instance = _
    return bool(_settle(self, final, _))


def _counted_before(self: Any) -> Any:
    """As the receiver's last count was: told to whatever process asks."""
    return self._before[1] if self._before is not None else None


_settle = RouteLedger.settle
_propose = RouteTable._propose


def _nothing(*_: object, **__: object) -> None:
    """What was forgotten."""


def _kept(self: Any, work: Coroutine[None, None, None]) -> Any:
    """As `Tasks._add`, without taking out what has ended."""
    task = self._loop.create_task(work)
    self._tasks.add(task)
    return task


async def _unpaused(self: Any, route: Any, route_id: int) -> None:
    """As `RouteTable._propose`, but never paused."""
    send = self._owner.send

    def unpaused(message: Any) -> None:
        send(msgspec.structs.replace(message, paused=False, pause_revision=0))

    with patch.object(self._owner, "send", unpaused):
        await _propose(self, route, route_id)


MUTATIONS = (
    Mutation(
        "the delay between two calls overflows, and the task that calls dies unseen",
        (patch.object(Backoff, "next", _overflowing), patch.object(Tasks, "keep", _unsupervised)),
        climate=STILL,
        hours=1.0,
        doing=lambda world: server_away(world, 1800.0, machine=False),
        finds="has died of OverflowError",
    ),
    Mutation(
        "the delay between two calls overflows, and the task that calls is started again",
        (patch.object(Backoff, "next", _overflowing),),
        climate=STILL,
        hours=1.0,
        doing=lambda world: server_away(world, 1800.0, machine=False),
        finds="nobody caught OverflowError",
    ),
    Mutation(
        "a count is taken from whatever process has the same route id",
        (
            patch.object(RouteLedger, "settle", _settled_by_id),
            patch.object(IncomingRoute, "_counted_before", _counted_before),
        ),
        climate=replace(STILL, topics=(4,), periods=(1.0, 4.0), checks=(1.0, 2.0)),
        hours=4.0,
        doing=restarted_while_cut,
        finds="the ledger of",
    ),
    Mutation(
        "the ids of routes that were closed are never forgotten",
        (patch.object(RouteTable, "closed", _nothing),),
        climate=STILL,
        hours=3.0,
        doing=lambda world: type_differs_for(world, 3 * 3600.0),
        finds="_by_id",
    ),
    Mutation(
        "tasks that have ended are kept",
        (patch.object(Tasks, "_add", _kept),),
        climate=STILL,
        hours=3.0,
        doing=lambda world: type_differs_for(world, 3 * 3600.0),
        finds="_tasks",
    ),
    Mutation(
        "a stream is not closed with its channel",
        (patch.object(StreamSender, "close", _nothing), patch.object(StreamReceiver, "close", _nothing)),
        climate=STORM,
        hours=2.0,
        finds="left open",
    ),
    Mutation(
        "what waits to be sent is not cleared when the channel is lost",
        (patch.object(SendQueue, "clear", SendQueue.__len__),),
        climate=STORM,
        hours=4.0,
        finds="a part of it is negative",
    ),
    Mutation(
        "a new connection is not told what is paused",
        (patch.object(RouteTable, "_propose", _unpaused),),
        climate=LIVELY,
        hours=4.0,
        finds="disagree",
    ),
    Mutation(
        "a silent peer is not given up",
        (patch.object(Keepalive, "watch", _nothing),),
        climate=STORM,
        hours=2.0,
        finds="seems linked",
    ),
    Mutation(
        "UDP sockets of links that are down are not closed",
        (patch.object(UdpChannel, "close", _nothing),),
        climate=STORM,
        hours=2.0,
        finds="left open",
    ),
)

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
from rsb_bridge.route.both_sides import BothSides
from rsb_bridge.route.incoming import IncomingRoute
from rsb_bridge.route.ledger import RouteLedger
from rsb_bridge.route.send_queue import SendQueue
from rsb_bridge.tasks import Tasks

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from tests.simulation.world import World


class Mutation(NamedTuple):
    """A mistake, and the world that finds it.

    Attributes:
        what: it is.
        changes: what is put in the place of which attribute of which class.
        finds: part of the violation, a regular expression.
        climate: of the world.
        seed: of the world.
        hours: that the world lives, at most.
        doing: what is made to happen in it.
    """

    what: str
    changes: tuple[tuple[type, str, object], ...]
    finds: str
    climate: Climate
    seed: int
    hours: float
    doing: Callable[[World], Coroutine[None, None, None]] | None = None

    @contextlib.contextmanager
    def made(self) -> Iterator[None]:
        """Have the mistake in the program."""
        with contextlib.ExitStack() as stack:
            for owner, name, mistake in self.changes:
                stack.enter_context(patch.object(owner, name, mistake))
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


def _away(world: World) -> Coroutine[None, None, None]:
    return server_away(world, 1800.0, machine=False)


def _differs(world: World) -> Coroutine[None, None, None]:
    return type_differs_for(world, 3 * 3600.0)


_MANY = replace(STILL, topics=(4,), periods=(1.0, 4.0), checks=(1.0, 2.0))

_SILENT = replace(STILL, topics=(4,), periods=(1e9, 1e9))

# fmt: off
MUTATIONS = (
    Mutation(
        "the delay between two calls overflows, and the task that calls dies unseen",
        ((Backoff, "next", _overflowing), (Tasks, "keep", _unsupervised)),
        "has died of OverflowError", STILL, 1, 1.0, _away,
    ),
    Mutation(
        "the delay between two calls overflows, and the task that calls is started again",
        ((Backoff, "next", _overflowing),),
        "nobody caught OverflowError", STILL, 1, 1.0, _away,
    ),
    Mutation(
        "a count is taken from whatever process has the same route id",
        ((RouteLedger, "settle", _settled_by_id), (IncomingRoute, "_counted_before", _counted_before)),
        "the ledger of", _MANY, 1, 4.0, restarted_while_cut,
    ),
    Mutation(
        "the ids of routes that were closed are never forgotten",
        ((RouteTable, "closed", _nothing),),
        "_by_id", STILL, 1, 3.0, _differs,
    ),
    Mutation(
        "tasks that have ended are kept",
        ((Tasks, "_add", _kept),),
        "_tasks", STILL, 1, 3.0, _differs,
    ),
    Mutation(
        "a stream is not closed with its channel",
        ((StreamSender, "close", _nothing), (StreamReceiver, "close", _nothing)),
        "left open", STORM, 2, 2.0,
    ),
    Mutation(
        "what waits to be sent is not cleared when the channel is lost",
        ((SendQueue, "clear", SendQueue.__len__),),
        "a part of it is negative", STORM, 2, 1.0,
    ),
    Mutation(
        "a new connection is not told what is paused",
        ((RouteTable, "_propose", _unpaused),),
        "disagree|do not agree", LIVELY, 5, 1.0,
    ),
    Mutation(
        "a silent peer is not given up",
        ((Keepalive, "watch", _nothing),),
        "seems linked", STORM, 2, 1.0,
    ),
    Mutation(
        "UDP sockets of links that are down are not closed",
        ((UdpChannel, "close", _nothing),),
        "left open", STORM, 2, 2.0,
    ),
    Mutation(
        "what the other side makes of a topic is not taken in",
        ((BothSides, "take", _nothing),),
        "do not agree on", _SILENT, 1, 0.5,
    ),
)
# fmt: on

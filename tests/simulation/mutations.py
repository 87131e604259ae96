"""Mistakes put back on purpose, to show that the simulation finds them.

The first three are old defects of the program. The others need hours to show: something is never cleared, closed or
reported.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest.mock import patch

import msgspec
from tests.simulation.conditions import ACTIONS, CALLS, KEEPING, LIVELY, STILL, STORM, Conditions
from tests.simulation.episodes import (
    connections_reset,
    delayed,
    paused_while_away,
    reopened,
    restarted_while_cut,
    server_away,
    tunnelled,
    type_differs_for,
)
from tests.support import replaced

from rsb_bridge.channel.data_stream import DataStream, StreamSender
from rsb_bridge.channel.datagram_channel import DatagramEnd
from rsb_bridge.channel.reliable_datagrams import ReliableSender
from rsb_bridge.channel.udp_channel import ClientUdpChannel
from rsb_bridge.channel.window import Window
from rsb_bridge.link.association import Association
from rsb_bridge.link.keepalive import Keepalive
from rsb_bridge.link.route_ids import RouteIds
from rsb_bridge.link.route_openings import RouteOpenings
from rsb_bridge.model.budgets import Backoff
from rsb_bridge.ros.publication_numbers import PublicationNumbers
from rsb_bridge.route.calls.action_goals import CallerGoals
from rsb_bridge.route.calls.asked_calls import AskedCalls
from rsb_bridge.route.calls.calls_ledger import CallFailures
from rsb_bridge.route.calls.pending_calls import PendingCalls
from rsb_bridge.route.calls.service_offer import ServiceOffer
from rsb_bridge.route.combined_verdict import CombinedVerdict
from rsb_bridge.route.lateness import LateWatch
from rsb_bridge.route.ledger import OUTAGE, RouteLedger
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sending import Outbox, SendQueue
from rsb_bridge.tasks import Tasks
from rsb_bridge.wire.datagram import OrderedReader
from rsb_bridge.wire.framing import DataReader, DataWriter
from rsb_bridge.wire.messages import Report

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from tests.simulation.world import World

    from rsb_bridge.wire.framing import Message


class Mutation(NamedTuple):
    """A mistake, and the world that finds it.

    Attributes:
        changes: what is put in the place of which attribute of which class or module.
        finds: part of the violation, a regular expression.
    """

    what: str
    changes: tuple[tuple[object, str, object], ...]
    finds: str
    conditions: Conditions
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
    self.attempts = getattr(self, "attempts", 0) + 1
    delay: float = min(at_most, self._longest, 0.5 * 2 ** (self.attempts - 1))
    return delay


def _unsupervised(self: Any, make: Callable[[], Coroutine[None, None, None]], _: Backoff) -> None:
    """Replace the supervision of tasks: nobody notices that one fails."""
    self.kept = [*getattr(self, "kept", []), self._loop.create_task(make())]


def _settled_by_id(self: Any, final: Any, _: str) -> bool:
    """Replace `RouteLedger.settle` by its old form, which trusts any process with the same route id."""
    opening = self._unsettled
    if opening is not None and final is not None and final.route == opening.route_id:
        opening.instance = _
    return bool(_settle(self, final, _))


def _settled_as_lost(self: Any, final: Any, instance: str) -> bool:
    """Replace `RouteLedger.settle` by its old form, which counts unconfirmed messages of an ended process as lost."""
    before = self.unknown
    plausible = bool(_settle(self, final, instance))
    self.drop("link lost", self.unknown - before)
    self.unknown = before
    return plausible


def _settled_as_unknown(self: Any, final: Any, _: str) -> bool:
    """Replace `RouteLedger.settle` by a form that trusts no process."""
    return bool(_settle(self, final, "another"))


def _counted_before(self: Any) -> Any:
    """Replace the receiver's last count by its old form, which any process gets."""
    return self._before[1] if self._before is not None else None


def _end_oldest(self: Any, number: int) -> Any:
    """Replace `PendingCalls.end` by a form that ends the oldest call."""
    return _end(self, next(iter(self._calls), number))


async def _tunnel(world: World) -> None:
    await tunnelled(world, 120.0)


async def _delay(world: World) -> None:
    await delayed(world, 60.0)


def _took_in_time(self: Any, *receipt: float) -> None:
    """Replace `Window.acknowledge` by a form that takes everything in flight for new."""
    self._marks.clear()
    _took(self, *receipt)  # type: ignore[arg-type]


def _end_for_nothing(self: Any, number: int) -> Any:
    """Replace `PendingCalls.end` by a form that keeps the call's part of the budget."""
    return self._calls.pop(number, None)


_drop = RouteLedger.drop
_end = PendingCalls.end
_open_resumed = DataReader.open_resumed
_resume = Association.resume
_unacknowledged = DataStream.unacknowledged
_write_resumed = DataWriter.write_resumed
_settle = RouteLedger.settle
_took = Window.acknowledge
_propose = replaced.PROPOSE_ROUTE.value


def _no_limit(self: Any, name: str) -> Any:
    """Replace the look-up of a `Window`'s attributes by a form that has it without a limit."""
    return 1 << 60 if name == "limit" else object.__getattribute__(self, name)


def _remember_nothing(self: Any, frame: Any) -> None:
    """Replace `DataReader.open_resumed` by one that takes for new what comes next."""
    _open_resumed(self, frame)
    self._known = 0


def _anybodys(_: Any, __: Any) -> bool:
    """Replace what an `Association` asks of a process by a form that takes any for the other end of the association."""
    return True


def _skip_one(self: Any, frame: Any) -> None:
    """Replace `DataReader.open_resumed` by one that takes a further message for known."""
    _open_resumed(self, frame)
    self._known += 1


def _outage_delivers(self: Any, cause: str, count: int) -> None:
    """Replace `RouteLedger.drop` by one that counts what an outage drops as delivered."""
    if cause == OUTAGE:
        self._delivered += count
    else:
        _drop(self, cause, count)


def _nothing_before(_: object, __: bytes, number: int) -> int:
    """Replace `PublicationNumbers.first` by one that counts nothing."""
    return number - 1


def _newest_is_left_out(self: Any, *connection: Any) -> Any:
    """Replace `Association.resume` by one that leaves out the newest message but reports."""
    again = _resume(self, *connection)
    newest = next((each for each in reversed(again) if not isinstance(each, Report)), None)
    return tuple(each for each in again if each is not newest)


def _newest_is_doubled(self: Any, *connection: Any) -> Any:
    """Replace `Association.resume` by one that sends the newest message twice."""
    again = _resume(self, *connection)
    return (*again, *again[-1:])


def _resumed_too_far(self: Any, again: int = 0) -> Any:
    """Replace `DataWriter.write_resumed` by a form that skips a number."""
    self.messages += 1
    return _write_resumed(self, again)


def _without_oldest(self: Any) -> Iterator[Any]:
    """Replace `DataStream.unacknowledged` by a form that drops the oldest message."""
    found = _unacknowledged(self)
    next(found, None)
    return found


def _drop_half(self: Any, _: float) -> None:
    """Replace `Outbox.resume` by one that takes the older half for too old."""
    self._ledger.drop("outage", len(self.queue.take(len(self) // 2, 1 << 30)))


def _none(_: Any) -> Iterator[Any]:
    return iter(())


def nothing(*_: object, **__: object) -> None:
    """Do nothing, in place of the work that a mutation leaves out."""


def _kept(self: Any, work: Coroutine[None, None, None]) -> Any:
    """Replace `Tasks._add` by a form that keeps ended tasks."""
    task = self._loop.create_task(work)
    self._tasks.add(task)
    return task


async def _unpaused(self: Any, route: Any, route_id: int, who: str) -> None:
    """Replace `RouteOpenings._propose` by a form that never pauses the route."""
    send = self._link.send

    def unpaused(message: Any) -> None:
        send(msgspec.structs.replace(message, paused=False, pause_revision=0))

    with patch.object(self._link, "send", unpaused):
        await _propose(self, route, route_id, who)


def _away(world: World) -> Coroutine[None, None, None]:
    return server_away(world, 1800.0, machine=False)


def _differs(world: World) -> Coroutine[None, None, None]:
    return type_differs_for(world, 3 * 3600.0)


_MANY = replace(STILL, topics=(4,), periods=(1.0, 4.0), checks=(1.0, 2.0))

_SILENT = replace(STILL, topics=(4,), periods=(1e9, 1e9))


def _never(*_: Any) -> bool:
    return False


def _at_once(self: OrderedReader, number: int, message: Message) -> Message | None:
    return message


_OUTLIVES = replace(LIVELY, outlive=60.0)
_ONE = replace(_OUTLIVES, robots=(1,), faults=0.0, commands=0.0, nights=0.0)
_MOVES = replace(_OUTLIVES, moves=120.0)
_ASKS_ONCE = replace(ACTIONS, actions=(1,), periods=(10.0, 10.0), faults=0.0)
_WATCHED = replace(STILL, checks=(1.0, 1.0))

# fmt: off
MUTATIONS = (
    Mutation("the delay between two calls overflows, and the task that calls dies unseen",
             ((Backoff, "next", _overflowing), (Tasks, "keep", _unsupervised)),
             "has died, .*OverflowError", STILL, 1, 1.0, _away),
    Mutation("the delay between two calls overflows, and the task that calls is started again",
             ((Backoff, "next", _overflowing),), "nobody caught OverflowError", STILL, 1, 1.0, _away),
    Mutation("a count is taken from any process with the same route id",
             ((RouteLedger, "settle", _settled_by_id), (Receiver, "_counted_before", _counted_before)),
             "the ledger of", _MANY, 1, 4.0, restarted_while_cut),
    Mutation("what a process that was killed did not confirm is taken for lost",
             ((RouteLedger, "settle", _settled_as_lost),),
             "some of them are counted as lost", _MANY, 1, 4.0, restarted_while_cut),
    Mutation("unconfirmed messages are unknown, though their receiver reports its count",
             ((RouteLedger, "settle", _settled_as_unknown),), "the engine that published it still runs", STORM, 2, 2.0),
    Mutation("the ids of routes that were closed are never forgotten",
             ((RouteIds, "closed", nothing),), "_by_id", STILL, 1, 3.0, _differs),
    Mutation("tasks that have ended are kept",
             ((Tasks, "_add", _kept),), "_tasks", STILL, 1, 3.0, _differs),
    Mutation("a stream is not closed with its link",
             ((DataStream, "end", nothing),), "left open", STORM, 2, 2.0),
    Mutation("a route does not resume on the stream in place of a lost one",
             ((StreamSender, "resume", nothing),), "something is in flight", LIVELY, 1, 0.1, connections_reset),
    Mutation("what waits to be sent is not cleared when the channel is lost",
             ((SendQueue, "clear", SendQueue.__len__),), "a part of it is negative", STORM, 2, 1.0),
    Mutation("a new connection is not told what is paused",
             ((RouteOpenings, "_propose", _unpaused),), "disagree|do not agree", LIVELY, 5, 1.0),
    Mutation("a silent peer is not given up",
             ((Keepalive, "_watch_silence", nothing),), "seems linked", STORM, 4, 1.0),
    Mutation("UDP sockets of links that are down are not closed",
             ((ClientUdpChannel, "close", nothing),), "left open", STORM, 3, 2.0),
    Mutation("what the other side makes of a topic is not taken in",
             ((CombinedVerdict, "receive", nothing),), "do not agree on", _SILENT, 1, 0.5),
    Mutation("a link takes as much as its buffers hold",
             ((Window, "__getattribute__", _no_limit),), "s after it was published", STILL, 1, 0.05, _tunnel),
    Mutation("receipts that are late leave the window as it is",
             ((Window, "acknowledge", _took_in_time),), "s after it was published", STILL, 1, 0.05, _tunnel),
    Mutation("messages that are late are taken for ok",
             ((LateWatch, "judge", nothing),), "shows it as ok", _WATCHED, 1, 0.05, _delay),
    Mutation("an answer goes to the first caller",
             ((PendingCalls, "end", _end_oldest),), "got for call", CALLS, 1, 1.0),
    Mutation("a call that is over keeps its place in the budget",
             ((PendingCalls, "end", _end_for_nothing),), "calls are in flight, and", CALLS, 1, 1.0),
    Mutation("a service is still offered when the link is down",
             ((ServiceOffer, "withdraw", nothing),), "without a link|and the link is down", CALLS, 1, 1.0),
    Mutation("calls that are lost are not counted",
             ((CallFailures, "lost", nothing),),
             "calls (are )?in flight, and", replace(ACTIONS, faults=20.0), 3, 0.2),
    Mutation("a request for a result ends with its opening",
             ((CallerGoals, "repeats", _never),), "waits for its result", _ASKS_ONCE, 1, 0.2, reopened),
    Mutation("a cancel or a request for a result is not sent again",
             ((AskedCalls, "send_again", nothing),), "waits for its result", _ASKS_ONCE, 1, 0.2, reopened),
    Mutation("what is sent again comes again",
             ((DataReader, "open_resumed", _remember_nothing),), "came out twice", _OUTLIVES, 1, 0.5),
    Mutation("messages on a lost stream are not sent again",
             ((DataStream, "unacknowledged", _none),), "messages with a stream", _OUTLIVES, 1, 0.5),
    Mutation("a message that never came is taken for one that did",
             ((DataReader, "open_resumed", _skip_one),), "something is in flight", _OUTLIVES, 2, 0.5),
    Mutation("what an outage drops counts as delivered",
             ((RouteLedger, "drop", _outage_delivers),), "messages were published: ", _OUTLIVES, 2, 0.5),
    Mutation("messages published without a subscription are not counted",
             ((PublicationNumbers, "first", _nothing_before),), "up to the newest", _OUTLIVES, 2, 0.5),
    Mutation("a control message is not sent again",
             ((Association, "resume", _newest_is_left_out),), "disagree on which", _ONE, 1, 0.1, paused_while_away),
    Mutation("a control message is sent twice",
             ((Association, "resume", _newest_is_doubled),), "broke the format", _ONE, 1, 0.1, paused_while_away),
    Mutation("a number is skipped when messages are sent again",
             ((DataWriter, "write_resumed", _resumed_too_far),), "messages with a stream", _MOVES, 1, 0.5),
    Mutation("the oldest message is not sent again",
             ((DataStream, "unacknowledged", _without_oldest),), "messages with a stream", _MOVES, 1, 0.5),
    Mutation("what is kept for a link is dropped as QoS allows",
             ((Outbox, "compose", nothing),), "was to be kept", KEEPING, 1, 0.5),
    Mutation("kept messages are dropped when the link is back",
             ((Outbox, "resume", _drop_half),), "was to be kept", KEEPING, 1, 0.5),
    Mutation("handled control messages are not counted",
             ((Association, "handles", nothing),), "broke the format", _OUTLIVES, 1, 0.5),
    Mutation("routes over datagrams stay with the last connection",
             ((DatagramEnd, "resume", nothing),), "nobody caught", _OUTLIVES, 3, 0.2),
    Mutation("lost datagrams are not sent again",
             ((ReliableSender, "_lost", nothing),), "could flow", _OUTLIVES, 3, 0.2),
    Mutation("a datagram that is sent again comes again",
             ((OrderedReader, "_has", _never),), "came out twice", _OUTLIVES, 3, 0.2),
    Mutation("messages overtake a lost one",
             ((OrderedReader, "_whole", _at_once),), "came out", _OUTLIVES, 3, 0.2),
    Mutation("an association is resumed with another process",
             ((Association, "may_resume", _anybodys), (Association, "resumes", _anybodys),
              (Association, "acknowledge", nothing)),
             "nobody caught|broke the format", _OUTLIVES, 1, 0.5),
)
# fmt: on

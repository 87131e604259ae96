"""Decides whether a link is full: its scheduler never empties, and less arrives than is asked for.

The scheduler is `rsb_bridge.channel.scheduler`. Where a tunnel, a kernel or a radio accepts more than it carries, its
window has messages wait in it all the same. So no other sign is needed, neither pings that take longer nor datagrams
that get lost. Three things explain the same: a path that loses packets, a window that still grows, and a benchmark.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.link.extension import Extension
from rsb_bridge.model.capacity import Fullness
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.route.sender import Sender
from rsb_bridge.telemetry.meters import Throughput
from rsb_bridge.wire.records import FullRecord

if TYPE_CHECKING:
    from collections.abc import Collection

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.path_watch import PathWatch

# Ticks, one a second. Round figures.
_TICKS = 4  # that have to agree before a link counts as full, or as no longer full
_STALLS = 2  # without a byte that are a stall: a full link still carries some, and one receipt may be late
_AFTER_STALL = 6  # after a stall in which the arriving bytes say nothing about the link's capacity
_AVERAGED_OVER = 6  # over which bytes are averaged, so that a map each few seconds is no demand that comes and goes

# Share of the asked bytes: a link that carries that much is not full. The rest is what the two figures may differ by,
# since asked messages are counted as they come, and arriving bytes as they are. Nothing was measured.
_CARRIED_SHARE = 0.95
_NEVER_EMPTY = 1.0  # s for which something has waited all the time on a full link: a round figure
_NAMED = 3  # topics that the warning names
_FASTEST = 1e12  # bytes/s: a peer may report any figure


class Asked(NamedTuple):
    """Demand of one topic."""

    topic: str  # its name on this side
    remote_topic: str  # its name on the other side
    bytes_per_second: float  # that it asks the link to carry


class LinkFullness(Extension):
    """Whether a link is full: this side judges its own direction, and the peer reports the other."""

    def __init__(self, link: BaseLink, path: PathWatch) -> None:
        self._link = link
        self._path = path
        self.sending, self.receiving = Throughput(), Throughput()  # measure the capacities from here, and to here
        self._begin()

    def _begin(self) -> None:
        self.out: Fullness | None = None  # the rates from here, or None if the link is not full
        self.into: Fullness | None = None  # the same to here, as the peer reports them
        self._arrived = self._received = 0  # bytes so far
        self._other = 0  # ticks in a row that contradict `out`
        self._stalled = 0  # ticks for which the last stall explains the arriving bytes
        self._silent = 0  # ticks in which nothing has arrived of what is asked for
        self._ticks: deque[tuple[float, float]] = deque(maxlen=_AVERAGED_OVER)  # bytes asked for, and arrived
        self._sent = self._record = FullRecord()

    def disconnected(self) -> None:
        self._begin()  # the next connection may go another way
        self.sending.disconnected()
        self.receiving.disconnected()

    suspend = disconnected

    def tick(self) -> None:
        link = self._link
        if not link.linked:
            return
        scheduler, now, at = link.channels.scheduler, link.context.now(), link.context.wall()
        asked: list[Asked] = []
        called = 0.0
        moving = scheduler.moving()
        for route in link.awake:
            if route.duplex:
                called += route.meter.bytes_per_second
            elif isinstance(route.half, Sender) and route.half.carried.channel is not None and route.connected:
                rate = route.half.path.traffic.measure(now)
                # What waits for a path that takes nothing says nothing about the others.
                if rate and route.half.carried.channel.via in moving:
                    asked.append(Asked(route.topic, route.remote_topic, rate))
        arrived, self._arrived = scheduler.arrived - self._arrived, scheduler.arrived
        full = scheduler.waits_for(now) >= _NEVER_EMPTY
        self.sending.measure(arrived, now, at, full=full)
        before = self.out
        overloaded = (
            full
            and not self._path.loss.lossy  # which explains why less arrives than is asked for
            and not scheduler.held_by_growing_window  # what waits behind it says nothing about the link
            and not any(route.purpose.fills_link for route in link.routes.values())  # a benchmark does so on purpose
        )
        self.judge(asked, max(0.0, arrived - called), full=overloaded)
        received = sum([each.received_bytes for each in link.carriers()])
        self.receiving.measure(received - self._received, now, at, full=False)
        self._received = received
        if self.out != before:
            self._judge_again(outgoing=True)

    def _judge_again(self, *, outgoing: bool) -> None:
        """Judge the routes of one direction again, so that their verdicts agree with the link's."""
        for route in tuple(self._link.routes.values()):
            if route.outgoing == outgoing:
                route.judge_again()

    def judge(self, topics: Collection[Asked], arrived: float, *, full: bool) -> None:
        """Judge the direction from here, once a second.

        Args:
            topics: those that have something to send.
            arrived: bytes since the last tick.
            full: whether messages have waited all the time.
        """
        asked = sum([each.bytes_per_second for each in topics])
        was = self.out is not None
        self._stalled = max(0, self._stalled - 1)
        self._silent = self._silent + 1 if asked and not arrived else 0
        if self._silent == _STALLS:
            self._stalled, self._other = _AFTER_STALL, 0
        if self._silent and (was or not self._other):
            return  # a gap does not show how much the link carries: its last figures stay
        self._ticks.append((asked, arrived))
        asks = asked > 0.0  # if not, all that waits does so for a path that takes nothing
        asked, carried = (sum(each) / len(self._ticks) for each in zip(*self._ticks, strict=True))
        carries_all = carried >= _CARRIED_SHARE * asked
        over = full and asks and carried > 0.0 and not carries_all and (was or not self._stalled)
        self._other = self._other + 1 if over != was else 0
        if (was and carries_all) or self._other >= _TICKS:
            self._other = 0  # the decision is made: the next one takes as many ticks again
            was = not was
            if not was:
                self.out = None
                self._log(Level.INFO, EventCode.LINK_ROOM, f"the link to {self._link.peer_name} is no longer full")
        if not was:
            self.out, self._record = None, FullRecord()
            return
        most = sorted(topics, key=lambda each: -each.bytes_per_second)[:_NAMED]
        figures = min(carried, asked), asked  # what has arrived may have been asked for before
        begins = self.out is None
        self.out = Fullness(*figures, tuple(each.topic for each in most))
        names = tuple(sanitize_text(each.remote_topic, TEXT_LENGTH) for each in most)
        self._record = FullRecord(round(figures[0]), round(figures[1]), names)
        if begins:
            self._log(Level.WARNING, EventCode.LINK_FULL, self.out.warning(f"to {self._link.peer_name}"))

    @property
    def undecided(self) -> bool:
        """Whether the link from here may be full, which is being measured."""
        return self.out is None and self._other > 0

    def next_record(self) -> FullRecord | None:
        """Return the record for the peer, or None if it has not changed since the last one."""
        if self._record == self._sent:
            return None
        self._sent = self._record
        return self._record

    def take_record(self, record: FullRecord) -> None:
        """Take the peer's record of what it sends; impossible figures are limited."""
        before, self.into = self.into, None
        peer = self._link.peer_name
        if record.asked:
            asked = _within(record.asked)
            self.into = Fullness(min(_within(record.carried), asked), asked, record.topics[:_NAMED])
            if before is None:
                self._log(Level.WARNING, EventCode.LINK_FULL, self.into.warning(f"from {peer}"))
        elif before is not None:
            self._log(Level.INFO, EventCode.LINK_ROOM, f"the link from {peer} is no longer full")
        self._judge_again(outgoing=False)

    def _log(self, level: Level, code: EventCode, text: str) -> None:
        self._link.log(level, code, text, link_status=True)

    @property
    def warning(self) -> str:
        """The warning for an operator, or an empty string."""
        peer = self._link.peer_name
        ways = (self.out, f"to {peer}"), (self.into, f"from {peer}")
        return "; ".join(full.warning(way) for full, way in ways if full is not None)


def _within(figure: float) -> float:
    return max(0.0, min(figure, _FASTEST)) if math.isfinite(figure) else 0.0

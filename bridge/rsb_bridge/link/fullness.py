"""Decides whether a link is full. `rsb_bridge.channel.scheduler` shares it.

Once a second it checks for overload: messages that waited for half a second, messages dropped from a full queue, or
pings delayed by a queue on the path.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.capacity import Fullness
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.route.outgoing import OutgoingRoute
from rsb_bridge.telemetry.meters import Throughput
from rsb_bridge.wire.records import FullRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from rsb_bridge.channel.channel import SendingChannel
    from rsb_bridge.context import Context
    from rsb_bridge.link.data_channels import ChannelCarrier
    from rsb_bridge.link.keepalive import Keepalive
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.traffic import Traffic

_BEGINS, _ENDS = 4, 4
"""Ticks that have to agree before a link counts as full, or as no longer full."""
_WINDOW = 3
"""Ticks over which the arriving bytes are averaged: fewer than `_BEGINS`, so that a stall is no full link."""
_OVERLOAD = 1.15
"""A full link is asked for more than so many times the arriving bytes. A round figure: nothing was measured."""
_CARRIED_SHARE = 0.95
"""Share of the asked bytes: a link that carries that much is not full, however short a time it does."""
_FULL_BELOW_SHARE = 0.6
"""Share of the asked bytes: if less arrives on average, the link is full even if the last tick brought more."""
_AFTER_STALL = 6
"""Ticks after a stall in which the arriving bytes say nothing about the link's capacity. A round figure."""
_SHOWN_OVER = 6
"""Ticks over which the shown figure of the arriving bytes is averaged: a report may be a second late."""
_NAMED = 3
"""Topics that the warning names."""
_FASTEST = 1e12
"""bytes/s: a peer may report any figure."""
_BUSY = 0.5
"""s for which a channel has not been idle."""
_PING_RISE = 0.2
"""s that two pings one after the other take longer than the shortest one: one alone may be the radio's."""
_MOSTLY_LOST_SHARE, _MOSTLY_LOST_RATE = 0.35, 50e3
"""The share of datagrams that arrive, and bytes/s of a topic, from which a link is full rather than poor, even if its
queue is too short to hold anything up. Nothing was measured."""
_OVERFLOW_SHARE, _OVERFLOW_DELAY = 0.95, 0.2
"""The share of datagrams that arrive, and s that they take longer than before, if they pass through a queue that
overflows; a poor radio loses datagrams without holding up the others."""
_DELAYED = 1.0
"""s of delay from which messages wait on the way, as by the default of `late_after`."""
_OWN_OVERLOAD = 1.1
"""Times what arrives. If less is asked for, the link carries it, and somebody else's traffic causes the delay."""
_SHORTEST_PINGS = 60
"""Pings, one a second, of which the shortest met no queue. A round figure."""


class Asked(NamedTuple):
    """Demand of one topic.

    Attributes:
        topic: its name on this side.
        remote_topic: its name on the other side.
        bytes_per_second: that it asks the link to carry.
    """

    topic: str
    remote_topic: str
    bytes_per_second: float


class LinkFullness:
    """Whether a link is full: this side judges its own direction, and the peer reports the other.

    Attributes:
        out: the rates from here, or None if the link is not full.
        into: the rates to here, as the peer reports them, or None if the link is not full.
    """

    def __init__(self, log: Callable[[Level, EventCode, str], None]) -> None:
        self.out: Fullness | None = None
        self.into: Fullness | None = None
        self._log = log
        self._other = 0
        self._stalled = 0  # ticks for which the last stall explains the arriving bytes
        self._flowed = False
        self._arrived: deque[float] = deque(maxlen=_WINDOW)
        self._lately: deque[float] = deque(maxlen=_SHOWN_OVER)  # since it seems full
        self._sent = FullRecord()
        self._record = FullRecord()

    def judge(self, topics: Collection[Asked], arrived: float, *, full: bool, peer: str) -> None:
        """Judge the direction from here. Called once a second.

        Args:
            topics: that have something to send.
            arrived: bytes since the last tick.
            full: whether messages wait to be sent all the time, or are late.
        """
        asked = sum(each.bytes_per_second for each in topics)
        self._arrived.append(arrived)
        carried = sum(self._arrived) / len(self._arrived)
        # After a stall, one tick brings less than is asked for, and the next ones bring all of it.
        too_little = asked > _OVERLOAD * arrived or carried < _FULL_BELOW_SHARE * asked
        self._stalled = max(0, self._stalled - 1)
        # If nothing arrives any more of what is asked for, the link stalls: a full one still carries some.
        if carried or not asked:
            self._flowed = bool(carried)
        elif self._flowed:
            self._stalled = _AFTER_STALL
        over = full and carried > 0.0 and not self._stalled and asked > _OVERLOAD * carried and too_little
        was = self.out is not None
        if asked and not arrived and (was or not self._other):
            return  # a gap does not show how much the link carries: its last figures stay
        if not was and not self._other:
            self._lately.clear()  # it carried what it was asked for
        self._lately.append(arrived)
        shown = _mean_reported(self._lately)
        self._other = self._other + 1 if over != was else 0
        carries_all = was and shown >= _CARRIED_SHARE * asked
        if carries_all or self._other >= (_ENDS if was else _BEGINS):
            self._other = 0  # the decision is made: the next one takes as many ticks again
            was = not was
            if not was:
                self.out = None
                self._log(Level.INFO, EventCode.LINK_ROOM, f"the link to {peer} is no longer full")
        if not was:
            self.out, self._record = None, FullRecord()
            return
        most = sorted(topics, key=lambda each: -each.bytes_per_second)[:_NAMED]
        figures = min(shown, asked), asked  # the two are averaged over different times
        begins = self.out is None
        self.out = Fullness(*figures, tuple(each.topic for each in most))
        names = tuple(sanitize_text(each.remote_topic, TEXT_LENGTH) for each in most)
        self._record = FullRecord(round(figures[0]), round(figures[1]), names)
        if begins:
            self._log(Level.WARNING, EventCode.LINK_FULL, self.out.warning(f"to {peer}"))

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

    def take_record(self, record: FullRecord, peer: str) -> None:
        """Take the peer's record of what it sends; impossible figures are limited."""
        before, self.into = self.into, None
        if record.asked:
            asked = _within(record.asked)
            self.into = Fullness(min(_within(record.carried), asked), asked, record.topics[:_NAMED])
            if before is None:
                self._log(Level.WARNING, EventCode.LINK_FULL, self.into.warning(f"from {peer}"))
        elif before is not None:
            self._log(Level.INFO, EventCode.LINK_ROOM, f"the link from {peer} is no longer full")

    def disconnected(self) -> None:
        """Forget everything: the next connection may go another way."""
        self.out = self.into = None
        self._other = self._stalled = 0
        self._arrived.clear()
        self._lately.clear()
        self._sent = self._record = FullRecord()

    def warning(self, peer: str) -> str:
        """Return the warning for an operator, or an empty string."""
        out = self.out.warning(f"to {peer}") if self.out is not None else ""
        into = self.into.warning(f"from {peer}") if self.into is not None else ""
        return "; ".join(filter(None, (out, into)))


def _mean_reported(ticks: Collection[float]) -> float:
    """Return the mean up to the last tick in which something arrived: the next report may only be late.

    In the first tick more may have arrived, until a queue on the way filled up.
    """
    first, *others = ticks
    while others and not others[-1]:
        others.pop()
    reported = [min(first, max(others)), *others] if others else [first]
    return sum(reported) / len(reported)


def _within(figure: float) -> float:
    return max(0.0, min(figure, _FASTEST)) if math.isfinite(figure) else 0.0


class _Asking(NamedTuple):
    """A topic that has messages to send."""

    route: OutgoingRoute
    channel: SendingChannel
    traffic: Traffic

    def by_datagrams(self) -> float:
        """Return the messages/s that arrive by the count of their datagrams, or 0 if each message is one datagram."""
        datagrams = self.route.datagrams()
        return self.channel.arrival_rate() / datagrams if datagrams > 1 else 0.0


def _overflows(asking: _Asking) -> bool:
    """Whether a topic loses datagrams because the link is probably full, not poor."""
    share = asking.channel.arrived_share
    if share is None:
        return False
    mostly_lost = share < _MOSTLY_LOST_SHARE and asking.traffic.bytes_per_second >= _MOSTLY_LOST_RATE
    return mostly_lost or (share < _OVERFLOW_SHARE and asking.route.delays.longer >= _OVERFLOW_DELAY)


class _Counts(NamedTuple):
    """Figures from a route's ledger."""

    delivered: int
    queue_full: int


class FullnessWatch:
    """Decides for one link whether it is full."""

    def __init__(
        self,
        context: Context,
        routes: Callable[[], Iterable[Route]],
        carriers: Callable[[], Collection[ChannelCarrier]],
        fullness: LinkFullness,
    ) -> None:
        self.sending, self.receiving = Throughput(), Throughput()
        self._context = context
        self._routes = routes
        self._carriers = carriers
        self._fullness = fullness
        self._crossed = 0.0
        self._held = False
        self._received = 0
        self._counts: dict[OutgoingRoute, _Counts] = {}
        self._pings: deque[float] = deque(maxlen=_SHORTEST_PINGS)

    def judge(self, keepalive: Keepalive, peer: str = "", *, lossy: bool = False) -> None:
        """Judge once a second, while linked.

        Args:
            lossy: the path loses packets, which explains why less arrives than is asked for.
        """
        now, at = self._context.now(), self._context.wall()
        asking = [
            _Asking(route, route.channel, route.traffic.measure(now))
            for route in self._routes()
            if isinstance(route, OutgoingRoute) and route.channel is not None and route.connected
        ]
        arrived, parts, full = self._looked(asking)
        asked = sum(each.traffic.bytes_per_second for each in asking)
        # Where all that is asked for arrives, pings are held up by somebody else's traffic.
        held_up = self._held_up(keepalive) and asked > _OWN_OVERLOAD * self._crossed
        full = full or held_up or self._delayed(asking, asked) or any(map(_overflows, asking))
        self._crossed = self.sending.measure(arrived, now, at, full=full)
        busy = [each for each in asking if each.traffic.bytes_per_second > 0.0]
        wanted = [Asked(route.topic, route.remote_topic, traffic.bytes_per_second) for route, _, traffic in busy]
        # While all windows still grow, what waits behind them says nothing about the link. The last condition looks at
        # all routes.
        overloaded = full and not lossy and not all(each.channel.grows for each in busy) and not self._is_measured()
        before = self._fullness.out
        # The link has carried the parts of incomplete messages, too, though nobody gets these.
        self._fullness.judge(wanted, arrived + parts, full=overloaded, peer=peer)
        received = sum(each.received_bytes for each in self._carriers())
        self.receiving.measure(received - self._received, now, at, full=False)
        self._received = received
        if self._fullness.out != before:
            self._judge_again(outgoing=True)

    def take_record(self, record: FullRecord, peer: str) -> None:
        """Take the peer's record of what it sends."""
        self._fullness.take_record(record, peer)
        self._judge_again(outgoing=False)

    def _judge_again(self, *, outgoing: bool) -> None:
        """Judge the routes of one direction again, so that their verdicts agree with the link's."""
        for route in self._routes():
            if route.outgoing == outgoing:
                route.judge_again()

    def disconnected(self) -> None:
        """Forget the connection: the next one may go another way."""
        self._received = 0
        self._crossed = 0.0
        self._held = False
        self._counts.clear()
        self._pings.clear()
        self._fullness.disconnected()
        self.sending.disconnected()
        self.receiving.disconnected()

    def _looked(self, asking: Collection[_Asking]) -> tuple[float, float, bool]:
        """Count what has arrived since the last check.

        Returns:
            The bytes of messages, the bytes of datagrams of incomplete messages, and whether more waits to be sent all
            the time.
        """
        full, arrived, parts = False, 0.0, 0.0
        before, self._counts = self._counts, {}
        for each in asking:
            route, traffic = each.route, each.traffic
            if not traffic.bytes_per_second:  # before its ledger is added up: quiet topics cost nothing
                continue
            ledger = route.ledger()
            counts = self._counts[route] = _Counts(ledger.delivered, ledger.dropped.get("queue full", 0))
            last = before.get(route, counts)  # what it delivered before it was looked at did not come now
            whole = max(0, counts.delivered - last.delivered)
            arrived += whole * traffic.size
            parts += max(0.0, each.by_datagrams() - whole) * traffic.size
            full = full or traffic.busy >= _BUSY or counts.queue_full > last.queue_full
        return arrived + self._calls(), parts, full

    def _delayed(self, asking: Collection[_Asking], asked: float) -> bool:
        """Whether messages wait on the way, for example in a tunnel that accepts more than it carries."""
        return asked > _OWN_OVERLOAD * self._crossed and any(each.route.delays.least >= _DELAYED for each in asking)

    def _is_measured(self) -> bool:
        """Whether a benchmark is open, which fills the link on purpose."""
        return any(route.purpose.fills_link for route in self._routes())

    def _calls(self) -> float:
        """Return the bytes/s of calls, which go ahead of all topics."""
        return sum(route.meter.bytes_per_second for route in self._routes() if route.duplex)

    def _held_up(self, keepalive: Keepalive) -> bool:
        """Whether pings wait behind a queue somewhere on the way."""
        rtt = keepalive.round_trip
        if rtt is None:
            return False
        self._pings.append(rtt)
        before, self._held = self._held, rtt - min(self._pings) > _PING_RISE
        return before and self._held

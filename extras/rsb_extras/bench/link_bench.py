"""Measures a link with internal routes: for this side's operator, or for the peer if this side permits it.

The measuring side proposes the routes and orders each run. The other side sends or counts, and reports its usage:
`rsb_extras.bench.bench_ends` makes and takes the messages.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Annotated, TypeAlias

from msgspec import Meta

from rsb_bridge.feature_api import (
    ControlMessageBase,
    Count,
    DeniedUse,
    EnginePart,
    Extension,
    InternalRoutes,
    LinkError,
    Questions,
    Reason,
    RouteId,
    Seconds,
    link_named,
    sanitize_text,
)
from rsb_bridge.wire.records import Hertz
from rsb_extras.bench import LIMITS
from rsb_extras.bench.bench_ends import BenchArrivals, BenchDrain, BenchSource, Time, resources
from rsb_extras.bench.benchmark import (
    BENCH,
    LEAST_SIZE,
    MOST_SECONDS,
    MOST_SIZE,
    REFUSED,
    STOPPED,
    Bench,
    Outcome,
    Usage,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from rsb_bridge.channel.data_keys import Meter
    from rsb_bridge.feature_api import Bridge, Link, Rights, Route
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.route_table import RouteTable
    from rsb_bridge.ros.ros_interface import Sink
    from rsb_extras.bench import BenchmarkLimits
    from rsb_extras.bench.benchmark import BenchmarkStep

HOUR = 3600.0
_LITTLE_LEFT = ", of which too little is left"
_DEPTH = 2000
"""Messages that may wait, as in the figures of bench/README."""
_ANSWERED_WITHIN = 5.0
_IDLE_FOR = 5.0
"""s after which the routes of a benchmark that orders nothing more are removed. Round figures: nothing was measured."""
_STOPPED_FOR = 60.0
"""s for which the peer may not begin again after this side's operator has stopped it."""
_QUIET = 0.7
"""s without a message after which no more is waited for. A round figure: nothing was measured."""
_LOOK_EVERY = 0.05  # s. A round figure, far below `_QUIET`
_MORE, _MORE_AT_ONCE = 1.25, 10
"""By how much more than the peer may send has to come from one tick to the next until that is too much: ticks are not
exactly a second apart."""
_ENDED = "the benchmark is over"

Size: TypeAlias = Annotated[int, Meta(ge=0, le=MOST_SIZE)]
Difference: TypeAlias = Annotated[float, Meta(ge=-1e9, le=1e9)]


class BenchAsk(ControlMessageBase, frozen=True):
    """The measuring side asks for the other side's counts. Answered by a `BenchAnswer` of the same number.

    Attributes:
        route: id of the route that measures.
        reset: whether to count arrivals from 0 again.
        size: bytes of each message to be sent by the other side.
        count: their number; may be 0.
    """

    request: Count
    route: RouteId
    reset: bool = False
    size: Size = 0
    rate: Hertz = 0.0
    count: Count = 0


class BenchAnswer(ControlMessageBase, frozen=True):
    """The answer to `BenchAsk`.

    Attributes:
        problem: the reason for a refusal, for an operator, or empty.
        sent: messages that the last run has sent.
        rate: Hz that it has reached, or 0 while it runs.
        received: messages since the last reset.
        p50: s on the two wall clocks, a percentile of these messages' latencies.
        cpu: s of processor time that the process has used.
        sent_bytes: handed to the sockets of its links.
        received_bytes: read from the sockets of its links.
        max_rate: Hz that the asker may cause, or 0 for no limit.
    """

    request: Count
    problem: Reason = ""
    sent: Count = 0
    rate: Hertz = 0.0
    received: Count = 0
    p50: Difference = 0.0
    p99: Difference = 0.0
    p999: Difference = 0.0
    cpu: Seconds = 0.0
    memory: Count = 0
    sent_bytes: Count = 0
    received_bytes: Count = 0
    max_rate: Hertz = 0.0


class BenchBudget:
    """Limits a peer that measures the link, within an hour from its first use."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._began = float("-inf")
        self._seconds = self._bytes = 0.0
        self._wire = self._payload = 0
        self._full = False

    def refusal(self, leave: BenchmarkLimits | None, seconds: float = 0.0, size: float = 0.0, rate: float = 0.0) -> str:
        """Return why the peer may not cause this now, or an empty string.

        Args:
            leave: the limits that the session sets now, or None if nothing is allowed.
            seconds: duration of the sending.
        """
        if leave is None:
            return "the session does not permit measuring the link (bench)"
        self._renew()
        if rate > leave.max_rate:
            return f"a benchmark may send at most {leave.max_rate:g} messages a second (bench.max_rate)"
        if self._seconds >= leave.seconds or self._seconds + seconds > leave.seconds:
            return f"a benchmark may take at most {leave.seconds:g} s in an hour (bench.seconds){_LITTLE_LEFT}"
        most = leave.megabytes * 1e6
        if self._full or self._used() >= most or self._used() + size > most:
            return f"a benchmark may send at most {most / 1e6:g} MB in an hour (bench.megabytes){_LITTLE_LEFT}"
        return ""

    def spend(self, seconds: float, size: float) -> None:
        """Count used seconds and bytes."""
        self._renew()
        self._begin()
        self._seconds += seconds
        self._bytes += size

    def take(self, leave: BenchmarkLimits | None, *, wire: int = 0, payload: int = 0) -> bool:
        """Count bytes from the peer before they are used; return False if they exceed the peer's limits.

        Args:
            leave: the limits that the session sets now, or None if nothing is allowed.
            wire: bytes as they came, with headers and seals.
            payload: bytes of a message after decompression.
        """
        self._renew()
        most = 0.0 if leave is None else leave.megabytes * 1e6
        if self._full or self._bytes + max(self._wire + wire, self._payload + payload) > most:
            self._full = True  # for the rest of the hour, as smaller messages would still fit
            return False
        self._begin()
        self._wire += wire
        self._payload += payload
        return True

    def _used(self) -> float:
        """Return the bytes sent for the peer plus the larger of the bytes it sent, sealed or unpacked."""
        return self._bytes + max(self._wire, self._payload)

    def _begin(self) -> None:
        if self._began == float("-inf"):
            self._began = self._now()

    def _renew(self) -> None:
        if self._now() - self._began >= HOUR:
            self._began = float("-inf")
            self._seconds = self._bytes = 0.0
            self._wire = self._payload = 0
            self._full = False


class LinkBench(Extension):
    """One link's benchmark, in either role."""

    purpose = BENCH

    def __init__(self, link: BaseLink, table: RouteTable) -> None:
        context = self._context = link.context
        self._link = link
        self._table = table
        self._internal = InternalRoutes(link, table, BENCH, self._source, self._drain)
        self._clocks = Time(context.clock.time_ns)
        self._now = context.now
        self._budget = BenchBudget(self._now)
        self._request = 0
        self.messages = {BenchAsk: self._asked, BenchAnswer: self._answered}
        self._questions: Questions[BenchAnswer] = Questions(link, _ANSWERED_WITHIN)
        self._used_at = 0.0
        self._stopped_until = float("-inf")
        self._busy = False
        self._seen: dict[BenchDrain, int] = {}
        """Messages of the peer by drain, as of the last tick."""
        self._own: set[BenchDrain] = set()
        """Drains of this side's own runs, which the peer's limits do not cover."""
        self._opened_drains: list[BenchDrain] = []
        """Those opened since the last tick."""
        self._ends_soon = False

    # --- for the peer

    def _source(self, sink: Sink, closed: Callable[[], None]) -> BenchSource:
        return BenchSource(sink, self._clocks, closed)

    def _drain(self, closed: Callable[[], None]) -> BenchDrain:
        drain = BenchDrain(self._clocks, closed, self._admits)
        self._opened_drains.append(drain)
        return drain

    def denial(self, rights: Rights, *, sends: bool) -> DeniedUse | None:
        return None if LIMITS.of(rights) is not None else rights.lacks("measure this link", "bench: {}")

    def refusal(self, name: str) -> str:
        if self._now() < self._stopped_until:
            return "an operator has stopped the benchmark: wait a minute before the next one"
        return self._budget.refusal(LIMITS.of(self._link.end.rights))

    def removed(self, route: Route) -> None:
        """Keep the peer from measuring for a while: an operator of this side has removed one of its routes."""
        if route.purpose is BENCH and not route.proposed_here:
            self._stopped_until = self._now() + _STOPPED_FOR

    def _asked(self, ask: BenchAsk) -> None:
        self._questions.answer(ask.request, lambda: self._answer(ask))

    def _answered(self, answer: BenchAnswer) -> None:
        self._questions.answered(answer.request, answer)

    async def _answer(self, ask: BenchAsk) -> BenchAnswer:
        route = self._link.ids.open_route(ask.route)
        if route is None or route.purpose is not BENCH:
            return BenchAnswer(ask.request, "this route does not measure the link")
        source, drain = self._internal.source(route), self._internal.drain(route)
        if ask.reset and drain is not None:
            drain.reset()
        problem = self._send_for_peer(ask, route, source) if ask.count else ""
        usage, arrived = self.usage(), drain.arrived if drain is not None else BenchArrivals(0, (0.0, 0.0, 0.0))
        leave = LIMITS.of(self._link.end.rights)
        busy = source is not None and source.busy
        return BenchAnswer(
            ask.request,
            sanitize_text(problem),
            0 if source is None else source.sent,
            0.0 if source is None or busy else source.rate,
            arrived.messages,
            *arrived.latencies,
            usage.cpu,
            usage.memory,
            usage.sent_bytes,
            usage.received_bytes,
            0.0 if leave is None else leave.max_rate,
        )

    def _send_for_peer(self, ask: BenchAsk, route: Route, source: BenchSource | None) -> str:
        """Begin to send for the peer; return why this is not possible, or an empty string."""
        if source is None or route.proposed_here:  # its proposer orders the runs
            return "the side that asks sends on this route itself"
        if any(self._sends_for_peer(each) for each in self._internal.proposed(here=False)):
            return "messages of the previous run are still being sent"
        size, seconds = max(ask.size, LEAST_SIZE), ask.count / max(ask.rate, 1e-3)  # 0 is a rate on the wire
        if seconds > MOST_SECONDS:
            return f"a run takes at most {MOST_SECONDS:g} s"
        if refused := self._budget.refusal(LIMITS.of(self._link.end.rights), seconds, size * ask.count, ask.rate):
            return refused
        self._budget.spend(seconds, size * ask.count)
        source.start(size, ask.rate, ask.count)
        return ""

    def meter_of(self, route_id: int) -> Meter | None:
        route = self._link.ids.open_route(route_id)
        if route is None or route.proposed_here or route.outgoing or route.purpose is not BENCH:
            return None
        return lambda size: self._budget.take(LIMITS.of(self._link.end.rights), wire=size) or self._end_soon()

    def _admits(self, drain: BenchDrain, size: int) -> bool:
        """Whether an unpacked message may come to a drain."""
        if drain in self._own:
            return True
        return self._budget.take(LIMITS.of(self._link.end.rights), payload=size) or self._end_soon()

    def _end_soon(self) -> bool:
        """End the peer's routes at the next turn of the loop: now a message of one is being handled."""
        if not self._ends_soon:
            self._ends_soon = True
            self._context.loop.call_soon(self._end_refused)
        return False

    def _end_refused(self, rate: float = 0.0) -> None:
        self._ends_soon = False
        if refused := self._budget.refusal(LIMITS.of(self._link.end.rights), rate=rate):
            for route in self._internal.proposed(here=False):
                self._table.deny(route, refused)

    def tick(self) -> None:
        """Count the peer's messages, and remove the routes of a benchmark that orders nothing more."""
        if not self._link.linked:
            return
        count = self._come()
        if count:
            self._budget.spend(1.0, 0.0)  # its bytes are counted as they come
        rate = max(0.0, count - _MORE_AT_ONCE) / _MORE
        self._end_refused(rate)
        if not self._busy and self._now() - self._used_at > _IDLE_FOR:
            self.end()

    def _come(self) -> int:
        """Return how many messages the peer has sent since the last tick, on closed routes, too."""
        messages = 0
        # Drains that have closed since, too: a peer that opens a route again and again would be charged nothing.
        opened, self._opened_drains = self._opened_drains, []
        for drain, before in (self._seen | dict.fromkeys(opened, 0)).items():
            if drain not in self._own:
                messages += drain.messages - before
            self._seen[drain] = drain.messages
            if drain.closed:
                del self._seen[drain]
                self._own.discard(drain)
        return messages

    def _sends_for_peer(self, route: Route) -> bool:
        source = self._internal.source(route)
        return source is not None and source.busy

    # --- for this side's operator

    async def run(self, order: BenchmarkStep) -> Outcome:
        """Send messages over the link, wait until all have arrived or are lost, and return the outcome.

        Raises:
            LinkError: it cannot be done, or the peer does not allow it.
        """
        if self._busy:
            raise LinkError("the link is being measured already")
        self._check(order)
        self._busy = True
        try:
            return await self._run(order)
        finally:
            self._busy = False
            self._used_at = self._now()

    def end(self) -> None:
        """Remove the routes."""
        for route in self._internal.proposed(here=True):
            self._table.remove(route, _ENDED)

    def disconnected(self) -> None:
        self._questions.disconnected()

    def usage(self) -> Usage:
        """Return the usage of this process so far, with the bytes of this link."""
        cpu, memory = resources()
        return Usage(cpu, memory, *self.wire_bytes())

    def wire_bytes(self) -> tuple[int, int]:
        """Return the bytes sent and received by the carriers of the present connection."""
        carriers = self._link.carriers()
        return sum(each.sent_bytes for each in carriers), sum(each.received_bytes for each in carriers)

    def _check(self, order: BenchmarkStep) -> None:
        if not self._link.linked:
            raise LinkError(f"{self._link.name} is not linked: {self._link.down_reason}")
        if not LEAST_SIZE <= order.size <= MOST_SIZE:
            raise LinkError(f"a message has {LEAST_SIZE} to {MOST_SIZE:,} bytes")
        if order.count < 1 or not 0 < order.rate < 1e6 or order.count / order.rate > MOST_SECONDS:
            raise LinkError(f"a run has at least one message, and takes at most {MOST_SECONDS:g} s")

    async def _run(self, order: BenchmarkStep) -> Outcome:
        route = await self._opened(order)
        sends, opening = route.outgoing, route.id
        theirs = await self._ask(route, opening, reset=True)
        if 0 < theirs.max_rate < order.rate:
            raise LinkError(f"{REFUSED}: it allows {theirs.max_rate:g} messages a second to a benchmark")
        ours = self.usage()
        if sends:
            source = self._internal.source(route)
            if source is None:
                raise LinkError(_why_not(route))
            if source.busy:
                raise LinkError("the previous run is not over yet")
            source.start(order.size, order.rate, order.count)
            await self._until_idle(lambda: source.busy, order)
            answer = await self._settled_there(route, opening, order)
            sent, rate, received = source.sent, source.rate, answer.received
            latencies = (answer.p50, answer.p99, answer.p999)
        else:
            drain = self._internal.drain(route)
            if drain is None:
                raise LinkError(_why_not(route))
            drain.reset()
            self._own.add(drain)
            began = self._now()
            await self._ask(route, opening, size=order.size, rate=order.rate, count=order.count)
            await self._settled_here(drain, order)
            answer = await self._ask(route, opening)
            sent, rate, received = answer.sent, answer.rate or answer.sent / (self._now() - began), drain.count
            latencies = drain.arrived.latencies
        now = self.usage()
        mine = _between(ours, now)
        peers = _between(_usage_in(theirs), _usage_in(answer))
        # Stamps are from the sender's wall clock, arrivals from the receiver's.
        offset = (self._link.clock.offset or 0.0) * (-1 if sends else 1)
        p50, p99, p999 = (each + offset for each in latencies)
        return Outcome(
            now,
            sent,
            received,
            rate,
            p50,
            p99,
            p999,
            self._link.clock.uncertainty,
            mine if sends else peers,
            peers if sends else mine,
            answer.max_rate,
        )

    async def _opened(self, order: BenchmarkStep) -> Route:
        """Return the route, once messages can cross on it."""
        link_transport = self._context.transports.of_link(self._context.session.host)
        transport = order.transport or link_transport.name
        name = BENCH.route_name(transport, order.direction)
        route = next((each for each in self._internal.proposed(here=True) if each.spec.topic == name), None)
        if route is None:
            if self._internal.proposed(here=False):
                raise LinkError("the other side is measuring the link: try again later")
            # Not compressed: of the zeros in its messages nothing would be left.
            route = self._internal.open(
                name, order.direction, depth=_DEPTH, compression="none", transport=order.transport
            )
        if not await self._internal.opened(route):
            raise LinkError(_why_not(route))
        return route

    async def _ask(self, route: Route, opening: int, **wanted: Any) -> BenchAnswer:
        """Ask the peer about a route, in the opening in which the run began.

        Raises:
            LinkError: the peer refuses, or the route was opened again: the peer has forgotten the old opening, and
                may not have heard of the new one.
        """
        _check_opening(route, opening)
        self._request += 1
        answer = await self._questions.ask(self._request, BenchAsk(self._request, opening, **wanted))
        _check_opening(route, opening)
        if answer.problem:
            raise LinkError(f"{REFUSED}: {answer.problem}")
        return answer

    async def _until_idle(self, busy: Callable[[], bool], order: BenchmarkStep) -> None:
        deadline = self._deadline(order)
        while busy() and self._now() < deadline:  # noqa: ASYNC110 -- a thread's state
            await asyncio.sleep(_LOOK_EVERY)

    async def _settled_there(self, route: Route, opening: int, order: BenchmarkStep) -> BenchAnswer:
        answer, grown = await self._ask(route, opening), self._now()
        deadline, interval = self._deadline(order), max(_QUIET, 2 / order.rate)
        while answer.received < order.count and self._now() < min(grown + interval, deadline):
            await asyncio.sleep(_LOOK_EVERY)
            newer = await self._ask(route, opening)
            if newer.received > answer.received:
                grown = self._now()
            answer = newer
        return answer

    async def _settled_here(self, drain: BenchDrain, order: BenchmarkStep) -> None:
        come, grown = drain.count, self._now()
        deadline, interval = self._deadline(order), max(_QUIET, 2 / order.rate)
        while come < order.count and self._now() < min(grown + interval, deadline):
            await asyncio.sleep(_LOOK_EVERY)
            if drain.count > come:
                come, grown = drain.count, self._now()

    def _deadline(self, order: BenchmarkStep) -> float:
        """Return when to give up waiting for a run and its last messages."""
        # A sender that is too slow ends after twice the planned time (docs/bench-protocol.md).
        return self._now() + 2 * order.count / order.rate + _QUIET


class BenchPart(EnginePart):
    """Carries out the steps of benchmarks."""

    def __init__(self, bridge: Bridge) -> None:
        super().__init__()
        self._bridge = bridge
        self.handlers = {Bench: self._bench}

    async def _bench(self, command: Bench) -> Outcome:
        order, links = command.order, self._bridge.role.links()
        if order.what == "measure":
            cpu, memory = resources()
            # (0, 0), as there may be no link.
            counts = zip((0, 0), *(_of(link).wire_bytes() for link in links), strict=True)
            sent, received = (sum(each) for each in counts)
            return Outcome(Usage(cpu, memory, sent, received))
        bench = _of(link_named(order.link, links))
        if order.what == "run":
            return await bench.run(order)
        bench.end()
        return Outcome(bench.usage())


def _of(link: Link) -> LinkBench:
    return link.extensions.find(LinkBench)


REOPENED = "the route was reopened during the run, so that the count is incomplete"


def _check_opening(route: Route, opening: int) -> None:
    """Check that a route is in the opening in which the run began.

    Raises:
        LinkError: it is not.
    """
    if route.life.refusal or not route.id:
        raise LinkError(_why_not(route))
    if route.id != opening:
        raise LinkError(REOPENED)


def _why_not(route: Route) -> str:
    """Return why no message crosses on a measuring route."""
    if route.life.refusal:
        return str(route.life.refusal)
    if not route.crossing.flows:
        return f"{STOPPED}: it has removed or paused the route"
    trouble = route.trouble()
    return trouble.text if trouble is not None else ""


def _usage_in(answer: BenchAnswer) -> Usage:
    return Usage(answer.cpu, answer.memory, answer.sent_bytes, answer.received_bytes)


def _between(before: Usage, after: Usage) -> Usage:
    return Usage(
        max(0.0, after.cpu - before.cpu),
        after.memory,
        max(0, after.sent_bytes - before.sent_bytes),
        max(0, after.received_bytes - before.received_bytes),
    )

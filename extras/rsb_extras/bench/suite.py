"""The measurements of `bench`: their order and time limits, on this machine or over a running link."""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import EngineError
from rsb_bridge.model.transports import of_link
from rsb_console.notation.formats import byte_count
from rsb_extras.bench.benchmark import BENCH, ENDED_BY_PEER, MOST_SECONDS, Bench, BenchmarkStep, Outcome
from rsb_extras.bench.results import BenchError, Load, Point, Run, Side, StoppedError, Way
from rsb_extras.demo.processes import ProcessError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from typing import Any

    from rsb_bridge.feature_api import EngineApi, RouteSnapshot, Session, Snapshot
    from rsb_extras.bench.results import BenchEnds, BenchPlace, BenchReport, Limit

_FIRST_BYTES = 50e6
"""First rate of a search, in bytes a second. The figures here are round: a search that begins elsewhere takes a run
more for each doubling or halving."""
_FIRST_RATE = 5000.0
_GENTLE_BYTES = 20e6
_LEAST_MESSAGES = 5  # large messages at a low rate would not come once in a run
_TOO_FAST = 1.5  # times the highest rate, to measure a link that gets too much
_SLOWER_BY = 0.5  # far from a loss, which would count too few bytes
TRIES = 2
"""Trials at each rate, as another program may cause one loss."""
CLOSE = 1.1
"""Ratio of the lowest rate with loss to the highest without, at which a search ends."""
_KEEPS_UP = 0.95  # of the rate: a sender that makes less has fallen behind
_LOWEST = 0.5  # Hz


@dataclass(frozen=True, slots=True)
class Plan:
    """The extent of a benchmark.

    Attributes:
        sizes: bytes of a message.
        run: seconds of each run.
        close: precision of the highest rate (`CLOSE`).
        gentle: rate (Hz) of the runs for latencies.
        gentle_run: seconds of each of these.
        paced: higher rates (Hz) at which the latency is measured, too.
        idle: seconds to measure an idle bridge, or 0 to skip that.
        many: numbers of topics to open at once.
        most: limit on the whole benchmark, in seconds.
    """

    sizes: tuple[int, ...]
    run: float = 1.0
    close: float = 1.1
    gentle: float = 100.0
    gentle_run: float = 3.0
    paced: tuple[int, ...] = (1_000, 5_000, 10_000, 20_000)
    idle: float = 3.0
    many: tuple[int, ...] = (1, 50, 500)
    most: float = 600.0


FULL = Plan((256, 2_500, 10_000, 100_000, 1_000_000, 6_000_000), most=360.0)
QUICK = Plan((256, 10_000, 1_000_000), run=0.3, close=1.3, gentle_run=1.0, idle=1.0, many=(), most=50.0)


class Suite:
    """The measurements in one place.

    Args:
        say: progress callback.
    """

    def __init__(
        self, place: BenchPlace, plan: Plan, report: BenchReport, clock: Callable[[], float], say: Callable[[str], None]
    ) -> None:
        self._place = place
        self._plan = plan
        self._report = report
        self._clock = clock
        self._say = say
        self._ends_at = clock() + plan.most
        self._share_ends = self._ends_at

    def run(self) -> None:
        """Measure everything; note the parts that cannot be measured.

        Raises:
            KeyboardInterrupt: the operator interrupts; the report has the results so far.
        """
        try:
            base = self._baseline()
            ways = self._place.ways
            for at, way in enumerate(ways):
                self._measure(way, base, [len(ways) - at, len(self._plan.sizes)])
            self._many()
        except StoppedError as error:
            self._report.ended = "stopped"
            self._report.notes.append(str(error))

    @property
    def _time_is_up(self) -> bool:
        if self._clock() < self._ends_at or not self._report.points:  # something is always measured
            return False
        self._report.ended = "time"
        return True

    def _baseline(self) -> dict[int, tuple[float, float, float]]:
        made = self._place.baseline(list(self._plan.sizes))
        if made is None:
            return {}
        found = {}
        self._say("without a bridge")
        with made as ends:
            for size in self._plan.sizes:
                run = ends.send(self._gentle(ends, size), self._plan.gentle_run, size)
                found[size] = (run.p50, run.p99, run.p999)
        return found

    def _measure(self, way: Way, base: dict[int, tuple[float, float, float]], left: Sequence[int]) -> None:
        """Measure one transport and direction, within its share of the remaining time."""
        if self._time_is_up:
            return
        ways_left, sizes = left
        budget = (self._ends_at - self._clock()) / ways_left
        way_ends = self._clock() + budget
        try:
            with contextlib.ExitStack() as resources:
                self._say(f"{way.transport} {way.direction}")
                ends = resources.enter_context(self._place.open(way, list(self._plan.sizes)))
                first = _FIRST_RATE
                for at, size in enumerate(self._plan.sizes):
                    if self._time_is_up:
                        break
                    self._share_ends = self._clock() + (way_ends - self._clock()) / (sizes - at)
                    point = self._point(ends, way, size, base.get(size), first)
                    self._report.points.append(point)
                    if point.best is not None and at + 1 < sizes:
                        # Larger messages carry more bytes a second: for the next size, twice as many are tried first.
                        first = max(1.0, point.best.rate * min(1.0, 2 * size / self._plan.sizes[at + 1]))
                self._say(f"{way.transport} {way.direction}, idle")
                self._report.sides[way.transport] = ends.sides(
                    0.0 if self._clock() > self._ends_at else self._plan.idle
                )
        except ProcessError as error:
            self._report.notes.append(f"{way.transport} {way.direction}: {error}")

    def _point(
        self, ends: BenchEnds, way: Way, size: int, base: tuple[float, float, float] | None, first: float
    ) -> Point:
        plan = self._plan
        what = f"{way.transport} {way.direction}, {byte_count(size)}"
        self._say(f"{what}, latency")
        gentle = ends.send(self._gentle(ends, size), plan.gentle_run, size, "latency")
        tried: list[float] = []

        def trial(rate: float) -> Run:
            self._say(f"{what}, {rate:,.0f} msg/s")
            tried.append(rate)
            return ends.send(rate, max(plan.run, _LEAST_MESSAGES / rate), size, "search")

        found = highest_lossless(
            trial,
            first=min(first, _FIRST_BYTES / size),
            most=ends.most(size),
            close=plan.close,
            goes_on=lambda: self._clock() < min(self._share_ends, self._ends_at),
        )
        best, full = found.best, None
        # The latency run shows at least that its own rate is carried.
        if best is None and found.limit == "time" and gentle.lossless:
            best = gentle
        if best is not None and best.wire is None:
            self._say(f"{what}, wire")
            seen = ends.wire(best.rate * _SLOWER_BY, plan.run, size)
            best = best if seen is None else replace(best, wire=_of(seen, best.sent))
        paced = self._paced(ends, what, size, best.rate if best else 0.0)
        if found.limit == "loss":
            rate = min(ends.most(size), _TOO_FAST * (best.rate if best else tried[-1]))
            self._say(f"{what}, {rate:,.0f} msg/s, too fast")
            full = ends.send(rate, max(plan.run, _LEAST_MESSAGES / rate), size, "too_fast")
        return Point(way.transport, way.direction, size, gentle, base, best, found.limit, full, paced)

    def _paced(self, ends: BenchEnds, what: str, size: int, highest: float) -> tuple[Run, ...]:
        """Send at the plan's rates as far as they are carried, and as time remains."""
        runs = []
        for rate in self._plan.paced:
            # A rate that loses messages has no percentiles: they would leave out the lost ones.
            if rate > min(highest, _FIRST_BYTES / size) or self._clock() >= min(self._share_ends, self._ends_at):
                break
            self._say(f"{what}, latency at {rate:,} msg/s")
            runs.append(ends.send(rate, self._plan.run, size, "latency"))
        return tuple(runs)

    def _gentle(self, ends: BenchEnds, size: int) -> float:
        return max(1.0, min(self._plan.gentle, _GENTLE_BYTES / size, ends.most(size)))

    def _many(self) -> None:
        for count in self._plan.many:
            if self._time_is_up:
                return
            self._say(f"{count} topics")
            try:
                many = self._place.many(count)
            except ProcessError as error:
                self._report.notes.append(f"{count} topics: {error}")
                continue
            if many is not None:
                self._report.many.append(many)


def _of(run: Run, sent: int) -> int | None:
    """Scale a run's wire bytes to the number of messages of another run."""
    return round(run.wire * sent / run.sent) if run.wire and run.sent else None


class Found(NamedTuple):
    """The result of a search for the highest rate.

    Attributes:
        best: run at the highest rate without loss, or None.
        limit: reason why no higher rate was found.
    """

    best: Run | None
    limit: Limit


def highest_lossless(
    trial: Callable[[float], Run],
    *,
    first: float,
    most: float = float("inf"),
    close: float = CLOSE,
    goes_on: Callable[[], bool] = lambda: True,
) -> Found:
    """Find the run at the highest rate without loss.

    Args:
        trial: sends for a while at a rate (Hz).
        first: first rate to try (Hz).
        most: highest rate to try (Hz).
        close: ratio of rates at which the search ends, as `CLOSE`.
        goes_on: called before each trial except the first; False ends the search with its best run so far.
    """
    rate, good, bad, tried = min(first, most), None, 0.0, False
    while not (good and bad) or bad > close * good.rate:
        passed = None
        for _ in range(TRIES):
            if tried and not goes_on():
                return Found(good, "time")
            tried = True
            run = trial(rate)
            if run.lossless:
                passed = run
                break
        if passed is None:
            bad = rate
            # A link that carries nothing would have its rate halved for ever.
            if rate <= _LOWEST:
                return Found(good, "loss")
        else:
            if good is None or passed.rate > good.rate:
                good = passed
            # A sender that falls behind cannot make a higher rate: what the link carries is not known.
            if passed.rate < _KEEPS_UP * rate:
                return Found(good, "sender")
            if rate >= most:
                return Found(good, "leave")
        rate = min(most, _next(good.rate if good else 0.0, bad))
    return Found(good, "loss")


def _next(good: float, bad: float) -> float:
    if good and bad:
        return (good + bad) / 2
    return good * 2 if good else max(_LOWEST, bad / 2)


_ANSWERED_WITHIN = 60.0  # s; a run takes 30 s at most (`MOST_SECONDS`)
_ENDED_WITHIN = 5.0  # s. A round figure: the command ends so much later at most
_ALONE = 0.01
"""Share of the benchmark's bytes up to which other topics' bytes are ignored."""


class OverLink:
    """One link of an attached bridge.

    Args:
        ways: transports and directions to measure.
    """

    def __init__(self, engine: EngineApi, link: str, ways: list[Way]) -> None:
        self._engine = engine
        self._link = link
        self._ways = ways

    @property
    def ways(self) -> list[Way]:
        return self._ways

    def baseline(self, _: list[int]) -> None:
        return None

    @contextlib.contextmanager
    def open(self, way: Way, sizes: list[int]) -> Iterator[BenchEnds]:
        ends = _LinkEnds(self._engine, self._link, way)
        ends.send(10.0, 0.2, sizes[0])  # opens the topic
        yield ends

    def many(self, _: int) -> None:
        return None

    def close(self) -> None:
        """Remove the topics; a bridge that does not answer removes them itself later."""
        with contextlib.suppress(EngineError, TimeoutError):
            self._engine.do(Bench(BenchmarkStep("end", self._link))).result(_ENDED_WITHIN)


class _LinkEnds:
    def __init__(self, engine: EngineApi, link: str, way: Way) -> None:
        self._engine = engine
        self._link = link
        self._way = way
        self._last: Outcome | None = None

    def send(self, rate: float, seconds: float, size: int, _: str = "") -> Run:
        count = max(1, min(int(rate * seconds), math.floor(rate * MOST_SECONDS)))
        way: Any = self._way
        outcome = _result(
            self._engine, BenchmarkStep("run", self._link, way.transport, way.direction, size, rate, count)
        )
        self._last = outcome
        p50, p99, p999 = (each * 1e3 for each in (outcome.p50, outcome.p99, outcome.p999))
        sides = outcome.sending.cpu, outcome.receiving.cpu
        alone = self._others() < _ALONE * outcome.rate * size
        wire = outcome.sending.sent_bytes or None if alone else None
        return Run(size, outcome.sent, outcome.received, outcome.rate, p50, p99, p999, sides, wire)

    def wire(self, *_: float) -> None:
        """Return no count: the link's bytes include its own topics, which may dominate."""
        return

    def _others(self) -> float:
        """Bytes/s of the link's own topics, the same way."""
        now = self._engine.snapshot()
        own = (route for route in now.routes if route.link == self._link and route.purpose != BENCH.name)
        return sum(route.bytes_per_second for route in own if route.outgoing == self._sends_here)

    def most(self, _: int) -> float:
        return (self._last.most_rate if self._last else 0.0) or math.inf

    def sides(self, idle: float) -> tuple[Side, Side]:
        before, began = _result(self._engine, BenchmarkStep("measure")).usage, time.monotonic()
        time.sleep(idle)
        used = _result(self._engine, BenchmarkStep("measure")).usage.cpu - before.cpu
        share = 100 * used / (time.monotonic() - began) if idle else None
        assert self._last is not None
        sending, receiving = (Side(each.memory / 1e6) for each in (self._last.sending, self._last.receiving))
        here = Side(before.memory / 1e6, share)
        return (here, receiving) if self._sends_here else (sending, here)

    @property
    def _sends_here(self) -> bool:
        return (self._engine.snapshot().role == "client") == (self._way.direction == "transmit")


def _result(engine: EngineApi, order: BenchmarkStep) -> Outcome:
    try:
        return engine.do(Bench(order)).result(_ANSWERED_WITHIN)
    except EngineError as error:
        if str(error).startswith(ENDED_BY_PEER):
            raise StoppedError(str(error)) from None
        raise BenchError(str(error)) from None
    except TimeoutError:
        raise BenchError(f"the bridge has not answered for {_ANSWERED_WITHIN:.0f} s") from None


def ways_of(session: Session, transports: tuple[str, ...], directions: tuple[str, ...]) -> list[Way]:
    """Return the transports and directions to measure over a session's link: its own transports by default."""
    link = of_link(session.host)
    over = transports or (link.name, *link.companions)
    return [Way(transport, direction) for direction in directions for transport in over]


def loads_of(snapshot: Snapshot, link: str = "") -> list[Load]:
    """Return the topics of a bridge with a measured rate and size."""
    return [load for _, load in _loads(snapshot, link)]


def loads_of_all(snapshots: Iterable[Snapshot]) -> list[Load]:
    """Return the topics of several bridges; topics between two of them count once."""
    found: dict[tuple[str, ...], dict[str, list[Load]]] = {}
    for snapshot in snapshots:
        for route, load in _loads(snapshot):
            sides = found.setdefault((route.link, route.spec.topic, route.spec.direction), {})
            sides.setdefault(snapshot.role, []).append(load)
    return [load for sides in found.values() for load in max(sides.values(), key=len)]


def _loads(snapshot: Snapshot, link: str = "") -> Iterator[tuple[RouteSnapshot, Load]]:
    for route in snapshot.routes:
        if route.spec.kind != "topic" or link not in ("", route.link) or not route.ledger.delivered:
            continue
        rate = route.expected_rate or route.rate
        size = route.bytes_per_second / route.rate if route.rate else route.bytes_total / route.ledger.delivered
        if rate and size:
            yield route, Load(route.topic, size, rate, route.transport, route.spec.direction)

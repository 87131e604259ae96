"""Over the link of a bridge that runs, to a peer that gives leave: no ROS takes part at either end."""

from __future__ import annotations

import contextlib
import math
import time
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.model.benchmark import ENDED_BY_PEER, MOST_SECONDS, Order, Outcome, is_bench_topic
from rsb_console.bench.results import BenchError, Load, Run, Side, StoppedError, Way

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from typing import Any

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot, Snapshot
    from rsb_console.bench.results import Ends

_ANSWERED_WITHIN = 60.0
_ENDED_WITHIN = 5.0
_ALONE = 0.01
"""The part of the benchmark's bytes up to which others do not count."""


class OverLink:
    """One link of an attached bridge.

    Args:
        engine: attached.
        link: its name.
        ways: what is measured.
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
    def open(self, way: Way, sizes: list[int]) -> Iterator[Ends]:
        ends = _LinkEnds(self._engine, self._link, way)
        ends.send(10.0, 0.2, sizes[0])  # opens the topic
        yield ends

    def many(self, _: int) -> None:
        return None

    def close(self) -> None:
        """Remove the topics; where the bridge does not answer, it does so itself in a while."""
        with contextlib.suppress(EngineError, TimeoutError):
            self._engine.bench(Order("end", self._link)).result(_ENDED_WITHIN)


class _LinkEnds:
    def __init__(self, engine: EngineApi, link: str, way: Way) -> None:
        self._engine = engine
        self._link = link
        self._way = way
        self._last: Outcome | None = None

    def send(self, rate: float, seconds: float, size: int) -> Run:
        count = max(1, min(int(rate * seconds), math.floor(rate * MOST_SECONDS)))
        way: Any = self._way
        outcome = _result(self._engine, Order("run", self._link, way.transport, way.direction, size, rate, count))
        self._last = outcome
        p50, p99, p999 = (each * 1e3 for each in (outcome.p50, outcome.p99, outcome.p999))
        sides = outcome.sending.cpu, outcome.receiving.cpu
        alone = self._others() < _ALONE * outcome.rate * size
        wire = outcome.sending.sent_bytes or None if alone else None
        return Run(size, outcome.sent, outcome.received, outcome.rate, p50, p99, p999, sides, wire)

    def wire(self, *_: float) -> None:
        """The link's own topics are in its bytes, too: where they are much, there is nothing to see."""
        return

    def _others(self) -> float:
        """Bytes/s of the link's own topics, the same way."""
        now = self._engine.snapshot()
        own = (route for route in now.routes if route.link == self._link and not is_bench_topic(route.topic))
        return sum(route.bytes_per_second for route in own if route.outgoing == self._sends_here)

    def most(self, _: int) -> float:
        return (self._last.most_rate if self._last else 0.0) or math.inf

    def sides(self, idle: float) -> tuple[Side, Side]:
        before, began = _result(self._engine, Order("measure")).usage, time.monotonic()
        time.sleep(idle)
        used = _result(self._engine, Order("measure")).usage.cpu - before.cpu
        share = 100 * used / (time.monotonic() - began) if idle else None
        assert self._last is not None
        sending, receiving = (Side(each.memory / 1e6) for each in (self._last.sending, self._last.receiving))
        here = Side(before.memory / 1e6, share)
        return (here, receiving) if self._sends_here else (sending, here)

    @property
    def _sends_here(self) -> bool:
        return (self._engine.snapshot().role == "client") == (self._way.direction == "transmit")


def _result(engine: EngineApi, order: Order) -> Outcome:
    try:
        return engine.bench(order).result(_ANSWERED_WITHIN)
    except EngineError as error:
        if str(error).startswith(ENDED_BY_PEER):
            raise StoppedError(str(error)) from None
        raise BenchError(str(error)) from None
    except TimeoutError:
        raise BenchError(f"the bridge has not answered for {_ANSWERED_WITHIN:.0f} s") from None


def ways_of(link: LinkSnapshot, transports: tuple[str, ...], directions: tuple[str, ...]) -> list[Way]:
    """What can be measured over a link: its own transports, unless others are wanted."""
    own = ("bluetooth",) if "channel" in link.peer else ("tcp", "udp")
    if link.peer.startswith("zenoh"):
        own = ("zenoh", "zenoh-drop")
    return [Way(transport, direction) for direction in directions for transport in transports or own]


def loads_of(snapshot: Snapshot, link: str = "") -> list[Load]:
    """The topics of a bridge whose rate and size are known by now."""
    return [load for _, load in _loads(snapshot, link)]


def loads_of_all(snapshots: Iterable[Snapshot]) -> list[Load]:
    """The topics of several bridges. What runs between two of them is counted once."""
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

"""The commands ``hz`` and ``bw``: print a topic's rate or bandwidth once a second, as `ros2 topic` does."""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections import deque
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.model.snapshot import State
from rsb_console.command.formatting import json_line
from rsb_console.command.shell import FAILURE, OK, print_line, print_lines
from rsb_console.command.target import attached, chosen_route, other_side
from rsb_console.notation import formats

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Iterator

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot

_EVERY = 1.0  # as `ros2 topic hz`
_LOOK_EVERY = 0.05  # a bridge renews its snapshot each 0.25 s while somebody looks (`telemetry.snapshot_publisher`)
_SHORTEST = 0.9  # s: the least time for figures; a snapshot may be a little early
_LEDGER_FROM = 1.9  # s: the least time for the ledger's rates, as the other side reports its counts once a second
_RENEWED_WITHIN = 10.0  # s within which a working bridge has a newer snapshot


@dataclass(frozen=True, slots=True)
class Figures:
    """A topic's figures over a while, as one bridge counts them.

    Attributes:
        time: s since the epoch, of that snapshot.
        seconds: s over which the figures are taken.
        messages: number of messages that this bridge gave to the link's queue, or published.
        size: bytes of their payload.
        offered: messages that the sending bridge took from ROS, as far as this side knows.
        delivered: messages that the receiving bridge published, as far as this side knows.
        dropped: messages that were dropped for any cause, as far as this side knows.
        each_second: messages in each of the last seconds of the window, oldest first.
    """

    route: RouteSnapshot
    time: float
    seconds: float
    messages: int
    size: int
    offered: int
    delivered: int
    dropped: int
    each_second: tuple[int, ...]

    @property
    def rate(self) -> float:
        return self.messages / self.seconds

    @property
    def crossing(self) -> str:
        """The rates at which messages were delivered and dropped, or an empty string if they are not known yet."""
        if self.seconds < _LEDGER_FROM:
            return ""
        text = f"delivered: {formats.hertz(self.delivered / self.seconds)} Hz"
        return f"{text}, dropped: {formats.hertz(self.dropped / self.seconds)} Hz" if self.dropped else text


class SnapshotWindow:
    """The last snapshots of one topic, from which figures over so many seconds are taken."""

    def __init__(self, seconds: int) -> None:
        self._seconds = seconds
        self._looks: deque[tuple[float, RouteSnapshot]] = deque()

    def add(self, moment: float, route: RouteSnapshot) -> Figures | None:
        """Take a snapshot of a moment (s since the epoch).

        Returns:
            The figures since the oldest snapshot of the window, or None if that is too new.
        """
        looks = self._looks
        # The wall clock may be set back, across which there is no rate.
        if looks and (moment <= looks[-1][0] or _began_again(looks[-1][1], route)):
            looks.clear()
        looks.append((moment, route))
        # The newest one that is as old as the window stays, so that the figures are of the whole window.
        while len(looks) > 2 and looks[1][0] <= moment - self._seconds:
            looks.popleft()
        began, first = looks[0]
        if moment - began < _SHORTEST:
            return None
        return Figures(
            route=route,
            time=moment,
            seconds=moment - began,
            messages=route.messages_total - first.messages_total,
            size=route.bytes_total - first.bytes_total,
            offered=route.ledger.offered - first.ledger.offered,
            delivered=route.ledger.delivered - first.ledger.delivered,
            # This count may fall: a message that counts as lost on the way may still be reported as delivered.
            dropped=max(0, route.ledger.dropped_total - first.ledger.dropped_total),
            each_second=route.history[-self._seconds :],
        )


def _began_again(before: RouteSnapshot, now: RouteSnapshot) -> bool:
    """Whether counts are smaller than before: the route or one of the bridges has started again."""
    return (
        now.messages_total < before.messages_total
        or now.bytes_total < before.bytes_total
        or now.ledger.offered < before.ledger.offered
        or now.ledger.delivered < before.ledger.delivered
    )


def _print_figures(
    lines: Callable[[Figures], Iterator[str]], values: Callable[[Figures], dict[str, object]], arguments: Namespace
) -> int:
    """Print figures once a second, as lines for people or as values for programs."""
    with attached(arguments, read_only=True) as engine:
        route = chosen_route(engine, arguments)
        if not arguments.json:
            print_line(_where(route, other_side(engine, route.link)))
            sys.stdout.flush()
        count = math.inf if arguments.count is None else arguments.count
        moment, due = 0.0, time.monotonic()
        ends = math.inf if arguments.lasts is None else due + arguments.lasts
        window, printed, messages = SnapshotWindow(arguments.window), 0, 0
        while printed < count and due <= ends:
            now = _newer(engine, moment, due)
            if (newer := _same_route(now, route)) is None:
                raise EngineError(f"{engine.name} no longer bridges {route.topic}")
            moment, route = now.time, newer
            figures = window.add(moment, route)
            # Lines that a stall has delayed are not made up for.
            due = max(due + _EVERY, time.monotonic())
            if figures is None:
                continue
            printed, messages = printed + 1, messages + figures.messages
            if arguments.json:
                print_line(json_line(_about(figures) | values(figures)))
            else:
                print_lines("\n".join(lines(figures)))  # print_line escapes the tabs
            sys.stdout.flush()
        return OK if messages else FAILURE


def measured(engine: RemoteEngine, route: RouteSnapshot, seconds: float) -> Figures | None:
    """Take figures of a topic over some seconds, or None if its bridge has no newer snapshots of it."""
    # The window is longer than the span, so that the first snapshot stays in it.
    window, ends = SnapshotWindow(round(seconds) + 1), time.monotonic() + seconds + 1
    # The route that the command has chosen may be older: its counts would make rates up to twice as high.
    first = engine.snapshot()
    if (route_first := _same_route(first, route)) is None:
        return None
    began = moment = first.time
    found = window.add(moment, route_first)
    while moment - began < seconds and time.monotonic() < ends:
        time.sleep(_LOOK_EVERY)
        now = engine.snapshot()
        if (route_now := _same_route(now, route)) is None:
            return None
        if now.time > moment:
            moment, found = now.time, window.add(now.time, route_now)
    return found


def _newer(engine: RemoteEngine, moment: float, due: float) -> Snapshot:
    """Wait until `due`, and for a snapshot newer than `moment` (s since the epoch)."""
    time.sleep(max(0.0, due - time.monotonic()))
    deadline = time.monotonic() + _RENEWED_WITHIN
    while (now := engine.snapshot()).time == moment and time.monotonic() < deadline:
        time.sleep(_LOOK_EVERY)
    if engine.unreachable or not now.running or now.time == moment:
        raise EngineError(engine.unreachable or "the bridge is stopped")
    return now


def _same_route(now: Snapshot, before: RouteSnapshot) -> RouteSnapshot | None:
    """Return a route as it is in a newer snapshot, or None if it was removed."""
    return next((route for route in now.routes if (route.link, route.key) == (before.link, before.key)), None)


def _where(route: RouteSnapshot, other: str) -> str:
    if route.outgoing:
        return f"{route.topic} → {other}: counted where this bridge gives it to the link's queue, after max_rate"
    return f"{route.topic} ← {other}: counted where this bridge publishes it, after it came over the link"


def _about(figures: Figures) -> dict[str, object]:
    route = figures.route
    return {
        "topic": route.topic,
        "link": route.link,
        "outgoing": route.outgoing,
        "measured": "sent" if route.outgoing else "published",
        "time": figures.time,
        "state": route.state,
        "cause": route.cause,
        "age": route.age(figures.time),
        "seconds": round(figures.seconds, 3),
        "messages": figures.messages,
    }


def _state(route: RouteSnapshot) -> Iterator[str]:
    if route.state is not State.OK or route.reason:
        yield f"\t{route.state.upper()}{f': {route.reason}' if route.reason else ''}"


# --- hz


def _hz_lines(figures: Figures) -> Iterator[str]:
    route = figures.route
    if figures.messages:
        crossing = f"; {figures.crossing}" if figures.crossing else ""
        yield f"average rate: {figures.rate:.3f} Hz over {figures.seconds:.0f} s{crossing}"
    else:
        age = route.age(figures.time)
        yield f"no message {'yet' if age is None else f'for {formats.age(age)}'}"
    if counts := figures.each_second:
        spread = f"min {min(counts)}, max {max(counts)}, std dev {statistics.pstdev(counts):.2f}"
        yield f"\tin each of the last {len(counts)} s: {spread}"
    if named := formats.rate_by_name(route):
        yield f"\t{named}"
    if figures.seconds >= _LEDGER_FROM:
        yield f"\ttaken from ROS by the sending bridge: {figures.offered / figures.seconds:.1f} Hz"
    yield from _state(route)


def _hz_values(figures: Figures) -> dict[str, object]:
    route, counts = figures.route, figures.each_second
    return {
        "rate": round(figures.rate, 3),
        "each_second": {
            "seconds": len(counts),
            "min": min(counts, default=None),
            "max": max(counts, default=None),
            "std_dev": round(statistics.pstdev(counts), 3) if counts else None,
        },
        "offered_rate": round(figures.offered / figures.seconds, 3),
        "delivered_rate": round(figures.delivered / figures.seconds, 3),
        "dropped_rate": round(figures.dropped / figures.seconds, 3),
        "expected_rate": route.spec.expected_rate,
        "usual_rate": None if route.spec.expected_rate else route.expected_rate,
        "max_rate": route.max_rate,
    }


# --- bw


def _bw_lines(figures: Figures) -> Iterator[str]:
    route, rate = figures.route, formats.byte_rate(figures.size / figures.seconds)
    crossing = f"; {figures.crossing}" if figures.crossing else ""
    yield f"{rate} from {figures.messages} messages over {figures.seconds:.0f} s, before compression{crossing}"
    if figures.messages:
        mean = formats.byte_count(round(figures.size / figures.messages))
        overall = formats.byte_count(round(route.bytes_total / route.messages_total))
        yield f"\tmessage size mean: {mean}; since the start {overall}"
    yield from _state(route)


def _bw_values(figures: Figures) -> dict[str, object]:
    route = figures.route
    return {
        "bytes_per_second": round(figures.size / figures.seconds, 1),
        "delivered_rate": round(figures.delivered / figures.seconds, 3),
        "dropped_rate": round(figures.dropped / figures.seconds, 3),
        "bytes": figures.size,
        "mean_size": round(figures.size / figures.messages, 1) if figures.messages else None,
        "mean_size_overall": round(route.bytes_total / route.messages_total, 1) if route.messages_total else None,
        "bytes_total": route.bytes_total,
        "messages_total": route.messages_total,
    }


hz = partial(_print_figures, _hz_lines, _hz_values)
bw = partial(_print_figures, _bw_lines, _bw_values)

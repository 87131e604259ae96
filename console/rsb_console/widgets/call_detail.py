"""The details of a service, an action or a node's parameters: why it does not answer, and what became of its calls."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.look import formats
from rsb_console.look.glyphs import DONE, FAILED, IN, OUT, UNDER_WAY, UNKNOWN
from rsb_console.widgets import detail_parts as parts

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.calls import CallsSnapshot, GoalSnapshot
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.widgets.lines import Line

_MOST_GOALS = 8
_ID_LENGTH = 8  # digits that tell goals apart
_OVER = {
    "succeeded": (DONE, "ok"), "canceled": (UNKNOWN, "dim"), "aborted": (FAILED, "down"), "rejected": (FAILED, "stale"),
}  # fmt: skip
_NOT_KNOWN = "unknown"
"""What became of it: its server has gone, say."""


def call_lines(route: RouteSnapshot, calls: CallsSnapshot, peer: str, width: int) -> Iterator[Line]:
    """Lay out the details of what has calls.

    Args:
        route: what it is about.
        calls: its calls.
        peer: the other side's name or address.
        width: of the pane, cells.
    """
    yield from parts.heading(route, "call", width)
    yield from parts.crossing(route, f"{f'{OUT} answered by' if route.outgoing else f'{IN} called by'} {peer}", width)
    yield ()
    yield from parts.stages(route, "Why it doesn't answer", "and it does not answer now", width)
    if calls.last_failure:
        yield ()
        yield ((" Last failure", "head"),)
        yield from parts.wrapped(calls.last_failure, width, "stale")
    if route.goals:
        yield ()
        yield from _goals(route.goals, width)
    yield ()
    yield from parts.plot(route, "Calls", "a second", width)
    yield ()
    yield from _ledger(calls)
    yield ()
    yield from _figures(route, calls, width)


def _ledger(calls: CallsSnapshot) -> Iterator[Line]:
    """The ledger. The share answered is of what is not still under way."""
    rows = [
        ("asked", calls.asked, "", ""),
        ("answered", calls.answered, "", parts.share(calls.answered, calls.asked - calls.in_flight)),
        ("expired", calls.expired, "down", ""),
        ("refused", sum(calls.refused.values()), "down", ""),
        *((f"  {cause}", count, "down", "") for cause, count in calls.refused.items() if count),
        ("lost", calls.lost, "down", ""),
        ("in flight", calls.in_flight, "", ""),
    ]
    yield from parts.ledger("Ledger of calls", rows)
    if calls.late:
        yield (("   apart from these: ", "dim"), (formats.counted(calls.late, "late answer"), "stale"))


def _goals(goals: Sequence[GoalSnapshot], width: int) -> Iterator[Line]:
    """Those that are not over first, as they come."""
    under_way = sum(goal.state not in (*_OVER, _NOT_KNOWN) for goal in goals)
    yield ((" Goals", "head"), (f"  {under_way} under way", "strong"))
    for goal in goals[:_MOST_GOALS]:
        sign, look = _OVER.get(goal.state, (UNKNOWN if goal.state == _NOT_KNOWN else UNDER_WAY, "waiting"))
        since = f" since {formats.time_of_day(goal.since)}"
        yield ((f" {sign} ", look), (goal.state, "" if goal.state in _OVER else "strong"), (since, "dim"))
        waits = ", its caller waits" if goal.result_awaited else ""
        feedbacks = formats.counted(goal.feedbacks, "feedback")
        yield from parts.wrapped(f"{goal.id[:_ID_LENGTH]}  {feedbacks}{waits}", width, "dim")
    if len(goals) > _MOST_GOALS:
        yield ((f"   and {len(goals) - _MOST_GOALS} more", "dim"),)


def _figures(route: RouteSnapshot, calls: CallsSnapshot, width: int) -> Iterator[Line]:
    yield from _latency("far node" if route.outgoing else "node here", calls.node_p50, calls.node_p99, "", width)
    yield from _latency("the way", calls.way_p50, calls.way_p99, ", there and back", width)
    yield parts.labelled("given up", f"after {route.spec.call_timeout:g} s without an answer")
    yield from parts.throughput(route, width)
    yield from parts.nodes("callers", route.publishers, width)
    yield from parts.nodes("providers", route.subscribers, width)
    if route.type_hash:
        yield parts.labelled("type hash", route.type_hash)
    if route.last_error:
        yield from parts.figure("last error", route.last_error.split(), width)


def _latency(name: str, p50: float | None, p99: float | None, what: str, width: int) -> Iterator[Line]:
    if p50 is not None and p99 is not None:
        yield from parts.figure(name, [f"p50 {formats.span(p50)} ", f"p99 {formats.span(p99)}{what}"], width)

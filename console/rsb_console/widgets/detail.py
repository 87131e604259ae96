"""The details of the route under the cursor: the reason why it does not flow, and the ledger of messages or calls."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.actions import Group, bindings
from rsb_console.look import formats
from rsb_console.look.formats import PatternRow, Row
from rsb_console.look.glyphs import DONE, FAILED, IN, OUT, UNDER_WAY, UNKNOWN
from rsb_console.widgets import detail_parts as parts
from rsb_console.widgets.detail_parts import DetailText
from rsb_console.widgets.lines import FixedLines, Line, fit

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.calls import CallsSnapshot, GoalSnapshot
    from rsb_bridge.model.snapshot import Ledger, RouteSnapshot

_MOST_GOALS = 8
"""Goals that are shown, two lines each. A round figure: each further one pushes the plot and the ledger down."""
_ID_LENGTH = 8  # digits that tell goals apart
_OVER = {
    "succeeded": (DONE, "ok"), "canceled": (UNKNOWN, "dim"), "aborted": (FAILED, "down"), "rejected": (FAILED, "stale"),
}  # fmt: skip
_NOT_KNOWN = "unknown"
"""State of a goal whose end is unknown, for instance because its server has gone."""


class DetailPane(FixedLines, can_focus=True):
    """Shows the topic under the table's cursor. It has no cursor of its own: a list's keys scroll it."""

    BINDINGS = bindings(Group.MOVE)

    def __init__(self) -> None:
        super().__init__(id="detail")
        self._route: Row | None = None
        self._peer = ""

    def show(self, route: Row | None, peer: str = "") -> None:
        """Show a topic. If the topic changed, scroll to its first line.

        Args:
            peer: the other side's name or address.
        """
        if (route and route.key) != (self._route and self._route.key):
            self.scroll_home(animate=False)
        self._route, self._peer = route, peer
        self.entitle("" if route is None else f"{route.topic} ")
        width = self.scrollable_content_region.width  # without the scrollbar, which hides the ends of lines
        if route is None:
            self._lines = [(), ((" no topic selected", "dim"),)]
        else:
            self._lines = [fit(line, width) for line in detail_lines(route, peer, width)]
        self.sync()

    def action_move_down(self) -> None:
        self.scroll_down(animate=False)

    def action_move_up(self) -> None:
        self.scroll_up(animate=False)

    def action_move_first(self) -> None:
        self.scroll_home(animate=False)

    def action_move_last(self) -> None:
        self.scroll_end(animate=False)

    def on_resize(self) -> None:
        # Lines are cut and wrapped for the width that the pane had.
        self.show(self._route, self._peer)


def detail_lines(route: Row, peer: str, width: int) -> Iterator[Line]:
    """Lay out the details of a topic, a service, an action or parameters.

    Args:
        peer: the other side's name or address.
        width: width of the pane in cells.
    """
    if isinstance(route, PatternRow):
        return _pattern_lines(route, width)
    return _topic_lines(route, peer, width) if route.calls is None else call_lines(route, route.calls, peer, width)


def _pattern_lines(row: PatternRow, width: int) -> Iterator[Line]:
    yield (parts.state(row.state),)
    yield from parts.why(row, "", width)
    yield ()
    yield parts.labelled("here", row.topic)
    yield parts.labelled("there", row.remote_topic)
    yield parts.labelled("bridges", f"{row.routes} now")
    for at, name in enumerate(row.spec.excepts):
        yield parts.labelled("" if at else "except", name)
    if row.type_name:
        yield from parts.figure("only", [row.type_name], width)
    yield ()
    yield from parts.wrapped("Each name that matches has a line of its own in the table.", width, "dim")


def _topic_lines(route: RouteSnapshot, peer: str, width: int) -> Iterator[Line]:
    yield from parts.heading(route, "message", width)
    yield from parts.crossing(route, f"{f'{OUT} to' if route.outgoing else f'{IN} from'} {peer}", width)
    yield ()
    yield from parts.stages(route, DetailText.WHY_NOT_FLOWING(), DetailText.NOTHING_COMES(), width)
    yield ()
    yield from parts.plot(route, "Rate", "Hz", width)
    yield ()
    yield from _ledger(route.ledger, route.max_rate, route.max_age)
    yield ()
    yield from _figures(route, width)


def _ledger(ledger: Ledger, limit: float | None, max_age: float) -> Iterator[Line]:
    """Return the ledger. The delivered share leaves out throttled, unknown and in-flight messages."""
    due = ledger.offered - ledger.throttled - ledger.unknown - ledger.in_flight
    rows = [
        ("offered", ledger.offered, "", ""),
        ("delivered", ledger.delivered, "", parts.share(ledger.delivered, due)),
        ("throttled", ledger.throttled, "", f"  limit {limit:g} Hz" if limit else ""),
        ("expired", ledger.expired, "stale", f"  limit {max_age:g} s" if max_age else ""),
        ("in flight", ledger.in_flight, "", ""),
        ("dropped", ledger.dropped_total, "down", ""),
        *((f"  {cause}", count, "down", "") for cause, count in ledger.dropped.items() if count),
        *([("unknown", ledger.unknown, "stale", "  the other side died")] if ledger.unknown else []),
        ("lost in DDS", ledger.lost_in_dds, "stale", ""),
        *([("missed while down", ledger.missed_while_down, "stale", "  estimate")] if ledger.missed_while_down else []),
    ]
    yield from parts.ledger("Ledger", rows)


def _figures(route: RouteSnapshot, width: int) -> Iterator[Line]:
    yield from parts.throughput(route, width)
    if route.latency_p50 is not None and route.latency_p99 is not None:
        uncertain = [] if route.latency_uncertainty is None else [f"± {formats.span(route.latency_uncertainty)}"]
        p50, p99 = (formats.latency(at, route.latency_uncertainty) for at in (route.latency_p50, route.latency_p99))
        yield from parts.figure("latency", [f"p50 {p50} ", f"p99 {p99}", *uncertain], width)
    if route.jitter is not None:
        yield from parts.figure("jitter", [formats.span(route.jitter)], width)
    if route.qos is not None:
        yield from parts.figure("QoS", formats.qos_parts(route.qos), width)
    ends = (
        ("publishers", "offer", route.publishers, route.publisher_qos),
        ("subscribers", "ask for", route.subscribers, route.subscriber_qos),
    )
    for name, verb, nodes, qos in ends:
        if qos is not None:
            who = [f"{node}," for node in nodes]
            yield from parts.figure(name, [*who, verb, *formats.qos_parts(qos, depth_known=False)], width)
    if route.type_hash:
        yield parts.labelled("type hash", route.type_hash)  # cut: its beginning is enough to tell two hashes apart
    yield from parts.last_error(route, width)


def call_lines(route: RouteSnapshot, calls: CallsSnapshot, peer: str, width: int) -> Iterator[Line]:
    """Lay out the details of a service, an action or parameters.

    Args:
        peer: the other side's name or address.
        width: width of the pane in cells.
    """
    yield from parts.heading(route, "call", width)
    yield from parts.crossing(route, f"{f'{OUT} answered by' if route.outgoing else f'{IN} called by'} {peer}", width)
    yield ()
    yield from parts.stages(route, DetailText.WHY_NO_ANSWER(), DetailText.NO_ANSWER_NOW(), width)
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
    yield from _calls_ledger(calls)
    yield ()
    yield from _calls_figures(route, calls, width)


def _calls_ledger(calls: CallsSnapshot) -> Iterator[Line]:
    """Yield the ledger of calls. The share answered leaves out pending calls."""
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
    """Yield the goals: pending ones first, in order of arrival."""
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


def _calls_figures(route: RouteSnapshot, calls: CallsSnapshot, width: int) -> Iterator[Line]:
    yield from _latency("far node" if route.outgoing else "node here", calls.node_p50, calls.node_p99, "", width)
    yield from _latency("the way", calls.way_p50, calls.way_p99, ", there and back", width)
    yield parts.labelled("given up", DetailText.GIVEN_UP(timeout=route.spec.call_timeout))
    yield from parts.throughput(route, width)
    yield from parts.nodes("callers", route.publishers, width)
    yield from parts.nodes("providers", route.subscribers, width)
    if route.type_hash:
        yield parts.labelled("type hash", route.type_hash)
    yield from parts.last_error(route, width)


def _latency(name: str, p50: float | None, p99: float | None, what: str, width: int) -> Iterator[Line]:
    if p50 is not None and p99 is not None:
        yield from parts.figure(name, [f"p50 {formats.span(p50)} ", f"p99 {formats.span(p99)}{what}"], width)

"""The details of the route under the cursor: the reason why it does not flow, and the ledger of messages or calls."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from rsb_bridge.model.by_hand import END_CANCEL, END_NONE
from rsb_bridge.model.wording import Wording
from rsb_console.actions.action import Group
from rsb_console.actions.all_actions import bindings
from rsb_console.notation import formats
from rsb_console.notation.formats import PatternRow, Row
from rsb_console.notation.glyphs import (
    ARMED,
    ARMED_WORD,
    DONE,
    FAILED,
    IN,
    OUT,
    STATE_SIGN,
    STATE_WORD,
    UNDER_WAY,
    UNKNOWN,
    braille_plot,
)
from rsb_console.widgets.lines import FixedLines, Line, fit, width_of
from rsb_console.widgets.topics import carries, present_rate

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.calls import CallsSnapshot, GoalSnapshot
    from rsb_bridge.model.snapshot import Acknowledgement, ArmingSnapshot, Ledger, RouteSnapshot, Stage, State

_MOST_GOALS = 8
"""Goals that are shown, two lines each. A round figure: each further one pushes the plot and the ledger down."""
_ID_LENGTH = 8  # digits that tell goals apart
_OVER = {
    "succeeded": (DONE, "ok"), "canceled": (UNKNOWN, "dim"), "aborted": (FAILED, "down"), "rejected": (FAILED, "stale"),
}  # fmt: skip
_NOT_KNOWN = "unknown"
"""State of a goal whose end is unknown, for instance because its server has gone."""
_PLOT_HEIGHT = 4
_LABEL = 11  # cells of a figure's name, of which "subscribers" is the longest
_TIED = "\N{NO-BREAK SPACE}"
"""Keeps a figure and its unit on one line: textwrap breaks no line there."""


class DetailText(Wording):
    """Texts of the details of a topic or a service."""

    WHY_NOT_FLOWING = "Why it isn't flowing"
    NOTHING_COMES = "and nothing comes now"
    WHY_NO_ANSWER = "Why it doesn't answer"
    GIVEN_UP = "after {timeout:g} s without an answer"
    ALL_PARAMETERS = "all parameters of the node"
    UNKNOWN_TYPE = "type not known yet"


class DetailPane(FixedLines, can_focus=True):
    """Shows the topic under the table's cursor. It has no cursor of its own: a list's keys scroll it."""

    BINDINGS = bindings(Group.MOVE)

    def __init__(self) -> None:
        super().__init__(id="detail")
        self._route: Row | None = None
        self._peer = ""
        self._now = 0.0

    def show(self, route: Row | None, peer: str = "", now: float = 0.0) -> None:
        """Show a topic. If the topic changed, scroll to its first line.

        Args:
            peer: the other side's name or address.
            now: s since the epoch, of the snapshot.
        """
        if (route and route.key) != (self._route and self._route.key):
            self.scroll_home(animate=False)
        self._route, self._peer, self._now = route, peer, now
        self.entitle("" if route is None else f"{route.topic} ")
        width = self.scrollable_content_region.width  # without the scrollbar, which hides the ends of lines
        if route is None:
            self._lines = [(), ((" no topic selected", "dim"),)]
        else:
            self._lines = [fit(line, width) for line in detail_lines(route, peer, width, now)]
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
        self.show(self._route, self._peer, self._now)


def detail_lines(route: Row, peer: str, width: int, now: float) -> Iterator[Line]:
    """Lay out the details of a topic, a service, an action or parameters.

    Args:
        peer: the other side's name or address.
        width: width of the pane in cells.
        now: s since the epoch, of the snapshot.
    """
    if isinstance(route, PatternRow):
        return _pattern_lines(route, width)
    if route.calls is None:
        return _topic_lines(route, peer, width, now)
    return _call_lines(route, route.calls, peer, width, now)


def _pattern_lines(row: PatternRow, width: int) -> Iterator[Line]:
    yield (_state(row.state),)
    yield from _why(row, "", width)
    yield ()
    yield _labelled("here", row.topic)
    yield _labelled("there", row.remote_topic)
    yield _labelled("bridges", f"{row.routes} now")
    for at, name in enumerate(row.spec.excepts):
        yield _labelled("" if at else "except", name)
    if row.type_name:
        yield from _figure("only", [row.type_name], width)
    yield ()
    yield from _wrapped("Each name that matches has a line of its own in the table.", width, "dim")


def _topic_lines(route: RouteSnapshot, peer: str, width: int, now: float) -> Iterator[Line]:
    yield from _heading(route, "message", width, now)
    yield from _crossing(route, f"{f'{OUT} to' if route.outgoing else f'{IN} from'} {peer}", width)
    yield ()
    yield from _stages(route, DetailText.WHY_NOT_FLOWING(), DetailText.NOTHING_COMES(), width)
    yield ()
    yield from _plot(route, "Rate", "Hz", width)
    yield ()
    yield from _topic_ledger(route.ledger, route.max_rate, route.max_age)
    yield ()
    yield from _topic_figures(route, width)


def _topic_ledger(ledger: Ledger, limit: float | None, max_age: float) -> Iterator[Line]:
    """Return the ledger. The delivered share leaves out throttled, unknown and in-flight messages."""
    due = ledger.offered - ledger.throttled - ledger.unknown - ledger.in_flight
    rows = [
        ("offered", ledger.offered, "", ""),
        ("delivered", ledger.delivered, "", _share(ledger.delivered, due)),
        ("throttled", ledger.throttled, "", f"  limit {limit:g} Hz" if limit else ""),
        ("expired", ledger.expired, "stale", f"  limit {max_age:g} s" if max_age else ""),
        ("in flight", ledger.in_flight, "", ""),
        ("dropped", ledger.dropped_total, "down", ""),
        *((f"  {cause}", count, "down", "") for cause, count in ledger.dropped.items() if count),
        *([("unknown", ledger.unknown, "stale", "  the other side died")] if ledger.unknown else []),
        ("lost in DDS", ledger.lost_in_dds, "stale", ""),
        *([("missed while down", ledger.missed_while_down, "stale", "  estimate")] if ledger.missed_while_down else []),
    ]
    yield from _ledger("Ledger", rows)


def _topic_figures(route: RouteSnapshot, width: int) -> Iterator[Line]:
    yield from _throughput(route, width)
    if route.latency_p50 is not None and route.latency_p99 is not None:
        uncertain = [] if route.latency_uncertainty is None else [f"± {formats.span(route.latency_uncertainty)}"]
        p50, p99 = (formats.latency(at, route.latency_uncertainty) for at in (route.latency_p50, route.latency_p99))
        yield from _figure("latency", [f"p50 {p50} ", f"p99 {p99}", *uncertain], width)
    if route.jitter is not None:
        yield from _figure("jitter", [formats.span(route.jitter)], width)
    if route.qos is not None:
        yield from _figure("QoS", formats.qos_parts(route.qos), width)
    ends = (
        ("publishers", "offer", route.publishers, route.publisher_qos),
        ("subscribers", "ask for", route.subscribers, route.subscriber_qos),
    )
    for name, verb, nodes, qos in ends:
        if qos is not None:
            who = [f"{node}," for node in nodes]
            yield from _figure(name, [*who, verb, *formats.qos_parts(qos, depth_known=False)], width)
    if route.type_hash:
        yield _labelled("type hash", route.type_hash)  # cut: its beginning is enough to tell two hashes apart
    yield from _last_error(route, width)


def _call_lines(route: RouteSnapshot, calls: CallsSnapshot, peer: str, width: int, now: float) -> Iterator[Line]:
    """Lay out the details of a service, an action or parameters.

    Args:
        peer: the other side's name or address.
        width: width of the pane in cells.
    """
    yield from _heading(route, "call", width, now)
    yield from _crossing(route, f"{f'{OUT} answered by' if route.outgoing else f'{IN} called by'} {peer}", width)
    yield ()
    yield from _stages(route, DetailText.WHY_NO_ANSWER(), "and it does not answer now", width)
    if calls.last_failure:
        yield ()
        yield ((" Last failure", "head"),)
        yield from _wrapped(calls.last_failure, width, "stale")
    if route.goals:
        yield ()
        yield from _goals(route.goals, width)
    yield ()
    yield from _plot(route, "Calls", "a second", width)
    yield ()
    yield from _calls_ledger(calls)
    yield ()
    yield from _calls_figures(route, calls, width)


def _calls_ledger(calls: CallsSnapshot) -> Iterator[Line]:
    """Yield the ledger of calls. The share answered leaves out pending calls."""
    rows = [
        ("asked", calls.asked, "", ""),
        ("answered", calls.answered, "", _share(calls.answered, calls.asked - calls.in_flight)),
        ("expired", calls.expired, "down", ""),
        ("refused", sum(calls.refused.values()), "down", ""),
        *((f"  {cause}", count, "down", "") for cause, count in calls.refused.items() if count),
        ("lost", calls.lost, "down", ""),
        ("in flight", calls.in_flight, "", ""),
        *((("  wait for the node", calls.waiting, "", ""),) if calls.waiting else ()),
    ]
    yield from _ledger("Ledger of calls", rows)
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
        yield from _wrapped(f"{goal.id[:_ID_LENGTH]}  {feedbacks}{waits}", width, "dim")
    if len(goals) > _MOST_GOALS:
        yield ((f"   and {len(goals) - _MOST_GOALS} more", "dim"),)


def _calls_figures(route: RouteSnapshot, calls: CallsSnapshot, width: int) -> Iterator[Line]:
    yield from _latency("far node" if route.outgoing else "node here", calls.node_p50, calls.node_p99, "", width)
    yield from _latency("the way", calls.way_p50, calls.way_p99, ", there and back", width)
    yield _labelled("given up", DetailText.GIVEN_UP(timeout=route.spec.call_timeout))
    yield from _throughput(route, width)
    yield from _nodes("callers", route.publishers, width)
    yield from _nodes("providers", route.subscribers, width)
    if route.type_hash:
        yield _labelled("type hash", route.type_hash)
    yield from _last_error(route, width)


def _latency(name: str, p50: float | None, p99: float | None, what: str, width: int) -> Iterator[Line]:
    if p50 is not None and p99 is not None:
        yield from _figure(name, [f"p50 {formats.span(p50)} ", f"p99 {formats.span(p99)}{what}"], width)


def _heading(route: RouteSnapshot, last: str, width: int, now: float) -> Iterator[Line]:
    """Yield the state, the arming and the reason of a fault.

    Args:
        last: word for the last arrival: ``message``.
        width: width of the pane in cells.
    """
    ago = "" if route.last_at is None or now - route.last_at < 1 else formats.age_of(route.last_at, now)
    yield _state(route.state), (ago and f" last {last} {ago} ago", "dim")
    if (arming := route.arming) is not None and arming.armed:
        left = "" if arming.left is None else f" {arming.left:.0f} s"
        yield ((f" {ARMED} {ARMED_WORD}{left} ", "armed"),)
        yield from _wrapped(f"{arming.by}, {_until(arming)}", width, "")
    if arming is not None and arming.demanded_by:
        yield from _wrapped(f"has to be armed: {', '.join(arming.demanded_by)}", width, "dim")
    if arming is not None and arming.on_end:
        yield from _wrapped(f"when that ends, {_ends(arming.on_end, route)}", width, "dim")
    if route.limits is not None:
        yield from _wrapped(f"at most {route.limits} by hand: {', '.join(route.limited_by)}", width, "dim")
    yield from _why(route, next((stage.detail for stage in route.stages if not stage.done), ""), width)


def _state(of: State) -> tuple[str, str]:
    """Return the piece of a line that shows a state."""
    return f" {STATE_SIGN[of]} {STATE_WORD[of]} ", of.value


def _why(row: Row, elsewhere: str, width: int) -> Iterator[Line]:
    """Yield the acknowledgement and the reason of a fault, unless the details give that elsewhere."""
    if row.acknowledged is not None:
        yield from _wrapped(acknowledged_by(row.acknowledged), width, "dim")
    if row.reason and row.reason != elsewhere:
        yield from _wrapped(row.reason, width, row.state.value)


def acknowledged_by(record: Acknowledgement) -> str:
    """Return a note on the operator who has acknowledged a fault, and the time."""
    return f"acknowledged by {record.by} at {formats.time_of_day(record.at)}, until it changes"


def _ends(on_end: str, route: RouteSnapshot) -> str:
    if route.calls is not None:
        return "its goals are cancelled" if on_end == END_CANCEL else "its goals go on"
    return f"the robot gets {'nothing' if on_end == END_NONE else on_end}"


def _until(arming: ArmingSnapshot) -> str:
    """Return the conditions that disarm it."""
    if not arming.deadman:
        return "until it is disarmed, the link drops or that console ends"
    return f"until no key is pressed on that console for {arming.deadman:g} s"


def _carrier_of(route: RouteSnapshot) -> str:
    """Return the transport with its port or channel, if it has one."""
    if not route.port:
        return route.transport.upper()
    return f"{route.transport.upper()} {'channel' if route.transport == 'bluetooth' else 'port'} {route.port}"


def _crossing(route: RouteSnapshot, way: str, width: int) -> Iterator[Line]:
    """Yield the type, the direction, the transport, the name on the other side and the pattern.

    Args:
        way: direction and peer in words.
        width: width of the pane in cells.
    """
    yield ((f" {_type(route)}", "strong" if route.type_name else "dim"),)
    carrier = _carrier_of(route)
    towards: Line = ((f" {way}", ""), (f"  {carrier}", "dim"))
    yield from (towards,) if width_of(towards) <= width else (towards[:1], ((f"   {carrier}", "dim"),))
    if route.remote_topic and route.remote_topic != route.topic:
        yield ((f"   there: {route.remote_topic}", "dim"),)
    if route.pattern:
        yield ((f"   matches {route.pattern}", "dim"),)


def _type(route: RouteSnapshot) -> str:
    """Return the type, if the bridge knows it. Parameters have ROS's own types."""
    unknown = DetailText.ALL_PARAMETERS if route.spec.kind == "parameters" else DetailText.UNKNOWN_TYPE
    return formats.known_type(route) or unknown()


def _stages(route: RouteSnapshot, question: str, nothing: str, width: int) -> Iterator[Line]:
    """Yield the stages: those passed on one line, the first that fails with its reason, and the others on one line.

    Args:
        question: question that they answer if it does not work.
        nothing: text for a route that passed all stages but no longer works.
        width: width of the pane in cells.
    """
    of_route = route.stages
    waiting = [index for index, stage in enumerate(of_route) if not stage.done]
    # A failed stage explains more than an earlier one without a result.
    at = next((index for index in waiting if of_route[index].done is False), next(iter(waiting), None))
    yield ((" Stages" if route.state.flows else f" {question}", "head"),)
    if at is None:
        passed = f"all {len(of_route)} passed"
        if carries(route) and not route.state.flows:
            yield ((f" {UNKNOWN} ", route.state.value), (f"{passed} before", ""))
            yield from _wrapped(nothing, width, "")
        else:
            yield ((f" {DONE} ", "ok"), (passed, ""))
        return
    failed = of_route[at]
    yield from _listed(DONE, "ok", [stage for stage in of_route if stage.done], width)
    sign, look = (UNKNOWN, "waiting") if failed.done is None else (FAILED, "down")
    yield ((f" {sign} ", look), (failed.name, "strong"))
    yield from _wrapped(failed.detail, width, look)
    yield from _listed(UNKNOWN, "dim", [of_route[index] for index in waiting if index != at], width)


def _listed(sign: str, look: str, of_route: Sequence[Stage], width: int) -> Iterator[Line]:
    names = ", ".join(stage.name for stage in of_route)
    for number, text in enumerate(textwrap.wrap(names, max(10, width - 4))):
        yield ((f" {' ' if number else sign} ", look), (text, "dim"))


def _wrapped(text: str, width: int, look: str) -> Iterator[Line]:
    """Wrap a text over as many lines as it takes."""
    for line in textwrap.wrap(text, max(10, width - 3)):
        yield ((f"   {line}", look),)


def _plot(route: RouteSnapshot, title: str, unit: str, width: int) -> Iterator[Line]:
    """Yield the present rate and a curve of the last seconds.

    Args:
        width: width of the pane in cells.
    """
    # A route keeps the last 120 s, two of which take a cell.
    cells = max(1, min(width - 2, 60))
    shown = route.history[-2 * cells :]
    usual = route.expected_rate if route.calls is None else None  # nobody expects calls
    top = 1.2 * max(usual or 0.0, *shown, 1.0) if shown else 1.0
    expected = "" if usual is None else f" of {formats.expected(usual)}"
    yield (
        (f" {title}", "head"),
        (f"  {formats.hertz(present_rate(route)) if carries(route) else '-'} {unit}{expected}", "strong"),
        (f"  last {2 * cells} s", "dim"),
    )
    for line in braille_plot(shown, cells, _PLOT_HEIGHT, top):
        yield ((f" {line}", "plot"),)


def _ledger(title: str, rows: Sequence[tuple[str, int, str, str]]) -> Iterator[Line]:
    """Yield counts, one a line.

    Args:
        rows: name, count, style if the count is not 0, and a remark for each line.
    """
    yield ((f" {title}", "head"),)
    name_width = max(_LABEL, *(len(name) for name, _, _, _ in rows)) + 1
    for name, count, look, behind in rows:
        yield (
            (f" {name:<{name_width}}", "dim"),
            (f"{formats.thousands(count):>9}", look if count else "dim"),
            (behind, ""),
        )


def _share(part: int, whole: int) -> str:
    """Format a part in percent, or return an empty string if the whole is 0."""
    return f"  {100 * part / whole:.1f} %" if whole > 0 else ""


def _throughput(route: RouteSnapshot, width: int) -> Iterator[Line]:
    """Format the present byte rate and the total."""
    total = f"{formats.thousands(route.bytes_total)} in all"
    yield from _figure("bytes", [f"{formats.byte_rate(route.bytes_per_second)},", total], width)


def _nodes(name: str, of_route: Sequence[str], width: int) -> Iterator[Line]:
    """Yield the known nodes at one end of the route."""
    if of_route:
        yield from _figure(name, [f"{node}," for node in of_route[:-1]] + [of_route[-1]], width)


def _figure(name: str, pieces: Sequence[str], width: int) -> Iterator[Line]:
    """Yield a named figure, wrapped to the pane's width without breaking pieces that fit on a line."""
    room = max(10, width - _LABEL - 2)
    text = " ".join(pieces)
    if len(text) <= room:  # the usual case, at every refresh
        yield _labelled(name, text)
        return
    tied = " ".join(piece.replace(" ", _TIED) for piece in pieces)
    for number, line in enumerate(textwrap.wrap(tied, room)):
        yield _labelled("" if number else name, line.replace(_TIED, " ").rstrip())


def _last_error(route: RouteSnapshot, width: int) -> Iterator[Line]:
    """Yield the last error with its time, if there was one."""
    if route.last_error:
        words = [*route.last_error.split(), f"(at {formats.time_of_day(route.last_error_at)})"]
        yield from _figure("last error", words, width)


def _labelled(name: str, text: str) -> Line:
    """Format a named figure on one line."""
    return ((f" {name:<{_LABEL}} ", "dim"), (text, ""))

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
from rsb_console.notation.route_fact import facts_of
from rsb_console.widgets.lines import FixedLines, Line, fit, width_of
from rsb_console.widgets.topics import carries, present_rate

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.model.calls import CallsSnapshot, GoalSnapshot
    from rsb_bridge.model.snapshot import Acknowledgement, RouteSnapshot, Stage, State

_MOST_GOALS = 8
"""Goals that are shown, two lines each. A round figure: each further one pushes the plot and the ledger down."""
_AXIS = 6  # cells of a plot's numbers
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


class _Page:
    """Lines from the top down, laid out for a pane.

    Args:
        width: of the pane, in cells.
    """

    def __init__(self, width: int) -> None:
        self.width = width
        self.lines: list[Line] = []

    def add(self, *pieces: tuple[str, str]) -> None:
        """Add a line, or a blank one without pieces. It is cut where the pane ends."""
        self.lines.append(pieces)

    def text(self, text: str, look: str) -> None:
        """Add a text on as many lines as it takes."""
        for line in textwrap.wrap(text, max(10, self.width - 3)):
            self.add((f"   {line}", look))

    def names(self, sign: str, look: str, stages: Iterable[Stage]) -> None:
        """Add the names of stages behind a sign."""
        text = ", ".join(stage.name for stage in stages)
        for number, line in enumerate(textwrap.wrap(text, max(10, self.width - 4))):
            self.add((f" {' ' if number else sign} ", look), (line, "dim"))

    def label(self, name: str, text: str) -> None:
        """Add a named text on one line."""
        self.add((f" {name:<{_LABEL}} ", "dim"), (text, ""))

    def figure(self, name: str, *pieces: str) -> None:
        """Add a named figure, wrapped without breaking pieces that fit on a line."""
        room, text = max(10, self.width - _LABEL - 2), " ".join(pieces)
        if len(text) <= room:  # the usual case, at every refresh
            self.label(name, text)
            return
        tied = " ".join(piece.replace(" ", _TIED) for piece in pieces)
        for number, line in enumerate(textwrap.wrap(tied, room)):
            self.label("" if number else name, line.replace(_TIED, " ").rstrip())

    def ledger(self, title: str, rows: Sequence[tuple[str, int, str, str]]) -> None:
        """Add counts, one a line.

        Args:
            rows: name, count, style if the count is not 0, and a remark for each line.
        """
        self.add((f" {title}", "head"))
        name_width = max(_LABEL, *(len(name) for name, _, _, _ in rows)) + 1
        for name, count, look, behind in rows:
            number = f"{formats.thousands(count):>9}"
            self.add((f" {name:<{name_width}}", "dim"), (number, look if count else "dim"), (behind, ""))


def detail_lines(row: Row, peer: str, width: int, now: float) -> list[Line]:
    """Lay out the details of a topic, a service, an action, parameters or a pattern.

    Args:
        peer: the other side's name or address.
        width: width of the pane in cells.
        now: s since the epoch, of the snapshot.
    """
    page = _Page(width)
    if isinstance(row, PatternRow):
        _pattern(page, row)
    elif row.calls is None:
        _topic(page, row, peer, now)
    else:
        _called(page, row, row.calls, peer, now)
    return page.lines


def _pattern(page: _Page, row: PatternRow) -> None:
    page.add(_state(row.state))
    _fault(page, row)
    page.add()
    page.label("here", row.topic)
    page.label("there", row.remote_topic)
    page.label("bridges", f"{row.routes} now")
    for at, name in enumerate(row.spec.excepts):
        page.label("" if at else "except", name)
    if row.type_name:
        page.figure("only", row.type_name)
    page.add()
    page.text("Each name that matches has a line of its own in the table.", "dim")


def _topic(page: _Page, route: RouteSnapshot, peer: str, now: float) -> None:
    _heading(page, route, "message", now)
    _crossing(page, route, f"{OUT} to {peer}" if route.outgoing else f"{IN} from {peer}")
    page.add()
    _stages(page, route, DetailText.WHY_NOT_FLOWING(), DetailText.NOTHING_COMES())
    page.add()
    _plot(page, route, "Rate", "Hz")
    page.add()
    ledger, limit = route.ledger, route.max_rate
    # The share leaves out messages dropped on purpose, and those that may have arrived.
    due = ledger.offered - ledger.throttled - ledger.unknown - ledger.open
    waited = "" if ledger.waiting_since is None else f"  oldest {formats.age_since(ledger.waiting_since, now)}"
    rows = [
        ("offered", ledger.offered, "", ""),
        ("delivered", ledger.delivered, "", _share(ledger.delivered, due)),
        ("throttled", ledger.throttled, "", f"  limit {limit:g} Hz" if limit else ""),
        ("expired", ledger.expired, "stale", f"  limit {route.max_age:g} s" if route.max_age else ""),
        *([("waiting", ledger.waiting, "", waited)] if ledger.waiting else []),
        ("in flight", ledger.in_flight, "", ""),
        ("dropped", ledger.dropped_total, "down", ""),
        *((f"  {cause}", count, "down", "") for cause, count in ledger.dropped.items() if count),
        *([("unknown", ledger.unknown, "stale", "  the other side died")] if ledger.unknown else []),
        ("lost in DDS", ledger.lost_in_dds, "stale", ""),
        *([("missed while down", ledger.missed_while_down, "stale", "")] if ledger.missed_while_down else []),
        *([("not subscribed", ledger.unsubscribed, "", "  before, or paused")] if ledger.unsubscribed else []),
    ]
    page.ledger("Ledger", rows)
    page.add()
    _throughput(page, route)
    if route.latency_p50 is not None and route.latency_p99 is not None:
        uncertain = [] if route.latency_uncertainty is None else [f"± {formats.span(route.latency_uncertainty)}"]
        p50, p99 = (formats.latency(at, route.latency_uncertainty) for at in (route.latency_p50, route.latency_p99))
        page.figure("latency", f"p50 {p50} ", f"p99 {p99}", *uncertain)
    if route.jitter is not None:
        page.figure("jitter", formats.span(route.jitter))
    if route.qos is not None:
        page.figure("QoS", *formats.qos_parts(route.qos))
    ends = (
        ("publishers", "offer", route.publishers, route.publisher_qos),
        ("subscribers", "ask for", route.subscribers, route.subscriber_qos),
    )
    for name, verb, nodes, qos in ends:
        if qos is not None:
            who = [f"{node}," for node in nodes]
            page.figure(name, *who, verb, *formats.qos_parts(qos, depth_known=False))
    _hash_and_error(page, route)


def _called(page: _Page, route: RouteSnapshot, calls: CallsSnapshot, peer: str, now: float) -> None:
    """Lay out the details of a service, an action or parameters."""
    _heading(page, route, "call", now)
    _crossing(page, route, f"{OUT} answered by {peer}" if route.outgoing else f"{IN} called by {peer}")
    page.add()
    _stages(page, route, DetailText.WHY_NO_ANSWER(), "and it does not answer now")
    if calls.last_failure:
        page.add()
        page.add((" Last failure", "head"))
        page.text(calls.last_failure, "stale")
    if route.goals:
        page.add()
        _goals(page, route.goals)
    page.add()
    _plot(page, route, "Calls", "a second")
    page.add()
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
    page.ledger("Ledger of calls", rows)
    if calls.late:
        page.add(("   apart from these: ", "dim"), (formats.counted(calls.late, "late answer"), "stale"))
    page.add()
    delays = (
        ("far node" if route.outgoing else "node here", calls.node_p50, calls.node_p99, ""),
        ("the way", calls.way_p50, calls.way_p99, ", there and back"),
    )
    for name, p50, p99, what in delays:
        if p50 is not None and p99 is not None:
            page.figure(name, f"p50 {formats.span(p50)} ", f"p99 {formats.span(p99)}{what}")
    page.label("given up", DetailText.GIVEN_UP(timeout=route.spec.call_timeout))
    _throughput(page, route)
    for name, nodes in (("callers", route.publishers), ("providers", route.subscribers)):
        if nodes:
            page.figure(name, *(f"{node}," for node in nodes[:-1]), nodes[-1])
    _hash_and_error(page, route)


def _goals(page: _Page, goals: Sequence[GoalSnapshot]) -> None:
    """Add the goals: pending ones first, in order of arrival."""
    under_way = sum(goal.state not in (*_OVER, _NOT_KNOWN) for goal in goals)
    page.add((" Goals", "head"), (f"  {under_way} under way", "strong"))
    for goal in goals[:_MOST_GOALS]:
        sign, look = _OVER.get(goal.state, (UNKNOWN if goal.state == _NOT_KNOWN else UNDER_WAY, "waiting"))
        since = f" since {formats.time_of_day(goal.since)}"
        page.add((f" {sign} ", look), (goal.state, "" if goal.state in _OVER else "strong"), (since, "dim"))
        waits = ", its caller waits" if goal.result_awaited else ""
        page.text(f"{goal.id[:_ID_LENGTH]}  {formats.counted(goal.feedbacks, 'feedback')}{waits}", "dim")
    if len(goals) > _MOST_GOALS:
        page.add((f"   and {len(goals) - _MOST_GOALS} more", "dim"))


def _heading(page: _Page, route: RouteSnapshot, last: str, now: float) -> None:
    """Add the state, the arming and the reason of a fault.

    Args:
        last: word for the last arrival: ``message``.
    """
    ago = "" if route.last_at is None or now - route.last_at < 1 else formats.age_of(route.last_at, now)
    page.add(_state(route.state), (ago and f" last {last} {ago} ago", "dim"))
    arming = route.arming
    if arming is not None and arming.armed:
        left = "" if arming.left is None else f" {arming.left:.0f} s"
        page.add((f" {ARMED} {ARMED_WORD}{left} ", "armed"))
        until = "it is disarmed, the link drops or that console ends"
        if arming.deadman:
            until = f"no key is pressed on that console for {arming.deadman:g} s"
        page.text(f"{arming.by}, until {until}", "")
    if arming is not None and arming.demanded_by:
        page.text(f"has to be armed: {', '.join(arming.demanded_by)}", "dim")
    if arming is not None and arming.on_end:
        if route.calls is not None:
            end = "its goals are cancelled" if arming.on_end == END_CANCEL else "its goals go on"
        else:
            end = f"the robot gets {'nothing' if arming.on_end == END_NONE else arming.on_end}"
        page.text(f"when that ends, {end}", "dim")
    if route.limits is not None:
        page.text(f"at most {route.limits} by hand: {', '.join(route.limited_by)}", "dim")
    if route.drivers:
        page.text(f"published by {', '.join(map(formats.driver, route.drivers))}", "")
    _fault(page, route, next((stage.detail for stage in route.stages if not stage.done), ""))


def _state(of: State) -> tuple[str, str]:
    """Return the piece of a line that shows a state."""
    return f" {STATE_SIGN[of]} {STATE_WORD[of]} ", of.value


def _fault(page: _Page, row: Row, elsewhere: str = "") -> None:
    """Add the acknowledgement and the reason of a fault, unless the details give that elsewhere."""
    if row.acknowledged is not None:
        page.text(acknowledged_by(row.acknowledged), "dim")
    if row.reason and row.reason != elsewhere:
        page.text(row.reason, row.state.value)


def acknowledged_by(record: Acknowledgement) -> str:
    """Return a note on the operator who has acknowledged a fault, and the time."""
    return f"acknowledged by {record.by} at {formats.time_of_day(record.at)}, until it changes"


def _crossing(page: _Page, route: RouteSnapshot, way: str) -> None:
    """Add the type, the direction, the transport, the name on the other side and the pattern.

    Args:
        way: direction and peer in words.
    """
    # Parameters have ROS's own types.
    unknown = DetailText.ALL_PARAMETERS if route.spec.kind == "parameters" else DetailText.UNKNOWN_TYPE
    page.add((f" {formats.known_type(route) or unknown()}", "strong" if route.type_name else "dim"))
    carrier = route.transport.upper()
    if route.port:
        carrier += f" {'channel' if route.transport == 'bluetooth' else 'port'} {route.port}"
    towards = (f" {way}", ""), (f"  {carrier}", "dim")
    if width_of(towards) <= page.width:
        page.add(*towards)
    else:
        page.add(towards[0])
        page.add((f"   {carrier}", "dim"))
    if route.remote_topic and route.remote_topic != route.topic:
        page.add((f"   there: {route.remote_topic}", "dim"))
    if route.pattern:
        page.add((f"   matches {route.pattern}", "dim"))
    for _, text in facts_of(route):
        page.text(text, "dim")


def _stages(page: _Page, route: RouteSnapshot, question: str, nothing: str) -> None:
    """Add the stages: those passed on one line, the first that fails with its reason, and the others on one line.

    Args:
        question: question that they answer if it does not work.
        nothing: text for a route that passed all stages but no longer works.
    """
    waiting = [stage for stage in route.stages if not stage.done]
    page.add((" Stages" if route.state.flows else f" {question}", "head"))
    if not waiting:
        passed = f"all {len(route.stages)} passed"
        if carries(route) and not route.state.flows:
            page.add((f" {UNKNOWN} ", route.state.value), (f"{passed} before", ""))
            page.text(nothing, "")
        else:
            page.add((f" {DONE} ", "ok"), (passed, ""))
        return
    # A failed stage explains more than an earlier one without a result.
    failed = next((stage for stage in waiting if stage.done is False), waiting[0])
    page.names(DONE, "ok", [stage for stage in route.stages if stage.done])
    sign, look = (UNKNOWN, "waiting") if failed.done is None else (FAILED, "down")
    page.add((f" {sign} ", look), (failed.name, "strong"))
    page.text(failed.detail, look)
    page.names(UNKNOWN, "dim", [stage for stage in waiting if stage is not failed])


def _plot(page: _Page, route: RouteSnapshot, title: str, unit: str) -> None:
    """Add the present rate and a curve of the last seconds."""
    # A route keeps the last 120 s, two of which take a cell.
    cells = max(1, min(page.width - 2 - _AXIS, 60))
    shown = route.history[-2 * cells :]
    usual = route.expected_rate if route.calls is None else None  # nobody expects calls
    top = 1.2 * max(usual or 0.0, *shown, 1.0) if shown else 1.0
    highest = formats.limit(route) if route.calls is None else None
    expected = "" if usual is None else f" of {formats.expected(usual)}"
    if highest is not None:
        expected = f" of {formats.expected(highest)} allowed"
    page.add(
        (f" {title}", "head"),
        (f"  {formats.hertz(present_rate(route)) if carries(route) else '-'} {unit}{expected}", "strong"),
        (f"  last {2 * cells} s", "dim"),
    )
    numbers = {0: formats.hertz(top), _PLOT_HEIGHT - 1: formats.hertz(0)}
    for number, line in enumerate(braille_plot(shown, cells, _PLOT_HEIGHT, top)):
        sign = "┤" if number in numbers else "│"
        page.add((f"{numbers.get(number, ''):>{_AXIS}}{sign}", "dim"), (line, "plot"))


def _share(part: int, whole: int) -> str:
    """Format a part in percent, or return an empty string if the whole is 0."""
    return f"  {100 * part / whole:.1f} %" if whole > 0 else ""


def _throughput(page: _Page, route: RouteSnapshot) -> None:
    total = f"{formats.thousands(route.bytes_total)} in all"
    page.figure("bytes", f"{formats.byte_rate(route.bytes_per_second)},", total)


def _hash_and_error(page: _Page, route: RouteSnapshot) -> None:
    if route.type_hash:
        page.label("type hash", route.type_hash)  # cut: its beginning is enough to tell two hashes apart
    if route.last_error:
        words = route.last_error.split()
        page.figure("last error", *words, f"(at {formats.time_of_day(route.last_error_at)})")

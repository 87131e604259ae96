"""The details of one topic: why it does not flow, its rate, and where its messages went."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from rsb_bridge.model.qos import AUTO
from rsb_console.actions.registry import Group, bindings
from rsb_console.look import formats
from rsb_console.look.glyphs import DONE, FAILED, IN, OUT, STATE_SIGN, STATE_WORD, UNKNOWN, braille_plot
from rsb_console.widgets.lines import Line, LiveLines, fit, width_of
from rsb_console.widgets.topics import carries, present_rate

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.snapshot import Ledger, RouteSnapshot, Stage

PLOT_HEIGHT = 4
LABEL = 11  # cells of a figure's name
TIED = "\N{NO-BREAK SPACE}"


class DetailPane(LiveLines, can_focus=True):
    """Shows the topic under the table's cursor. It has no cursor of its own: a list's keys scroll it."""

    BINDINGS = bindings(Group.MOVE)

    def __init__(self) -> None:
        super().__init__(id="detail")
        self._lines: list[Line] = []
        self._route: RouteSnapshot | None = None
        self._peer = ""

    @property
    def line_count(self) -> int:
        """How many lines the topic's details take."""
        return len(self._lines)

    def line(self, index: int) -> Line:
        return self._lines[index]

    def show(self, route: RouteSnapshot | None, peer: str = "") -> None:
        """Show a topic. If it is another one than before, scroll to its first line.

        Args:
            route: the topic's route; None: no topic is selected.
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
        super().on_resize()
        self.show(self._route, self._peer)


def detail_lines(route: RouteSnapshot, peer: str, width: int) -> Iterator[Line]:
    """Lay out the details of a topic.

    Args:
        route: the topic's route.
        peer: the other side's name or address.
        width: of the pane, cells.
    """
    yield from _heading(route, peer, width)
    yield ()
    yield from _stages(route, width)
    yield ()
    yield from _plot(route, width)
    yield ()
    yield from _ledger(route.ledger, route.spec.max_rate)
    yield ()
    yield from _figures(route, width)


def _heading(route: RouteSnapshot, peer: str, width: int) -> Iterator[Line]:
    look = route.state.value
    yield (
        (f" {STATE_SIGN[route.state]} {STATE_WORD[route.state]} ", look),
        ("" if route.age is None or route.age < 1 else f" last message {formats.age(route.age)} ago", "dim"),
    )
    failed = next((stage.detail for stage in route.stages if not stage.done), "")
    if route.reason and route.reason != failed:
        yield from _wrapped(route.reason, width, look)
    asked_for = "type not known yet" if route.spec.type == AUTO else f"{route.spec.type} (as configured)"
    yield ((f" {route.type_name or asked_for}", "strong" if route.type_name else "dim"),)
    way = f"{OUT} to" if route.outgoing else f"{IN} from"
    carrier = f"{route.transport.upper()} {'channel' if route.transport == 'bluetooth' else 'port'} {route.port}"
    towards: Line = ((f" {way} {peer}", ""), (f"  {carrier}", "dim"))
    yield from (towards,) if width_of(towards) <= width else (towards[:1], ((f"   {carrier}", "dim"),))
    if route.remote_topic and route.remote_topic != route.topic:
        yield ((f"   there: {route.remote_topic}", "dim"),)


def _stages(route: RouteSnapshot, width: int) -> Iterator[Line]:
    """The stages: those passed on one line, the first that fails with its reason, and the others on one line."""
    stages = route.stages
    waiting = [index for index, stage in enumerate(stages) if not stage.done]
    at = next((index for index in waiting if stages[index].done is False), next(iter(waiting), None))
    yield ((" Stages" if route.state.flows else " Why it isn't flowing", "head"),)
    if at is None:
        passed = f"all {len(stages)} passed"
        if carries(route) and not route.state.flows:
            yield ((f" {UNKNOWN} ", route.state.value), (f"{passed} before", ""))
            yield from _wrapped("and nothing comes now", width, "")
        else:
            yield ((f" {DONE} ", "ok"), (passed, ""))
        return
    failed = stages[at]
    yield from _listed(DONE, "ok", [stage for stage in stages if stage.done], width)
    sign, look = (UNKNOWN, "waiting") if failed.done is None else (FAILED, "down")
    yield ((f" {sign} ", look), (failed.name, "strong"))
    yield from _wrapped(failed.detail, width, look)
    yield from _listed(UNKNOWN, "dim", [stages[index] for index in waiting if index != at], width)


def _listed(sign: str, look: str, stages: Sequence[Stage], width: int) -> Iterator[Line]:
    names = ", ".join(stage.name for stage in stages)
    for number, text in enumerate(textwrap.wrap(names, max(10, width - 4))):
        yield ((f" {' ' if number else sign} ", look), (text, "dim"))


def _wrapped(text: str, width: int, look: str) -> Iterator[Line]:
    for line in textwrap.wrap(text, max(10, width - 3)):
        yield ((f"   {line}", look),)


def _plot(route: RouteSnapshot, width: int) -> Iterator[Line]:
    cells = max(1, min(width - 2, 60))
    shown = route.history[-2 * cells :]
    top = 1.2 * max(route.expected_rate or 0.0, *shown, 1.0) if shown else 1.0
    expected = "" if route.expected_rate is None else f" of {formats.expected(route.expected_rate)}"
    yield (
        (" Rate", "head"),
        (f"  {formats.hertz(present_rate(route)) if carries(route) else '-'} Hz{expected}", "strong"),
        (f"  last {2 * cells} s", "dim"),
    )
    for line in braille_plot(shown, cells, PLOT_HEIGHT, top):
        yield ((f" {line}", "plot"),)


def _ledger(ledger: Ledger, limit: float | None) -> Iterator[Line]:
    """The ledger. What an operator has left out on purpose (`limit`, Hz) is no share of what should be delivered."""
    yield ((" Ledger", "head"),)
    due = ledger.offered - ledger.throttled
    rows = [
        ("offered", ledger.offered, ""),
        ("delivered", ledger.delivered, ""),
        ("throttled", ledger.throttled, ""),
        ("expired", ledger.expired, "stale"),
        ("in flight", ledger.in_flight, ""),
        ("dropped", ledger.dropped_total, "down"),
        *((f"  {cause}", count, "down") for cause, count in ledger.dropped.items() if count),
        ("lost in DDS", ledger.lost_in_dds, "stale"),
    ]
    name_width = max(LABEL, *(len(name) for name, _, _ in rows)) + 1
    for name, count, look in rows:
        share = ""
        if name == "delivered" and due > 0:
            share = f"  {100 * count / due:.1f} %"
        elif name == "throttled" and limit:
            share = f"  limit {limit:g} Hz"
        yield (
            (f" {name:<{name_width}}", "dim"),
            (f"{formats.thousands(count):>9}", look if count else "dim"),
            (share, ""),
        )


def _figures(route: RouteSnapshot, width: int) -> Iterator[Line]:
    total = f"{formats.thousands(route.bytes_total)} in all"
    yield from _figure("bytes", [f"{formats.byte_rate(route.bytes_per_second)},", total], width)
    if route.latency_p50 is not None and route.latency_p99 is not None:
        uncertain = [] if route.latency_uncertainty is None else [f"± {formats.span(route.latency_uncertainty)}"]
        p50, p99 = (formats.latency(at, route.latency_uncertainty) for at in (route.latency_p50, route.latency_p99))
        yield from _figure("latency", [f"p50 {p50} ", f"p99 {p99}", *uncertain], width)
    if route.jitter is not None:
        yield from _figure("jitter", [formats.span(route.jitter)], width)
    if route.qos is not None:
        yield from _figure("QoS", qos_parts(route.qos), width)
    if route.publisher_qos is not None:
        who = [f"{name}," for name in route.publishers]
        yield from _figure("publishers", [*who, "offer", *qos_parts(route.publisher_qos, depth_known=False)], width)
    if route.subscriber_qos is not None:
        who = [f"{name}," for name in route.subscribers]
        yield from _figure("subscribers", [*who, "ask for", *qos_parts(route.subscriber_qos, depth_known=False)], width)
    if route.type_hash:
        yield _named("type hash", route.type_hash)  # cut: its beginning is enough to tell two hashes apart
    if route.last_error:
        yield from _figure("last error", route.last_error.split(), width)


def _figure(name: str, pieces: Sequence[str], width: int) -> Iterator[Line]:
    """A named figure, wrapped to the pane's width. A piece that fits on a line is not broken."""
    room = max(10, width - LABEL - 2)
    text = " ".join(pieces)
    if len(text) <= room:  # the usual case, at every refresh
        yield _named(name, text)
        return
    tied = " ".join(piece.replace(" ", TIED) for piece in pieces)
    for number, line in enumerate(textwrap.wrap(tied, room)):
        yield _named("" if number else name, line.replace(TIED, " ").rstrip())


def _named(name: str, text: str) -> Line:
    return ((f" {name:<{LABEL}} ", "dim"), (text, ""))


def qos_parts(qos: Qos, *, depth_known: bool = True) -> list[str]:
    """Format a QoS as pieces of a list: ``reliable,`` ``volatile,`` ``last 10``.

    Args:
        qos: to format. A depth of 0 means that the bridge chooses it: from the topic's rate, or on a latched topic from
            what its publishers keep.
        depth_known: False leaves out history and depth.
    """
    parts = [qos.reliability.replace("_", " "), qos.durability.replace("_", " ")]
    if depth_known:
        parts.append("all" if qos.history == "keep_all" else f"last {qos.depth}" if qos.depth else "auto depth")
    if qos.deadline:
        parts.append(f"deadline {formats.span(qos.deadline)}")
    if qos.lifespan:
        parts.append(f"lifespan {formats.span(qos.lifespan)}")
    return [f"{each}," for each in parts[:-1]] + parts[-1:]

"""The bars of the main screen: the status of engine and links at the top, the keys at the bottom."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model import faults
from rsb_bridge.model.snapshot import State
from rsb_console.notation import formats
from rsb_console.notation.glyphs import ACK_WORD, ARMED, ARMED_WORD, STATE_SIGN, STATE_WORD, sparkline
from rsb_console.widgets.lines import Line, LiveLines, fit, width_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from textual import events

    from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot, Snapshot

HISTORY = 6  # s
_BETWEEN = " │ "
ROOMY = 100  # cells from which on there is room for small charts


@dataclass(frozen=True, slots=True)
class BarState:
    """The console's own state, as the status bar shows it."""

    session: str = ""  # the file's name, or empty if the session is not saved
    refresh: float = 4.0  # Hz
    frozen_since: float | None = None  # s since the epoch, or None while the view is live
    readonly: bool = False
    note: str = ""  # in place of the link's state while no engine runs
    way_on: str = ""  # the step that starts an engine that does not run
    attached: bool = False  # the engine runs in another process
    late: str = ""  # how late the operator's line is, and what to do


class StatusBar(LiveLines):
    """The two lines of the status bar. They count all topics, even if the table's filter hides some."""

    can_focus = False

    def __init__(self) -> None:
        super().__init__(id="status")
        self._identity: list[tuple[int, tuple[str, str]]] = []
        self._view: Line = ()
        self._shown_narrow = 1  # pieces of the view, from its end, that a narrow screen shows
        self._totals: list[Line] = []
        self._needed = 1  # totals that must have room for states to be named
        self._signs: Line = ()
        self._received: deque[float] = deque(maxlen=HISTORY)
        self._sent: deque[float] = deque(maxlen=HISTORY)
        self._sampled = 0.0

    @property
    def line_count(self) -> int:
        return 2

    def line(self, index: int) -> Line:
        width = self.width
        if index == 0:
            right = self._view if width >= ROOMY else self._view[-self._shown_narrow :]
            for most in reversed(range(6)):
                left = tuple(piece for number, piece in self._identity if number <= most)
                if width_of(left) + width_of(right) < width:
                    break
            return _spread(left, right, width)
        needed = self._totals[: self._needed]
        fits = sum(map(width_of, needed)) + len(_BETWEEN) * (len(needed) - 1) <= width
        return _as_many(self._totals if fits else [self._signs, *self._totals[1:]], width)

    def show(self, snapshot: Snapshot, view: BarState) -> None:
        # Once a second at any refresh rate: a cell is a second.
        if snapshot.running and snapshot.time - self._sampled >= 1.0:
            self._sampled = snapshot.time
            self._received.append(sum(link.rx_bytes_per_second for link in snapshot.links))
            self._sent.append(sum(link.tx_bytes_per_second for link in snapshot.links))
        self._identity, self._view = _identity(snapshot, view), _view(snapshot, view)
        self._shown_narrow = 1 + bool(_unsaved(snapshot))
        self._totals = self._sum(snapshot)
        self.sync()

    def _sum(self, snapshot: Snapshot) -> list[Line]:
        topics = ((f" {formats.counted_kinds(route.spec.kind for route in snapshot.routes)}", "strong"),)
        armed, known = armed_count(snapshot.routes), acknowledged_count(snapshot.routes)
        self._signs = (*topics, *armed, *state_counts(snapshot.routes, State), *known)
        # Calls have counts of their own: a call that fails is no lost message.
        lost = sum(route.ledger.lost for route in snapshot.routes if route.calls is None)
        groups: list[Line] = [
            (*topics, *armed, *state_counts(snapshot.routes, State, words=True), *known),
            ((f"drops {formats.thousands(lost)}", "stale" if lost else ""),),
        ]
        groups += calls_group(snapshot.routes)
        # Failed calls must not give way to the names of states.
        self._needed = len(groups) if len(groups) > 2 else 1
        rtts = [link.rtt for link in snapshot.links if link.rtt is not None]
        if rtts:
            groups.append(((f"rtt {formats.span(max(rtts))}", ""),))
        groups += [((way, ""),) for link in snapshot.links if link.ways and (way := formats.via(link))]
        if loss := formats.loss(snapshot.links):
            groups.append(((f"loss {loss}", State.SLOW.value),))
        for name, history in (("RX", self._received), ("TX", self._sent)):
            if history:
                bars = sparkline(list(history), HISTORY)
                groups.append(((f"{name} {formats.byte_rate(history[-1]):>8} ", ""), (bars, "plot")))
        return groups


def state_counts(
    things: Iterable[RouteSnapshot | LinkSnapshot], states: Iterable[State], *, words: bool = False
) -> Line:
    """Count the things in each of some states: ``✗1 ▲2``, or with words ``✗ 1 down  ▲ 2 stale``.

    Acknowledged faults do not count.
    """
    counts = faults.state_counts(things)
    return tuple(
        (f"  {STATE_SIGN[s]} {counts[s]} {STATE_WORD[s].lower()}" if words else f" {STATE_SIGN[s]}{counts[s]}", s.value)
        for s in states
        if s in counts
    )


def calls_group(routes: Iterable[RouteSnapshot]) -> list[Line]:
    """Count the open calls and the unanswered ones. Show nothing if no service is bridged."""
    counts = [route.calls for route in routes if route.calls is not None]
    if not counts:
        return []
    failed = sum(map(formats.unanswered, counts))
    under_way = formats.counted(sum(calls.in_flight for calls in counts), "call")
    return [((f"{under_way} under way, ", ""), (f"{formats.thousands(failed)} failed", "stale" if failed else ""))]


def armed_count(routes: Iterable[RouteSnapshot]) -> Line:
    """Count the armed topics, with the time until the first of them disarms: ``◆ 1 ARMED 42 s``."""
    armed = [route.arming for route in routes if route.arming is not None and route.arming.armed]
    left = min((each.left for each in armed if each.left is not None), default=None)
    until = "" if left is None else f" {left:.0f} s"
    return (("  ", ""), (f" {ARMED} {len(armed)} {ARMED_WORD}{until} ", "armed")) if armed else ()


def acknowledged_count(things: Iterable[RouteSnapshot | LinkSnapshot]) -> Line:
    """Count the acknowledged faults: ``ack 1``."""
    count = sum(thing.acknowledged is not None for thing in things)
    return ((f"  {ACK_WORD} {count}", "dim"),) if count else ()


def warning_count(links: Iterable[LinkSnapshot]) -> Line:
    """Count the links that are up with a warning: ``!1``."""
    count = sum(1 for link in links if link.state is State.OK and link.warning and link.acknowledged is None)
    return ((f" !{count}", State.SLOW.value),) if count else ()


def _as_many(groups: list[Line], width: int) -> Line:
    """Join as many groups as fit, at least the first. On a narrow screen their charts are left out."""
    line: Line = ()
    for group in groups:
        shown = tuple(piece for piece in group if width >= ROOMY or piece[1] != "plot")
        longer = (*line, (_BETWEEN, "dim"), *shown) if line else shown
        if line and width_of(longer) > width:
            break
        line = longer
    return fit(line, width)


def _identity(snapshot: Snapshot, view: BarState) -> list[tuple[int, tuple[str, str]]]:
    """Return the link's name and state in pieces; pieces with the highest number are left out first."""
    if not snapshot.name:
        return [(0, (" rsb-console", "strong")), (0, (f"  {view.note}", "dim"))]
    state = [(f"   {view.note}", "alarm")] if view.note else link_state(snapshot, view.way_on)
    return [
        (5, (" rsb-console", "strong")),
        (4, (f"  {snapshot.role}", "dim")),
        (0, (f" {snapshot.name}", "strong")),
        *((0, piece) for piece in _warnings(snapshot)),
        (1, (f" ⇄ {snapshot.address}", "")),
        *zip((0, 2), state, strict=False),
        (3, (f"   domain {snapshot.domain_id}", "dim")),
    ]


def link_state(snapshot: Snapshot, way_on: str) -> list[tuple[str, str]]:
    """Return the state of the link, or how many of a server's links are up, and whether they are encrypted."""
    if not snapshot.running:
        return [(f"   ✗ STOPPED{f': {way_on}' if way_on else ''}", "down")]
    if not snapshot.links:
        return [("   ◌ no client yet", "waiting")]
    # With one link in the clear, nothing is called encrypted.
    return [_links_state(snapshot.links, snapshot.time), ("  encrypted ✓", "dim")][: 1 if _warnings(snapshot) else 2]


def _warnings(snapshot: Snapshot) -> list[tuple[str, str]]:
    """Warnings that are shown however narrow the screen is."""
    if all(link.encrypted for link in snapshot.links):
        return []
    return [(" ", ""), (" NOT ENCRYPTED ", "alarm")]


def _links_state(links: Sequence[LinkSnapshot], now: float) -> tuple[str, str]:
    if len(links) > 1:
        worst = next(state for state in State if any(link.state is state for link in links))
        linked = sum(link.state is State.OK for link in links)
        return f"   {STATE_SIGN[worst]} {linked} of {len(links)} linked", worst.value
    (link,) = links
    if link.state is State.OK:
        # Both cut to whole seconds, as in `formats.age_since`.
        return f"   ● LINKED {formats.clock(math.floor(now) - math.floor(link.since))}", "ok"
    retry = formats.next_attempt(link, now)
    state, since = link.state, formats.age_since(link.since, now)
    return f"   {STATE_SIGN[state]} {STATE_WORD[state]} {since}{retry and f' · {retry}'}", state.value


def _view(snapshot: Snapshot, view: BarState) -> Line:
    pieces = []
    if view.readonly:
        pieces.append(("read-only  ", "paused"))
    if view.attached:
        pieces.append(("attached  ", "dim"))
    if view.session and view.session != snapshot.name:
        pieces.append((f"{view.session} · ", "dim"))
    if unsaved := _unsaved(snapshot):
        pieces.append((f"● {unsaved}  ", "stale"))
    if view.late:
        pieces.append((f" {view.late} ", "alarm"))
    elif view.frozen_since is None:
        pieces.append((f"LIVE {view.refresh:g} Hz ", "dim"))
    else:
        pieces.append((f" VIEW FROZEN {formats.clock(snapshot.time - view.frozen_since)} ", "alarm"))
    return tuple(pieces)


def _unsaved(snapshot: Snapshot) -> str:
    if snapshot.unsaved:
        return "unsaved"
    return f"unsaved on {there}" if (there := formats.unsaved_there(snapshot)) else ""


def _spread(left: Line, right: Line, width: int) -> Line:
    """Put two parts at the two edges. If both do not fit, the end of the left one is cut."""
    room = width - width_of(right)
    cut = fit(left, max(1, room - 1))
    return (*cut, (" " * (room - width_of(cut)), ""), *right)


class KeyEntry(NamedTuple):
    """One key."""

    key: str  # its name for people
    label: str
    action: str  # that a click runs
    rank: int  # order on a narrow screen, lower ranks first
    counts: Line = ()  # after the label, or in its place on a screen without room for both


class KeyBar(LiveLines):
    """Keys and labels, in the registry's order; a click does it."""

    can_focus = False

    def __init__(self) -> None:
        super().__init__(id="keys")
        self._entries: Sequence[KeyEntry] = ()

    @property
    def line_count(self) -> int:
        return 1

    def show(self, entries: Sequence[KeyEntry]) -> None:
        self._entries = entries
        self.sync()

    def line(self, index: int) -> Line:
        return tuple(piece for _, pieces in self._fitting() for piece in pieces)

    def _fitting(self) -> list[tuple[KeyEntry, Line]]:
        """Return the entries that fit, with labels and counts if all fit that way."""
        whole = [(entry, _pieces(entry, entry.label)) for entry in self._entries]
        if sum(width_of(pieces) for _, pieces in whole) <= self.width:
            return whole
        short = [(entry, _pieces(entry, "" if entry.counts else entry.label)) for entry in self._entries]
        room, fitting = self.width, []
        # A key without room leaves it to shorter ones behind it.
        for index in sorted(range(len(short)), key=lambda index: short[index][0].rank):
            if (width := width_of(short[index][1])) <= room:
                room -= width
                fitting.append(index)
        return [short[index] for index in sorted(fitting)]

    async def on_click(self, event: events.Click) -> None:
        edge = 0
        for entry, pieces in self._fitting():
            edge += width_of(pieces)
            if event.x < edge:
                await self.run_action(entry.action)
                return


def _pieces(entry: KeyEntry, label: str) -> Line:
    return ((f" {entry.key}", "key"), (f" {label}" if label else "", "dim"), *entry.counts, (" ", "dim"))

"""The lines at the top: the links' state, and totals over all topics."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import LinkCause
from rsb_console.look import formats
from rsb_console.look.glyphs import STATE_SIGN, STATE_WORD, sparkline
from rsb_console.widgets.lines import Line, LiveLines, fit, width_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.model.snapshot import LinkSnapshot, Snapshot

HISTORY = 6  # s
ROOMY = 100  # cells from which on there is room for small charts


@dataclass(frozen=True, slots=True)
class View:
    """The console's own state, as the status bar shows it.

    Attributes:
        session: the session file's name; empty: the session is not saved.
        refresh: Hz.
        frozen_since: s since the epoch; None: the view is live.
        readonly: whether actions that change something are disabled.
        note: shown instead of the link's state while no engine runs; empty: an engine runs.
        cause: why the engine ended by itself; empty: not known, or it runs.
        attached: whether the engine runs in another process.
    """

    session: str = ""
    refresh: float = 4.0
    frozen_since: float | None = None
    readonly: bool = False
    note: str = ""
    cause: str = ""
    attached: bool = False


class StatusBar(LiveLines):
    """Both lines. Their counts are of all topics, whatever filter the table has."""

    can_focus = False

    def __init__(self) -> None:
        super().__init__(id="status")
        self._identity: Line = ()
        self._view: Line = ()
        self._totals: list[Line] = []
        self._faults: list[Line] = []
        self._received: deque[float] = deque(maxlen=HISTORY)
        self._sent: deque[float] = deque(maxlen=HISTORY)
        self._sampled = 0.0

    @property
    def line_count(self) -> int:
        return 2 + bool(self._faults)

    def line(self, index: int) -> Line:
        width = self.width
        if index == 0:
            shorter = self._identity[2:] or self._identity[1:]
            for left, right in ((self._identity, self._view), (shorter, self._view)):
                if width >= ROOMY and width_of(left) + width_of(right) < width:
                    return _spread(left, right, width)
            return _spread(shorter, self._view[-1:], width)
        if index == 2:
            more = len(self._faults) - 1
            return _spread(self._faults[0], ((f"  and {more} more (links) " if more else "", "dim"),), width)
        return _as_many(self._totals, width)

    def show(self, snapshot: Snapshot, view: View) -> None:
        if snapshot.running and snapshot.time - self._sampled >= 1.0:
            self._sampled = snapshot.time
            self._received.append(sum(link.rx_bytes_per_second for link in snapshot.links))
            self._sent.append(sum(link.tx_bytes_per_second for link in snapshot.links))
        self._identity, self._view = _identity(snapshot, view), _view(snapshot, view)
        self._totals = self._sum(snapshot)
        self._faults = _link_faults(snapshot)
        self.styles.height = self.line_count
        self.sync()

    def _sum(self, snapshot: Snapshot) -> list[Line]:
        counts = Counter(route.state for route in snapshot.routes)
        topics = tuple(
            (f"  {STATE_SIGN[state]} {counts[state]} {STATE_WORD[state].lower()}", state.value)
            for state in State
            if counts[state]
        )
        drops = sum(route.ledger.dropped_total for route in snapshot.routes)
        groups: list[Line] = [
            ((f" {formats.counted(len(snapshot.routes), 'topic')}", "strong"), *topics),
            ((f"drops {formats.thousands(drops)}", "stale" if drops else ""),),
        ]
        rtts = [link.rtt for link in snapshot.links if link.rtt is not None]
        if rtts:
            groups.append(((f"rtt {formats.span(max(rtts))}", ""),))
        for name, history in (("RX", self._received), ("TX", self._sent)):
            if history:
                bars = sparkline(list(history), HISTORY)
                groups.append(((f"{name} {formats.byte_rate(history[-1]):>8} ", ""), (bars, "plot")))
        return groups


def _as_many(groups: list[Line], width: int) -> Line:
    """Join as many groups as fit, at least the first. On a narrow screen their charts are left out."""
    line: Line = ()
    for group in groups:
        shown = tuple(piece for piece in group if width >= ROOMY or piece[1] != "plot")
        longer = (*line, (" │ ", "dim"), *shown) if line else shown
        if line and width_of(longer) > width:
            break
        line = longer
    return fit(line, width)


def _identity(snapshot: Snapshot, view: View) -> Line:
    if not snapshot.name:
        return ((" rsb-console", "strong"), (f"  {view.note}", "dim"))
    pieces = [
        (" rsb-console", "strong"),
        (f"  {snapshot.role}", "dim"),
        (f" {snapshot.name}", "strong"),
        *_warnings(snapshot),
        (f" ⇄ {snapshot.address}", ""),
    ]
    if view.note:
        pieces.append((f"   {view.note}", "alarm"))
    else:
        pieces += link_state(snapshot, view.cause)
    pieces.append((f"   domain {snapshot.domain_id}", "dim"))
    return tuple(pieces)


def link_state(snapshot: Snapshot, cause: str) -> list[tuple[str, str]]:
    """The state of the link, or how many of a server's links are up, and whether they are encrypted."""
    if not snapshot.running:
        return [(f"   ✗ STOPPED{f': {cause}' if cause else ''}", "down")]
    if not snapshot.links:
        return [("   ◌ no client yet", "waiting")]
    return [_links_state(snapshot.links, snapshot.time), ("  encrypted ✓", "dim")][: 1 if _warnings(snapshot) else 2]


def _warnings(snapshot: Snapshot) -> list[tuple[str, str]]:
    """Warnings that are shown however narrow the screen is."""
    if all(link.encrypted for link in snapshot.links):
        return []
    return [(" ", ""), (" NOT ENCRYPTED ", "alarm")]


def _links_state(links: Sequence[LinkSnapshot], now: float) -> tuple[str, str]:
    linked = [link for link in links if link.state is State.OK]
    if len(links) > 1:
        worst = next(state for state in State if any(link.state is state for link in links))
        return f"   {STATE_SIGN[worst]} {len(linked)} of {len(links)} linked", worst.value
    (link,) = links
    if linked:
        return f"   ● LINKED {formats.clock(now - link.since)}", "ok"
    retry = formats.retry(link.attempts + 1, link.retry_in)
    state = link.state
    return (
        f"   {STATE_SIGN[state]} {STATE_WORD[state]} {formats.age(now - link.since)}{retry and f' · {retry}'}",
        state.value,
    )


def _link_faults(snapshot: Snapshot) -> list[Line]:
    """A line for each link with a fault, the worst first. A single one that waits is told of in the first line."""
    if not snapshot.running:
        return []
    server = snapshot.role == "server"
    single = len(snapshot.links) == 1
    faults = [
        link
        for link in sorted(snapshot.links, key=lambda link: (link.state.rank, link.name))
        if link.warning or not (link.state is State.OK or (single and link.state is State.WAITING))
    ]
    return [
        ((f" {STATE_SIGN[link.state]} {link.name}: ", link.state.value), (link_fault(link, server=server), ""))
        for link in faults
    ]


def link_fault(link: LinkSnapshot, *, server: bool) -> str:
    """Format what is wrong with a link; on a server, who should be there and is not."""
    since = formats.time_of_day(link.since)[:5]
    if link.state is State.OK:
        return link.warning
    if not server or link.cause not in (LinkCause.LOST, LinkCause.CLOSED, LinkCause.NOT_YET):
        return link.reason
    seen = f"last seen at {link.peer}: {link.reason}" if link.peer else "not seen yet"
    return f"missing since {since}, {seen}"


def _view(snapshot: Snapshot, view: View) -> Line:
    pieces = []
    if view.readonly:
        pieces.append(("read-only  ", "paused"))
    if view.attached:
        pieces.append(("attached  ", "dim"))
    if view.session and view.session != snapshot.name:
        pieces.append((f"{view.session} · ", "dim"))
    if view.frozen_since is None:
        pieces.append((f"LIVE {view.refresh:g} Hz ", "dim"))
    else:
        pieces.append((f" VIEW FROZEN {formats.clock(snapshot.time - view.frozen_since)} ", "alarm"))
    return tuple(pieces)


def _spread(left: Line, right: Line, width: int) -> Line:
    """Put two parts at the two edges. If both do not fit, the end of the left one is cut."""
    room = width - width_of(right)
    cut = fit(left, max(1, room - 1))
    return (*cut, (" " * (room - width_of(cut)), ""), *right)

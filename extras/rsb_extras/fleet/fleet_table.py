"""The table of robots with its columns and totals, and the details of the selected robot or group."""

from __future__ import annotations

import textwrap
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import RobotState, State
from rsb_console.feature_console import STATE_SIGN, STATE_WORD, FixedLines, fit, sparkline
from rsb_console.notation import formats
from rsb_console.notation.glyphs import ACK_WORD, KNOWN
from rsb_console.widgets.selectable_list import Column, Order, SortedTable, filled
from rsb_console.widgets.topics import HISTORY, WIDE

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rsb_bridge.feature_api import RobotSummary
    from rsb_console.feature_console import Line, RowFilter
    from rsb_console.widgets.selectable_list import Layout
    from rsb_extras.fleet.fleet import Robot, RobotFleet

ROBOT_SIGN = {
    RobotState.MISSING: "✗",
    RobotState.FAULT: "■",
    RobotState.WARN: "▲",
    RobotState.ACKNOWLEDGED: KNOWN,
    RobotState.WAITING: "◌",
    RobotState.OK: "●",
}
ROBOT_WORD = {state: state.upper() for state in RobotState} | {
    RobotState.ACKNOWLEDGED: ACK_WORD,
    RobotState.OK: "ok",
    RobotState.WAITING: "WAIT",
}
ROBOT_LOOK = {
    RobotState.MISSING: "down",
    RobotState.FAULT: "stale",
    RobotState.WARN: "slow",
    RobotState.ACKNOWLEDGED: "dim",
    RobotState.WAITING: "waiting",
    RobotState.OK: "ok",
}
"""Styles of robots' states, as for topics' states of the same severity."""
LOW_BATTERY = 0.2
HIGH_LOSS = 0.05
"""Shares from which on a cell is coloured. Round figures, not measured: they raise no fault."""


class RobotRow(NamedTuple):
    """A robot as a line of the table.

    Attributes:
        rates: its messages a second, both ways, the oldest first.
        now: s since the epoch.
    """

    robot: Robot
    rates: Sequence[float]
    now: float


def messages(row: RobotRow) -> float:
    """Hz, both ways."""
    return row.robot.summary.messages_from_robot + row.robot.summary.messages_to_robot


def is_there(row: RobotRow) -> bool:
    """Whether its rates have a meaning."""
    return row.robot.summary.links_up > 0


def why(row: RobotRow) -> str:
    """Return the fault of a row, and how many others are acknowledged."""
    summary = row.robot.summary
    beside = summary.acknowledged if summary.state is not RobotState.ACKNOWLEDGED else 0
    return f"{summary.why} (+{beside} {ACK_WORD})" if beside else summary.why


def _since(row: RobotRow) -> float:
    """Return the seconds in the present state or, for a missing robot, since it was last seen."""
    summary = row.robot.summary
    since = summary.since if summary.state is not RobotState.MISSING or summary.seen is None else summary.seen
    return max(0.0, row.now - since)


def percent(share: float) -> str:
    """Format a share of 1 in at most four characters: ``12%``, ``0.3%``, ``0``."""
    return "0" if share == 0 else f"{share:.1%}" if share < 0.00995 else f"{share:.0%}"


def _loss(row: RobotRow) -> float:
    loss = row.robot.summary.loss
    return -1.0 if loss is None else loss.share  # if unknown, behind all others


def _charge(row: RobotRow) -> float:
    battery = row.robot.summary.battery
    return 2.0 if battery is None else battery.charge  # if unknown, behind all others, and not low


def _by_state(row: RobotRow) -> tuple[object, ...]:
    return row.robot.summary.state.rank, row.robot.order


COLUMNS: tuple[Column[RobotRow], ...] = (
    Column(
        "STATE", 9, lambda r: f"{ROBOT_SIGN[r.robot.summary.state]} {ROBOT_WORD[r.robot.summary.state]}", _by_state,
        right=False, from_width=WIDE,
    ),
    Column("", 1, lambda r: ROBOT_SIGN[r.robot.summary.state], _by_state, right=False),
    Column("ROBOT", 0, lambda r: f"{r.robot.summary.name}{' (server)' * r.robot.is_server}", lambda r: r.robot.order,
           right=False, names=True),
    Column("SERVER", 10, lambda r: r.robot.source.name, lambda r: (r.robot.source.name, r.robot.order), right=False,
           from_width=60),
    Column("GROUP", 10, lambda r: r.robot.summary.group, lambda r: (r.robot.summary.group, r.robot.order),
           right=False, from_width=100),
    Column("FLOW", 7, lambda r: f"{r.robot.summary.flowing}/{r.robot.summary.routes}",
           lambda r: r.robot.summary.flowing - r.robot.summary.routes),
    Column("msg/s", 6, lambda r: formats.hertz(messages(r)) if is_there(r) else "-", lambda r: -messages(r),
           from_width=48),
    Column("FROM kB/s", 9, lambda r: formats.kilobytes(r.robot.summary.bytes_from_robot) if is_there(r) else "-",
           lambda r: -r.robot.summary.bytes_from_robot, from_width=78),
    Column("TO kB/s", 7, lambda r: formats.kilobytes(r.robot.summary.bytes_to_robot) if is_there(r) else "-",
           lambda r: -r.robot.summary.bytes_to_robot, from_width=92),
    Column("LOSS", 4, lambda r: "-" if _loss(r) < 0 else percent(_loss(r)), lambda r: -_loss(r), from_width=56),
    Column("BATT", 4, lambda r: "-" if _charge(r) > 1 else f"{_charge(r):.0%}", _charge, from_width=64),
    Column("SINCE", 5, lambda r: formats.age(_since(r)), _since, from_width=40),
    Column(" HISTORY", HISTORY + 1, lambda r: sparkline(r.rates, HISTORY, max(r.rates, default=0.0)),
           lambda r: -sum(r.rates), right=False, from_width=80),
    Column("VERSION", 10, lambda r: r.robot.summary.version, lambda r: (r.robot.summary.version, r.robot.order),
           right=False, from_width=112),
    Column("WHY", 40, why, lambda r: (not r.robot.summary.why, r.robot.summary.why),
           right=False, from_width=150),
)  # fmt: skip
STATE, SIGN, NAME, SERVER, GROUP, LOSS, BATTERY, HISTORY_COLUMN = (
    next(column for column in COLUMNS if column.title == title)
    for title in ("STATE", "", "ROBOT", "SERVER", "GROUP", "LOSS", "BATT", " HISTORY")
)
DIM = frozenset({NAME, SERVER, GROUP})
"""Of a robot that is not there, all columns but these are of before, or empty."""


@cache
def layout(width: int, *, servers: bool, grouped: bool) -> Layout[RobotRow]:
    """Return the columns that fit, each with its width in cells.

    Args:
        servers: robots come from several servers.
        grouped: each group has a heading.
    """
    hidden = {SIGN if width >= WIDE else STATE}
    if not servers:
        hidden.add(SERVER)
    if grouped:
        hidden.add(GROUP)
    return filled([each for each in COLUMNS if each.fits(width, calls=False) and each not in hidden], width)


def _look(column: Column[RobotRow], row: RobotRow) -> str:
    summary = row.robot.summary
    if column in {STATE, SIGN}:
        return ROBOT_LOOK[summary.state]
    if not is_there(row):
        return "" if column in DIM else "dim"
    if (column is LOSS and _loss(row) >= HIGH_LOSS) or (column is BATTERY and _charge(row) <= LOW_BATTERY):
        return "slow"
    return "plot" if column is HISTORY_COLUMN and any(row.rates[-HISTORY:]) else ""


_GROUP = "\0"
"""Before a group's name: the key of its heading."""
_MARKED, _FOLDED, _UNFOLDED = "✓", "▸", "▾"
ROOMY = 100  # cells


@dataclass
class FleetView:
    """The operator's settings of the table. They outlive the screen, which closes while a robot's console is open.

    Attributes:
        cursor: the key under the cursor, or None before it has moved.
        grouped: keep the robots of a group together.
        folded: groups of which only the heading is shown.
        marked: keys of the marked robots.
    """

    cursor: str | None = None
    pattern: RowFilter | None = None
    faults_only: bool = False
    grouped: bool = False
    folded: set[str] = field(default_factory=set)
    marked: set[str] = field(default_factory=set)
    order: Order[RobotRow] = field(default_factory=lambda: Order(STATE))


class FleetTable(SortedTable[RobotRow]):
    """One line for each robot and each group."""

    EDGE = 2  # the cursor, and the mark

    def __init__(self, view: FleetView) -> None:
        super().__init__(view.order, id="fleet", classes="pane")
        self.view = view
        self.rows: dict[str, RobotRow] = {}
        self._groups: dict[str, list[RobotRow]] = {}
        self._servers = False
        self._restore = view.cursor

    # -- what is listed -----------------------------------------------------------------------------------------------

    def show(self, fleet: RobotFleet, now: float) -> None:
        """Show the present state of the robots.

        Args:
            now: s since the epoch.
        """
        before = self.rows
        self.rows = {robot.key: RobotRow(robot, fleet.rates(robot), now) for robot in fleet.robots()}
        self._servers = len(fleet.sources) > 1
        # A robot that has gone, and comes back later, is not among those to change.
        stay = (key for key in self.rows if key not in before or before[key].robot.gone is self.rows[key].robot.gone)
        self.view.marked.intersection_update(stay)
        self.relist()
        if self._restore in self.keys:
            self.move_to(self.keys.index(self._restore))
        self._restore = None  # from then on, the cursor is where the operator moves it

    def relist(self) -> None:
        view = self.view
        shown = [row for row in self.rows.values() if self._wanted(row)]
        shown.sort(key=view.order.column.order, reverse=view.order.reversed)
        self._groups = {}
        if self.grouped:
            for row in shown:
                self._groups.setdefault(row.robot.summary.group, []).append(row)
            # A group keeps its place even if the state of its robots changes; robots without a group come last.
            keys = []
            for group in sorted(self._groups, key=lambda name: (not name, name)):
                keys.append(f"{_GROUP}{group}")
                if group not in view.folded:
                    keys += [row.robot.key for row in self._groups[group]]
        else:
            keys = [row.robot.key for row in shown]
        self.show_keys(keys)

    @property
    def grouped(self) -> bool:
        """Whether there are headings: if that is wanted, and any robot is in a group."""
        return self.view.grouped and any(row.robot.summary.group for row in self.rows.values())

    def _wanted(self, row: RobotRow) -> bool:
        summary, pattern = row.robot.summary, self.view.pattern
        if self.view.faults_only and not summary.state.is_wrong:
            return False
        return pattern is None or pattern.matches(
            {
                "robot": summary.name,
                "group": summary.group,
                "state": ROBOT_WORD[summary.state],
                "why": summary.why,
                "": f"{summary.host} {summary.version} {row.robot.source.name}",
            }
        )

    @property
    def shown(self) -> int:
        """Robots that the filter leaves, folded or not."""
        return sum(map(len, self._groups.values())) if self.grouped else len(self.keys)

    # -- what is selected ---------------------------------------------------------------------------------------------

    @property
    def selected(self) -> Robot | None:
        row = self.rows.get(self.cursor_key or "")
        return None if row is None else row.robot

    @property
    def selected_group(self) -> str | None:
        """The group whose heading is under the cursor."""
        key = self.cursor_key
        return key.removeprefix(_GROUP) if key is not None and key.startswith(_GROUP) else None

    @property
    def described(self) -> tuple[str, list[RobotRow]]:
        """The name under the cursor and its robots, the worst first."""
        if (group := self.selected_group) is not None:
            rows = sorted(self._groups.get(group, ()), key=STATE.order)
            return group or "no group", rows
        row = self.rows.get(self.cursor_key or "")
        return ("", []) if row is None else (row.robot.summary.name, [row])

    @property
    def meant(self) -> list[Robot]:
        """The robots that an action affects: the marked ones, or the one under the cursor, or its group's."""
        if self.view.marked:
            return [row.robot for row in self.rows.values() if row.robot.key in self.view.marked]
        if (group := self.selected_group) is not None:
            return [row.robot for row in self._groups.get(group, ())]
        return [] if self.selected is None else [self.selected]

    def mark(self) -> None:
        """Mark or unmark the robot under the cursor, or all shown robots of a group."""
        if (group := self.selected_group) is not None:
            keys = {row.robot.key for row in self._groups.get(group, ())}
        else:
            keys = set() if self.selected is None else {self.selected.key}
        if keys <= self.view.marked:
            self.view.marked -= keys
        else:
            self.view.marked |= keys
        # To the next robot: several in a row are marked with one key.
        if group is None:
            self.move_to(self.position + 1)
        self.sync()

    def fold(self) -> None:
        """Fold the group under the cursor, or unfold it."""
        if (group := self.selected_group) is not None:
            self.view.folded ^= {group}
            self.relist()

    def is_match(self, key: str) -> bool:
        row = self.rows.get(key)
        return row is not None and (self.view.pattern is not None or row.robot.summary.state.is_wrong)

    # -- how it looks -------------------------------------------------------------------------------------------------

    @property
    def columns(self) -> Layout[RobotRow]:
        return layout(self.width - self.EDGE, servers=self._servers, grouped=self.grouped)

    def row_line(self, key: str, *, cursor: bool) -> Line:
        sign, row = "▌" if cursor else " ", self.rows.get(key)
        if row is None:
            return ((sign, "key"), *self._group(key.removeprefix(_GROUP)))
        mark = _MARKED if key in self.view.marked else " "
        cells = ((column.cell(row, width), _look(column, row)) for column, width in self.columns)
        return ((sign, ROBOT_LOOK[row.robot.summary.state]), (mark, "key"), *cells)

    def _group(self, group: str) -> Line:
        rows = self._groups.get(group, [])
        marked = sum(row.robot.key in self.view.marked for row in rows)
        pieces = [
            (f"{_FOLDED if group in self.view.folded else _UNFOLDED} {group or 'no group'}", "strong"),
            (f"  {formats.counted(sum(not row.robot.is_server for row in rows), 'robot')}", "dim"),
            *state_counts(row.robot for row in rows),
        ]
        if marked:
            pieces.append((f"  {_MARKED} {marked}", "key"))
        return fit(tuple(pieces), self.width - 1)


def state_counts(robots: Iterable[Robot]) -> Line:
    """Return the number of robots in each state, the worst first."""
    counts = Counter(robot.summary.state for robot in robots)
    return tuple(
        (f"  {counts[state]} {ROBOT_SIGN[state]} {ROBOT_WORD[state]}", ROBOT_LOOK[state])
        for state in RobotState
        if counts[state]
    )


def _unheard(summaries: Sequence[RobotSummary]) -> Line:
    """Count the topics that nobody subscribes to, as a robot's console does: they flow, so that their robot is well."""
    count = sum(summary.states.get(State.UNHEARD, 0) for summary in summaries)
    text = f" │ {STATE_SIGN[State.UNHEARD]} {count} {STATE_WORD[State.UNHEARD].lower()}"
    return ((text, State.UNHEARD.value),) if count else ()


class FleetStatus(FixedLines):
    """The number of robots in each state, and below it each source without data."""

    def __init__(self) -> None:
        super().__init__(id="fleet-status")

    def show(self, table: FleetTable, fleet: RobotFleet, *, readonly: bool) -> None:
        """Show the state of all robots, even if the filter hides some."""
        robots = [row.robot for row in table.rows.values()]
        names = ", ".join(source.name for source in fleet.sources)
        # Over Zenoh a server is a line, too: what crosses its links is counted where its clients are.
        servers = [robot for robot in robots if robot.is_server]
        robots = [robot for robot in robots if not robot.is_server]
        clients = [robot.summary for robot in robots]
        rx = sum(summary.bytes_from_robot for summary in clients)
        tx = sum(summary.bytes_to_robot for summary in clients)
        first: Line = (
            (" fleet ", "head"),
            *(((" READ-ONLY ", "waiting"),) if readonly else ()),
            (f" {names} ", "strong"),
            (f" {formats.counted(len(robots), 'robot')}", ""),
            *state_counts(robots),
            *(((f" │ {formats.counted(len(servers), 'server')}", ""), *state_counts(servers)) if servers else ()),
            *_unheard(clients),
            *(
                ((f" │ from {formats.byte_rate(rx)} │ to {formats.byte_rate(tx)}", "dim"),)
                if self.width >= ROOMY
                else ()
            ),
        )
        problems = [
            (("  ✗ ", "down"), (f"{source.name}: {source.problem}", "")) for source in fleet.sources if source.problem
        ]
        self.put([first, *problems])


class RobotDetail(FixedLines):
    """Details for which the table has no room: the cause, and the source of the figures."""

    LINES = 4

    def __init__(self) -> None:
        super().__init__(id="robot-detail", classes="pane")

    def show(self, title: str, rows: Sequence[RobotRow]) -> None:
        """Show a robot, or the faulty robots of a group.

        Args:
            title: name of the robot or the group.
            rows: rows, the worst first.
        """
        if len(rows) == 1:
            self._lines = list(_detail(rows[0], max(20, self.size.width)))
        else:
            wrong = [row for row in rows if row.robot.summary.state.is_wrong]
            well = ((" nothing is wrong" if rows else "", ""), *_unheard([row.robot.summary for row in rows]))
            lines = [_in_a_line(row) for row in wrong[: self.LINES]] or [well]
            if len(wrong) > self.LINES:
                lines[-1] = ((f" and {len(wrong) - self.LINES + 1} more", "dim"),)
            self._lines = lines
        self.entitle(f" {title} " if title else "")
        self.sync()


def _in_a_line(row: RobotRow) -> Line:
    summary = row.robot.summary
    sign = (f" {ROBOT_SIGN[summary.state]} {ROBOT_WORD[summary.state]:<7} ", ROBOT_LOOK[summary.state])
    return (sign, (f"{summary.name} ", "strong"), (summary.why, ""))


def _detail(row: RobotRow, width: int) -> Iterator[Line]:
    summary = row.robot.summary
    sign = (f" {ROBOT_SIGN[summary.state]} {ROBOT_WORD[summary.state]} ", ROBOT_LOOK[summary.state])
    why = summary.why or ("never connected" if summary.seen is None else "nothing is wrong")
    since = f"for {formats.clock(row.now - summary.since)}: " if summary.since else ""
    wrapped = textwrap.wrap(f"{since}{why}", max(10, width - len(sign[0]) - 1), max_lines=2, placeholder=" …")
    for number, text in enumerate(wrapped or [""]):
        yield (sign if not number else (" " * len(sign[0]), ""), (text, ""))
    seen = "not yet" if summary.seen is None else "now"
    if summary.seen is not None and not is_there(row):
        seen = f"{formats.age(row.now - summary.seen)} ago, {formats.time_of_day(summary.seen)}"
    facts = [
        f"seen {seen}",
        f"at {summary.host}" if summary.host else "",
        f"{row.robot.source.kind} {row.robot.source.name}",
    ]
    if summary.acknowledged:
        facts.append(f"{summary.acknowledged} acknowledged")
    facts += [f"links {summary.links_up}/{summary.links}", f"rsb-console {summary.version}" if summary.version else ""]
    yield ((f" {' · '.join(filter(None, facts))}", "dim"),)
    figures = [f"from it {summary.messages_from_robot:.1f} msg/s, to it {summary.messages_to_robot:.1f} msg/s"]
    if summary.loss is not None:
        figures.append(f"lost {percent(summary.loss.share)} in {summary.loss.span:.0f} s")
    if summary.battery is not None:
        figures.append(f"battery {summary.battery.charge:.0%}, {formats.age(row.now - summary.battery.time)} ago")
    if row.robot.gone:
        figures = ["not connected now: dismiss it, or wait for it"]
    yield ((f" {' · '.join(figures)}", "dim"),)

"""The columns of the table of robots, and which of them a table of some width has."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.robot_summary import RobotState
from rsb_console.look import formats
from rsb_console.look.glyphs import ACK_WORD, KNOWN, sparkline
from rsb_console.widgets.columns import HISTORY, WIDE, Column, filled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_console.fleet.fleet import Robot

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
"""As of the states of topics that are as bad."""
LOW_BATTERY = 0.2
HIGH_LOSS = 0.05


class Row(NamedTuple):
    """A robot as a line of the table.

    Attributes:
        robot: it.
        rates: its messages a second, both ways, the oldest first.
        now: s since the epoch.
    """

    robot: Robot
    rates: Sequence[float]
    now: float


def messages(row: Row) -> float:
    """Hz, both ways."""
    return row.robot.summary.messages_from_robot + row.robot.summary.messages_to_robot


def is_there(row: Row) -> bool:
    """Whether its rates have a meaning."""
    return row.robot.summary.links_up > 0


def why(row: Row) -> str:
    """Return the fault of a row, and how many others are acknowledged."""
    summary = row.robot.summary
    beside = summary.acknowledged if summary.state is not RobotState.ACKNOWLEDGED else 0
    return f"{summary.why} (+{beside} {ACK_WORD})" if beside else summary.why


def _since(row: Row) -> float:
    """How long it has been so, or, if it is not there, when it was seen last, s ago."""
    summary = row.robot.summary
    since = summary.since if summary.state is not RobotState.MISSING or summary.seen is None else summary.seen
    return max(0.0, row.now - since)


def percent(share: float) -> str:
    """A share of 1 in at most four characters: ``12%``, ``0.3%``, ``0``."""
    return "0" if share == 0 else f"{share:.1%}" if share < 0.00995 else f"{share:.0%}"


def _loss(row: Row) -> float:
    loss = row.robot.summary.loss
    return -1.0 if loss is None else loss.share


def _charge(row: Row) -> float:
    battery = row.robot.summary.battery
    return 2.0 if battery is None else battery.charge


def _by_state(row: Row) -> tuple[object, ...]:
    return row.robot.summary.state.rank, row.robot.order


COLUMNS: tuple[Column[Row], ...] = (
    Column(
        "STATE", 9, lambda r: f"{ROBOT_SIGN[r.robot.summary.state]} {ROBOT_WORD[r.robot.summary.state]}", _by_state,
        right=False, from_width=WIDE,
    ),
    Column("", 1, lambda r: ROBOT_SIGN[r.robot.summary.state], _by_state, right=False),
    Column("ROBOT", 0, lambda r: f"{r.robot.summary.name}{' (server)' * r.robot.is_server}", lambda r: r.robot.order,
           right=False),
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
    Column("VERSION", 8, lambda r: r.robot.summary.version, lambda r: (r.robot.summary.version, r.robot.order),
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
def layout(width: int, *, servers: bool, grouped: bool) -> tuple[tuple[Column[Row], int], ...]:
    """The columns that fit, each with its width in cells.

    Args:
        width: cells.
        servers: robots come from several servers.
        grouped: each group has a heading.
    """
    hidden = {SIGN if width >= WIDE else STATE}
    if not servers:
        hidden.add(SERVER)
    if grouped:
        hidden.add(GROUP)
    return filled([each for each in COLUMNS if each.fits(width, calls=False) and each not in hidden], width)


def cell(column: Column[Row], row: Row, text: str) -> str:
    """The look of a cell."""
    summary = row.robot.summary
    if column in {STATE, SIGN}:
        return ROBOT_LOOK[summary.state]
    if not is_there(row):
        return "" if column in DIM else "dim"
    if (column is LOSS and _loss(row) >= HIGH_LOSS) or (column is BATTERY and _charge(row) <= LOW_BATTERY):
        return "slow"
    return "plot" if column is HISTORY_COLUMN and text.strip() else ""

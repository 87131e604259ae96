"""What is to be said of the robot, or the group, under the cursor of a fleet's table."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from rsb_console.look import formats
from rsb_console.widgets import fleet_columns
from rsb_console.widgets.fleet_columns import ROBOT_LOOK, ROBOT_SIGN, ROBOT_WORD, Row, percent
from rsb_console.widgets.lines import LiveLines, fit

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_console.widgets.lines import Line


class RobotDetail(LiveLines):
    """What has no room in the table: why, and whose the figures are."""

    can_focus = False
    LINES = 4

    def __init__(self) -> None:
        super().__init__(id="robot-detail", classes="pane")
        self._lines: list[Line] = []

    @property
    def line_count(self) -> int:
        return len(self._lines)

    def line(self, index: int) -> Line:
        return fit(self._lines[index], self.width)

    def show(self, title: str, rows: Sequence[Row]) -> None:
        """Show a robot, or those of a group with something wrong.

        Args:
            title: its name.
            rows: the worst first.
        """
        if len(rows) == 1:
            self._lines = list(_detail(rows[0], max(20, self.size.width)))
        else:
            wrong = [row for row in rows if row.robot.summary.state.is_wrong]
            self._lines = [_in_a_line(row) for row in wrong[: self.LINES]] or [
                ((" nothing is wrong" if rows else "", ""),)
            ]
            if len(wrong) > self.LINES:
                self._lines[-1] = ((f" and {len(wrong) - self.LINES + 1} more", "dim"),)
        self.entitle(f" {title} " if title else "")
        self.sync()


def _in_a_line(row: Row) -> Line:
    summary = row.robot.summary
    sign = (f" {ROBOT_SIGN[summary.state]} {ROBOT_WORD[summary.state]:<7} ", ROBOT_LOOK[summary.state])
    return (sign, (f"{summary.name} ", "strong"), (summary.why, ""))


def _detail(row: Row, width: int) -> Iterator[Line]:
    summary = row.robot.summary
    sign = (f" {ROBOT_SIGN[summary.state]} {ROBOT_WORD[summary.state]} ", ROBOT_LOOK[summary.state])
    why = summary.why or ("it has not been here yet" if summary.seen is None else "nothing is wrong")
    since = f"for {formats.clock(row.now - summary.since)}: " if summary.since else ""
    wrapped = textwrap.wrap(f"{since}{why}", max(10, width - len(sign[0]) - 1), max_lines=2, placeholder=" …")
    for number, text in enumerate(wrapped or [""]):
        yield (sign if not number else (" " * len(sign[0]), ""), (text, ""))
    seen = "not yet" if summary.seen is None else "now"
    if summary.seen is not None and not fleet_columns.is_there(row):
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
        figures = ["it is only remembered: dismiss it, or wait for it"]
    yield ((f" {' · '.join(figures)}", "dim"),)

"""The time line of the last hours."""

from __future__ import annotations

import asyncio
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rich.cells import cell_len
from textual import work
from textual.binding import Binding
from textual.content import Content

from rsb_bridge.feature_api import EngineError, State, Wording, why_not_written
from rsb_console.feature_console import (
    STATE_SIGN,
    STATE_WORD,
    Dialog,
    FilteredScreen,
    FixedLines,
    Line,
    Prompt,
    SelectableList,
    fit,
    sparkline,
)
from rsb_console.notation import formats
from rsb_console.widgets.lines import fit_middle
from rsb_extras.history import history_report
from rsb_extras.history.history_data import ReportHistory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from textual.app import ComposeResult

    from rsb_console.feature_console import Console, MainScreen
    from rsb_extras.history.history_data import HistoryReport, Track

SPANS = (3600.0, 8 * 3600.0, 24 * 3600.0)
_RENEWED_EVERY = 5.0  # s; a round figure: an outage is shown at most so much later
_SUMMARY_LINES = 6  # a round figure; `rsb-console report` has the others
_SUMMARY_SHARE = 3  # a third of the lines that the frame, keys, headings and gaps leave
_OTHER_LINES = 10  # those
_DETAIL_LINES = 4
_COLUMNS = (("START", 13), ("LENGTH", 14), ("ROBOT", 16), ("TOPIC", 40), ("STATE", 12))
"""Headings, and the most cells of each column with its blank: the longest start is "Mon 12:34:56"."""
_GIVE_WAY = ((3, 15), (2, 9))
"""Columns that leave cells to the cause, in this order, and how many they keep."""
_CAUSE = 13  # cells that the cause keeps: the detail below has the whole of it
_LABEL = 9
HELP = "h 1, 8 or 24 hours   s by time or robot   / filter   x export   esc close"


class HistoryText(Wording):
    """Texts of the history."""

    BY_TOPIC = "by robot and topic"
    NOT_KNOWN = "not available now: {error}"
    GAP = "the bridge did not run, or the machine slept"
    LINES_LEFT_OUT = "{more}: rsb-console report {name}"
    OUTAGES_LEFT_OUT = "at least {more}, dropped for lack of room"


class HistoryRow(NamedTuple):
    """One event or outage.

    Attributes:
        key: identifies it from one report to the next.
        start: s since the epoch.
        length: duration in words, or empty.
        robot: the link, or empty.
        topic: the topic with its direction, another kind with its name, ``link``, or empty.
        state: state of an outage, or the operator of an action.
        look: style of the state.
        text: cause of an outage, or an action in words.
        track: track with the rates to show, or None.
    """

    key: str
    start: float
    length: str
    robot: str
    topic: str
    state: str
    look: str
    text: str
    track: Track | None

    def cells(self, now: float) -> tuple[str, ...]:
        """Return its texts in the columns before the cause."""
        return history_report.moment(self.start, now), self.length, self.robot, self.topic, self.state

    @property
    def plain(self) -> str:
        """Text that a filter searches."""
        return f"{self.robot} {self.topic} {self.state} {self.text}"


def rows_of(report: HistoryReport) -> list[HistoryRow]:
    """Return the events and outages, newest first. An outage that only followed its link's has no row of its own."""
    tracks = {each.subject: each for each in report.tracks}
    rows = [
        HistoryRow(
            f"{each.link}{history_report.what(each)}{each.start:.0f}", each.start,
            f"{history_report.length(each.seconds)}{' …' if each.ongoing else ''}", each.link,
            history_report.what(each),
            *_shown_state(each.state), history_report.why(report, each),
            tracks.get(each.subject),
        )
        for each in history_report.own(report.outages)
    ]  # fmt: skip
    rows += [
        HistoryRow(f"event{each.time}{each.text}", each.time, "", each.link, each.topic,
            history_report.who(each), "key", history_report.did(each), None)
        for each in report.actions
    ]  # fmt: skip
    rows += [
        HistoryRow(f"gap{gap.start:.0f}", gap.start, history_report.length(gap.seconds), "", "", "unknown", "dim",
            HistoryText.GAP(), None)
        for gap in report.gaps
    ]  # fmt: skip
    return sorted(rows, key=lambda row: -row.start)


class HistoryTable(SelectableList):
    sticky = 1

    def __init__(self) -> None:
        super().__init__(id="history")
        self._rows: dict[str, HistoryRow] = {}
        self._cells: dict[str, tuple[str, ...]] = {}
        self._widths = tuple(len(heading) + 1 for heading, _ in _COLUMNS)
        """Of all columns but the cause, for rows without end."""

    def show(self, rows: list[HistoryRow], now: float) -> None:
        self._rows = {row.key: row for row in rows}
        self._cells = {row.key: row.cells(now) for row in rows}
        columns = zip(_COLUMNS, zip(*self._cells.values(), strict=True) if rows else ((),) * 5, strict=True)
        self._widths = tuple(min(most, max(map(cell_len, (heading, *cells))) + 1) for (heading, most), cells in columns)
        self.show_keys(list(self._rows))

    @property
    def selected(self) -> HistoryRow | None:
        return None if self.cursor_key is None else self._rows.get(self.cursor_key)

    def line(self, index: int) -> Line:
        widths = list(self._widths)
        for column, least in _GIVE_WAY:
            missing = max(0, 1 + sum(widths) + _CAUSE - self.width)
            widths[column] = max(min(least, widths[column]), widths[column] - missing)
        if index < self.sticky:
            headings = "".join(f"{heading:<{width}}" for (heading, _), width in zip(_COLUMNS, widths, strict=True))
            return fit(((f" {headings}CAUSE", "head"),), self.width)
        row = self._rows[key := self.keys[index - self.sticky]]
        looks = ("dim", "", "strong", "", row.look)
        cells = (
            (f"{fit_middle(text, width - 1):<{width}}", look)
            for text, width, look in zip(self._cells[key], widths, looks, strict=True)
        )
        return fit((("▌" if self.is_cursor(index) else " ", "key"), *cells, (row.text, "")), self.width)


class HistoryScreen(FilteredScreen[None]):
    """The history of the last hour, 8 hours or day: outages, operators' actions and times without a record."""

    BINDINGS: ClassVar = [
        Binding("escape", "back", show=False),
        Binding("q", "dismiss", show=False),
        Binding("h", "span", show=False),
        Binding("s", "order", show=False),
        Binding("x", "export", show=False),
    ]
    AUTO_FOCUS = "#history"
    DEFAULT_CSS = """
    #history-summary, #history-detail { height: 1; background: $surface; }
    #history { height: 1fr; margin: 1 0; background: $surface; }
    """

    def __init__(self, console: Console) -> None:
        super().__init__(Prompt())
        self.console = console
        self.summary, self.detail = FixedLines(id="history-summary"), FixedLines(id="history-detail")
        self.table = HistoryTable()
        self._span = SPANS[0]
        self._by_topic = False
        self._report: HistoryReport | None = None
        self._problem = ""

    def compose(self) -> ComposeResult:
        """Compose the totals, the table, and the detail of the row under the cursor."""
        widgets = self.summary, self.table, self.detail, self.prompt
        yield Dialog("What happened", *widgets, keys=HELP, shape="-high")

    def on_mount(self) -> None:
        self.set_interval(_RENEWED_EVERY, self.renew)
        self._ask()

    def renew(self) -> None:
        """Ask again, unless an answer is still due, perhaps over a thin line."""
        if self._fetching.is_finished:
            self._ask()

    def _ask(self) -> None:
        self._fetching = self._fetch()

    @work(exclusive=True, group="history")  # no answer about the span before comes behind one about the present span
    async def _fetch(self) -> None:
        """Request the report from the engine, which may run in another process."""
        engine = self.console.engine
        if engine is None:
            self._problem = "no session runs"
        else:
            try:
                self._report = await asyncio.wrap_future(engine.do(ReportHistory(self._span)))
                self._problem = ""
            except EngineError as error:
                self._problem = HistoryText.NOT_KNOWN(error=error)
        self.show()

    def show(self) -> None:
        report = self._report
        parts = [
            "What happened",
            f"last {history_report.length(self._span)}",
            HistoryText.BY_TOPIC() if self._by_topic else "",
        ]
        parts.append("" if self.pattern is None else f"/{self.pattern.text}")
        self.query_one(Dialog).border_title = Content(" ▸ ".join(part for part in parts if part))
        if report is None:
            self.summary.put([((self._problem or "asking the bridge", "down" if self._problem else "dim"),)])
            return
        rows = [
            row
            for row in rows_of(report)
            if self.pattern is None or self.pattern.matches({"": row.plain, "robot": row.robot, "topic": row.topic})
        ]
        if self._by_topic:
            rows.sort(key=lambda row: (row.robot, row.topic))
        self.summary.put(list(self._totals(report, rows)))
        self.table.show(rows, report.time)
        self._show_detail()

    def _totals(self, report: HistoryReport, rows: list[HistoryRow]) -> Iterator[Line]:
        if self._problem:
            yield ((self._problem, "down"),)
        lines = list(history_report.totals(report))
        room, left_out = max(1, (self.size.height - _OTHER_LINES) // _SUMMARY_SHARE), len(lines)
        for line in lines[:_SUMMARY_LINES]:
            wrapped = textwrap.wrap(line, max(20, self.summary.size.width), subsequent_indent="  ")
            room -= len(wrapped)
            if room < 0 and left_out < len(lines):
                break
            left_out -= 1
            yield from (((text, ""),) for text in wrapped)
        if left_out:
            more = formats.counted(left_out, "more line")
            yield ((HistoryText.LINES_LEFT_OUT(more=more, name=report.name), "dim"),)
        if report.outages_left_out:
            more = formats.counted(report.outages_left_out, "more outage")
            yield ((HistoryText.OUTAGES_LEFT_OUT(more=more), "dim"),)
        if not rows:
            yield (("no match" if self.pattern else "nothing else happened", "dim"),)

    def _show_detail(self) -> None:
        row = self.table.selected
        self.detail.put([] if row is None else list(_detail(row, self.detail.size.width or 80, self._span)))

    def on_resize(self) -> None:
        self.show()

    def on_selectable_list_cursor_moved(self) -> None:
        self._show_detail()

    def action_span(self) -> None:
        self._span = SPANS[(SPANS.index(self._span) + 1) % len(SPANS)]
        self._report = None  # of the span before
        self.show()
        self._ask()

    def action_order(self) -> None:
        self._by_topic = not self._by_topic
        self.show()

    def action_back(self) -> None:
        """Drop the filter, or close."""
        if self.pattern is not None:
            self.pattern = None
            self.show()
        else:
            self.dismiss()

    def action_export(self) -> None:
        """Write the history to files in the working folder, as text and CSV."""
        if self._report is None:
            return
        try:
            paths = history_report.export_history(self._report)
        except OSError as error:
            self.notify(why_not_written(error, Path()), title="Not exported", severity="error", markup=False)
        else:
            self.notify("written to " + " and ".join(map(str, paths)), markup=False)


async def show_history(screen: MainScreen) -> None:
    await screen.console.ask(HistoryScreen(screen.console))


def _shown_state(state: str) -> tuple[str, str]:
    """Return the sign and the word of a state, and its look; a newer bridge may send an unknown one."""
    known = next((each for each in State if each == state), None)
    return (state.upper(), "") if known is None else (f"{STATE_SIGN[known]} {STATE_WORD[known]}", known.value)


def _detail(row: HistoryRow, width: int, span: float) -> Iterator[Line]:
    """Yield the whole text, and the rate over the span."""
    whole = textwrap.wrap(row.text, max(20, width - _LABEL)) or [""]
    for number, line in enumerate(whole[:_DETAIL_LINES]):
        yield ((f"{'' if number else ('why' if row.length else 'what'):<{_LABEL}}", "dim"), (line, ""))
    if row.track is not None:
        rates = [rate or 0.0 for rate in row.track.rates]
        most = max(rates, default=0.0)
        unit = "Hz" if row.track.kind == "topic" else "calls/s"
        top = f"{formats.hertz(most)} {unit}" if row.track.topic else formats.byte_rate(most)
        picture = sparkline(rates, len(rates))
        up = history_report.percent(row.track.up_ratio)
        words = f"  at most {top}; up {up} of the last {history_report.length(span)}"
        yield ((f"{'rate':<{_LABEL}}", "dim"), (picture, "plot"), (words, "dim"))

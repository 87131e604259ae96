"""The units of both sides on a screen, with a key for each action."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, ClassVar, NamedTuple, TypeAlias
from weakref import WeakKeyDictionary

from textual import work
from textual.binding import Binding

from rsb_bridge.feature_api import Effect, EngineError, Wording
from rsb_console.feature_console import (
    DIALOG,
    DONE,
    FAILED,
    CellTable,
    ConfirmScreen,
    Dialog,
    ScrolledLines,
    SidesScreen,
    SideText,
    asked_link,
    side_of,
    wrapped,
)
from rsb_extras.units import MAY_ASK
from rsb_extras.units.unit_records import UnitAction, UnitOutcome, UnitText
from rsb_extras.units.unit_requests import ControlUnit, ListUnits
from rsb_extras.units.units_command import HEADINGS, UnitsCommandText, actions_text, age_text, state_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from textual.app import ComposeResult
    from textual.notifications import SeverityLevel

    from rsb_bridge.feature_api import EngineApi
    from rsb_console.feature_console import Line, MainScreen
    from rsb_extras.units.unit_records import UnitRecord
    from rsb_extras.units.unit_requests import UnitGroup

_WIDTH = 76  # cells, until the screen is laid out
_LOOKS = {"running": "ok", "stopped": "waiting", "failed": "down", "unknown": "unknown"}
HELP = "x restart   s start   S stop   esc close"
_Results: TypeAlias = dict[str, tuple[UnitAction, UnitOutcome | None]]
"""The last action on each unit, and how it has ended, or None while it is under way."""
_results: WeakKeyDictionary[EngineApi, _Results] = WeakKeyDictionary()
"""Those of each engine: an action takes minutes, and its end outlives the screen from which it was asked for."""


class UnitsScreenText(Wording):
    READ_ONLY = "this console is read-only"
    NO_ACTION = "unit {name} has no {action}: it has {actions}"
    RESTART = "Its nodes end and start again. What they move has to be safe without them."
    START = "Its nodes start, and may move what they drive. Nobody may be in its way."
    STOP = "Its nodes end. What they move has to be safe without them."
    UNDER_WAY = "{action} under way"
    WAIT = "unit {name}: {action} is under way: wait until that is over"


class UnitRow(NamedTuple):
    """A unit with the link to its side, or an empty text for this side."""

    link: str
    side: str
    unit: UnitRecord

    @property
    def key(self) -> str:
        return f"{self.link}/{self.unit.name}"


class UnitsTable(CellTable[UnitRow]):
    HEADINGS = HEADINGS

    def cells(self, row: UnitRow) -> tuple[tuple[str, str], ...]:
        unit = row.unit
        state = state_text(unit), _LOOKS[unit.state]
        return (unit.name, "strong"), (row.side, ""), state, (age_text(unit), "dim"), (actions_text(unit), "")


class UnitsScreen(SidesScreen["UnitGroup"]):
    """The units of this side and of its links, and how the last action on each has ended."""

    BINDINGS: ClassVar = [
        Binding("x", "control('restart')", show=False),
        Binding("s", "control('start')", show=False),
        Binding("S", "control('stop')", show=False),
    ]
    AUTO_FOCUS = "#units"
    EVERY = 2.0  # a round figure: a bridge looks for states each 5 s at most
    DEFAULT_CSS = """
    #units { height: 1fr; background: $surface; }
    #units-outcome { max-height: 50%; margin-top: 1; background: $surface; }
    """

    def __init__(self, main: MainScreen, link: str) -> None:
        super().__init__(main.console, link)
        self.main, self.table = main, UnitsTable(id="units")
        self.outcome = ScrolledLines(id="units-outcome")

    def compose(self) -> ComposeResult:
        yield Dialog("Units", self.problems, self.table, self.outcome, keys=HELP, shape="-high")

    def request(self) -> ListUnits:
        return ListUnits(self.link)

    def show(self, groups: Sequence[UnitGroup]) -> None:
        role = self.console.snapshot().role
        sides = [(group, side_of(role, group.link)) for group in groups]
        self.table.show([UnitRow(group.link, side, unit) for group, side in sides for unit in group.units])
        self.show_problems(groups, UnitsCommandText.NONE(), is_empty=self.table.selected is None)
        self.show_outcome()

    @property
    def results(self) -> _Results:
        engine = self.console.engine
        return {} if engine is None else _results.setdefault(engine, {})

    def show_outcome(self) -> None:
        row, results = self.table.selected, self.results
        width = self.table.size.width or _WIDTH
        self.outcome.put([] if row is None or row.key not in results else [*_lines(row, *results[row.key], width)])

    def on_selectable_list_cursor_moved(self) -> None:
        self.show_outcome()

    def action_control(self, action: UnitAction) -> None:
        row = self.table.selected
        if row is None or not self.table.is_seen():
            return
        if self.console.readonly:
            self.warn(UnitsScreenText.READ_ONLY())
        elif action not in row.unit.actions:
            actions = ", ".join(row.unit.actions) or "none"
            self.warn(UnitsScreenText.NO_ACTION(name=row.unit.name, action=action, actions=actions))
        elif not row.unit.allowed:
            act, entry = f"{action} unit {row.unit.name}", MAY_ASK.entry(f"[{row.unit.name}]")
            self.warn(SideText.LACKS(side=row.side, act=act, entry=entry))
        elif (last := self.results.get(row.key)) is not None and last[1] is None:
            self.warn(UnitsScreenText.WAIT(name=row.unit.name, action=last[0]))
        else:
            self._ask(row, action)

    @work(group=DIALOG)
    async def _ask(self, row: UnitRow, action: UnitAction) -> None:
        title = UnitsCommandText.ASK(action=action.capitalize(), name=row.unit.name, side=row.side)
        means = UnitsScreenText[action.upper()]()
        question = ConfirmScreen(title, means, action.capitalize(), Effect.MOVES | Effect.LOSES)
        if await self.console.ask(question) is True and (engine := self.console.engine) is not None:
            self.results[row.key] = action, None
            self.show_outcome()
            # Not in this worker, for which keys wait, nor of this screen, which may be closed before the end.
            _control(self.main, engine, row, action)


@work(group="unit-actions")
async def _control(main: MainScreen, engine: EngineApi, row: UnitRow, action: UnitAction) -> None:
    """Wait for the end of an action, and show it: below the list, or without one in a message."""
    results = _results[engine]
    try:
        outcome = await asyncio.wrap_future(engine.do(ControlUnit(row.unit.name, action, row.link)))
    except EngineError as error:
        results.pop(row.key, None)
        text, is_done, is_shown = str(error), False, False
    else:
        results[row.key] = action, outcome
        text, is_done, is_shown = _ended(row, UnitText.of(action, outcome)), outcome.done, True
    screens = [each for each in main.app.screen_stack if isinstance(each, UnitsScreen)]
    for screen in screens:
        screen.show_outcome()
        screen.renew()
    if not (screens and is_shown):
        severity: SeverityLevel = "information" if is_done else "warning"
        main.console.notify(text, severity=severity, markup=False, timeout=8)


def _ended(row: UnitRow, text: str) -> str:
    return UnitsCommandText.ENDED(name=row.unit.name, side=row.side, text=text)


def _lines(row: UnitRow, action: UnitAction, outcome: UnitOutcome | None, width: int) -> Iterator[Line]:
    if outcome is None:
        yield ((_ended(row, UnitsScreenText.UNDER_WAY(action=action)), "waiting"),)
        return
    sign, look = (DONE, "ok") if outcome.done else (FAILED, "down")
    yield from wrapped(f"{sign} {_ended(row, UnitText.of(action, outcome))}", width, look)
    for line in () if outcome.done else (*outcome.output, *outcome.log):
        yield from wrapped(line, width)


async def show_units(screen: MainScreen) -> None:
    await screen.console.ask(UnitsScreen(screen, asked_link(screen)))

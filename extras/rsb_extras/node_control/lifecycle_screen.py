"""Managed nodes, groups and containers of both sides, with a key for each change, and the steps of the last one."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, ClassVar

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
    wrapped,
)
from rsb_extras.node_control import MAY_CHANGE
from rsb_extras.node_control.change_records import GOALS, ChangeText, Component
from rsb_extras.node_control.change_requests import ChangeNodes, ListManaged
from rsb_extras.node_control.component_form import ComponentForm
from rsb_extras.node_control.lifecycle_rows import NOTHING, LifecycleRow, LifecycleText, outcomes, with_components

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from textual.app import App, ComposeResult

    from rsb_bridge.feature_api import EngineApi
    from rsb_console.feature_console import Console, Line, MainScreen
    from rsb_extras.node_control.change_records import (
        ChangeAction,
        ChangeOutcome,
        ComponentAction,
        LifecycleAction,
    )
    from rsb_extras.node_control.change_requests import ManagedSide

_LOOKS = {"active": "ok", "inactive": "waiting", "unconfigured": "waiting", "finalized": "down"}
_INDENT = "    "  # below a step
_WIDTH = 76  # cells, until the screen is laid out
HELP = (
    "u up   w down   c configure   a activate   d deactivate   n clean up   S shut down   l load   L unload   esc close"
)
_KEYS: dict[str, LifecycleAction] = {
    "u": "up", "w": "down", "c": "configure", "a": "activate", "d": "deactivate", "n": "cleanup", "S": "shutdown",
}  # fmt: skip
_OF_CONTAINER: dict[str, ComponentAction] = {"l": "load", "L": "unload"}


class LifecycleScreenText(Wording):
    READ_ONLY = "this console is read-only"
    NOT_OFFERED = "{name} is {state}: it offers {offers} now"
    RISES = "{nodes} will be {goal}. What is driven may move: nobody may be in its way."
    FALLS = "{nodes} will be {goal}. What is driven has to be safe without."
    WAIT = "{name}: {action} is under way: wait until that is over"
    NO_CONTAINER = "{name} is no container: l loads into one"
    NO_COMPONENT = "{name} is no component of a container: L unloads one"
    LOAD = "Load {what} into {name} of {side}?"
    LOADS = "Its node runs in the container's process, and ends with it. What it drives may move."
    UNLOAD = "Unload {name} of {side}?"
    UNLOADS = "Its node in {container} ends. What is driven has to be safe without."


class LifecycleTable(CellTable[LifecycleRow]):
    HEADINGS = "NAME", "SIDE", "STATE", "KEYS"

    def cells(self, row: LifecycleRow) -> tuple[tuple[str, str], ...]:
        look = "strong" if row.nodes else ""
        return (row.name, look), (row.side, ""), (row.state, _LOOKS.get(row.state, "")), (_keys_of(row), "dim")


class LifecycleScreen(SidesScreen["ManagedSide"]):
    """Managed nodes and groups of this side and of its links, and how the last change of each has gone.

    Args:
        link: whose other side is asked, or empty for all.
        node: on which the cursor is to be, or empty.
    """

    BINDINGS: ClassVar = [
        *(Binding(key, f"change({action!r})", show=False) for key, action in _KEYS.items()),
        *(Binding(key, action, show=False) for key, action in _OF_CONTAINER.items()),
    ]
    AUTO_FOCUS = "#lifecycle"
    EVERY = 1.0  # the bridges look at the nodes as often
    DEFAULT_CSS = """
    #lifecycle { height: 1fr; background: $surface; }
    #lifecycle-steps { max-height: 40%; margin-top: 1; background: $surface; }
    """

    def __init__(self, console: Console, link: str, node: str = "") -> None:
        super().__init__(console, link)
        self._wanted = node and f"{link} {node}"
        self._sides: Sequence[ManagedSide] = ()
        self.table, self.steps = LifecycleTable(id="lifecycle"), ScrolledLines(id="lifecycle-steps")

    def compose(self) -> ComposeResult:
        yield Dialog("Lifecycle", self.problems, self.table, self.steps, keys=HELP, shape="-high")

    def request(self) -> ListManaged:
        return ListManaged(self.link)

    def show(self, sides: Sequence[ManagedSide]) -> None:
        role, self._sides = self.console.snapshot().role, sides
        self.table.show(list(with_components(role, sides)))
        if self._wanted in self.table.keys:
            self.table.move_to(self.table.keys.index(self._wanted))
            self._wanted = ""
        self.show_problems(sides, LifecycleText.NONE(), is_empty=self.table.selected is None)
        self.show_steps()

    def show_steps(self) -> None:
        row = self.table.selected
        last = None if row is None else self._last(row)
        lines = [] if row is None or last is None else [*_lines(row, *last, self.table.size.width or _WIDTH)]
        grows = last is not None and not last[1].is_over and len(lines) > self.steps.line_count
        self.steps.put(lines)
        if grows:
            self.call_after_refresh(self.steps.scroll_end, animate=False)

    def _last(self, row: LifecycleRow) -> tuple[ChangeAction, ChangeOutcome] | None:
        """Return the last change of a row, or of the container of a component that is no managed node."""
        found = outcomes(self._sides)
        return found.get(row.key) or found.get(f"{row.link} {row.container}")

    def on_selectable_list_cursor_moved(self) -> None:
        self.show_steps()

    def action_change(self, action: LifecycleAction) -> None:
        row = self.table.selected
        if row is None or not self.table.is_seen():
            return
        if problem := self._why_not(row, row.name, allowed=row.allowed):
            self.warn(problem)
        elif not row.is_managed or (not row.nodes and action not in ("up", "down", *row.actions)):
            offers = ", ".join(row.actions) or "nothing"
            self.warn(LifecycleScreenText.NOT_OFFERED(name=row.name, state=row.state, offers=offers))
        else:
            self._ask(row, action)

    def _why_not(self, row: LifecycleRow, name: str, *, allowed: bool) -> str:
        """Return the reason why a row cannot be changed now, by the right to a node, or an empty string."""
        last = self._last(row)
        if self.console.readonly:
            return LifecycleScreenText.READ_ONLY()
        if last is not None and not last[1].is_over:
            return LifecycleScreenText.WAIT(name=row.name, action=last[0])
        entry = MAY_CHANGE.entry(f"[{name}]")
        return "" if allowed else SideText.LACKS(side=row.side, act=f"change {name}", entry=entry)

    def action_load(self) -> None:
        self._change_container("load", LifecycleScreenText.NO_CONTAINER)

    def action_unload(self) -> None:
        self._change_container("unload", LifecycleScreenText.NO_COMPONENT)

    def _change_container(self, action: ComponentAction, impossible: LifecycleScreenText) -> None:
        row = self.table.selected
        if row is None or not self.table.is_seen():
            return
        if not row.container or (row.container == row.name) is not (action == "load"):
            self.warn(impossible(name=row.name))
        elif problem := self._why_not(row, row.container, allowed=row.may_load):
            self.warn(problem)
        else:
            (self._load if action == "load" else self._unload)(row)

    @work(group=DIALOG)
    async def _load(self, row: LifecycleRow) -> None:
        loaded = await self.console.ask(ComponentForm(row.name))
        if loaded is None:
            return
        component, values = loaded
        title = LifecycleScreenText.LOAD(what=component.plugin, name=row.name, side=row.side)
        command = ChangeNodes(row.name, "load", row.link, values, component)
        await self._confirm(title, LifecycleScreenText.LOADS(), row, command)

    @work(group=DIALOG)
    async def _unload(self, row: LifecycleRow) -> None:
        title = LifecycleScreenText.UNLOAD(name=row.name, side=row.side)
        means = LifecycleScreenText.UNLOADS(container=row.container)
        command = ChangeNodes(row.container, "unload", row.link, component=Component(name=row.name))
        await self._confirm(title, means, row, command)

    @work(group=DIALOG)
    async def _ask(self, row: LifecycleRow, action: LifecycleAction) -> None:
        title = LifecycleText.ASK(action=action.capitalize(), target=row.name, side=row.side)
        text = LifecycleScreenText.RISES if action in ("up", "configure", "activate") else LifecycleScreenText.FALLS
        means = text(nodes=", ".join(row.nodes) or row.name, goal=GOALS[action])
        await self._confirm(title, means, row, ChangeNodes(row.name, action, row.link))

    async def _confirm(self, title: str, means: str, row: LifecycleRow, command: ChangeNodes) -> None:
        question = ConfirmScreen(title, means, command.action.capitalize(), Effect.MOVES | Effect.LOSES)
        if await self.console.ask(question) is True and (engine := self.console.engine) is not None:
            # Not in this worker, for which keys wait, nor of this screen, which may be closed before the end.
            _change(self.app, self, engine, row, command)


@work(group="node-changes")
async def _change(
    _: App[Any], screen: LifecycleScreen, engine: EngineApi, row: LifecycleRow, command: ChangeNodes
) -> None:
    """Wait for the end of a change. Its steps stand below the list; without that, a message says how it has ended."""
    try:
        outcome = await asyncio.wrap_future(engine.do(command))
    except EngineError as error:
        text, is_done, is_shown = str(error), False, False
    else:
        text, is_done = _ended(row, ChangeText.of(command.action, outcome)), outcome.done
        is_shown = screen.is_attached and not outcome.refused
    if screen.is_attached:
        screen.renew()
    if not is_shown:
        severity = "information" if is_done else "warning"
        screen.console.notify(text, severity=severity, markup=False, timeout=8)  # type: ignore[arg-type]  # one of them


def _ended(row: LifecycleRow, text: str) -> str:
    return LifecycleText.ENDED(target=row.name, side=row.side, text=text)


def _lines(row: LifecycleRow, action: ChangeAction, outcome: ChangeOutcome, width: int) -> Iterator[Line]:
    text = _ended(row, ChangeText.of(action, outcome))
    if not outcome.is_over:
        yield ((text, "waiting"),)
    else:
        sign, look = (DONE, "ok") if outcome.done else (FAILED, "down")
        yield from wrapped(f"{sign} {text}", width, look)
    for step in outcome.steps:
        sign, look = (FAILED, "down") if step.reason else (DONE, "ok")
        first, *others = wrapped(ChangeText.of_step(step), width - len(_INDENT))
        yield ((f"  {sign} ", look), *first)
        yield from (((_INDENT, ""), *each) for each in others)


def _keys_of(row: LifecycleRow) -> str:
    """Return the keys that do something to a row now."""
    if not (row.allowed or row.may_load):
        return SideText.NO_RIGHT()
    possible: set[str] = {*row.actions, "up", "down"} if row.actions and row.allowed else set()
    if row.may_load:
        possible |= {*row.of_container}
    return " ".join(key for key, action in (_KEYS | _OF_CONTAINER).items() if action in possible) or NOTHING


async def show_lifecycle(screen: MainScreen) -> None:
    """Show managed nodes and groups; on a server of many links, those of the topic's robot."""
    await screen.console.ask(LifecycleScreen(screen.console, asked_link(screen)))


async def lifecycle_of_node(console: Console, link: str, node: str) -> None:
    """Show those of a node's side, with the cursor on it."""
    await console.ask(LifecycleScreen(console, link, node))

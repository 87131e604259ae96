"""A node's parameters on a screen: a list that is filtered, a form for one value, and a question before it is set."""

from __future__ import annotations

import asyncio
import textwrap
import time
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from textual import work
from textual.binding import Binding

from rsb_bridge.feature_api import Effect, EngineError, Wording
from rsb_console.feature_console import (
    DIALOG,
    CellTable,
    ConfirmScreen,
    Dialog,
    Field,
    FilteredScreen,
    FixedLines,
    FormScreen,
    Prompt,
    ScrolledLines,
    Spec,
    parameter_value,
    shown_value,
    side_of,
    time_of_day,
)
from rsb_extras.node_control.change_records import ChangeText
from rsb_extras.node_control.change_requests import ChangeNodes
from rsb_extras.node_control.lifecycle_rows import LifecycleText
from rsb_extras.node_control.parameter_requests import ReadParameters
from rsb_extras.node_control.parameter_rules import ParameterChange, ParameterText, about, change_of, value_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from textual.app import App, ComposeResult

    from rsb_bridge.feature_api import EngineApi
    from rsb_console.feature_console import Console
    from rsb_extras.node_control.parameter_records import NodeParameter

_WIDTH = 76  # cells, until the screen is laid out
_EDITED = 4096  # characters of a value in the form, which a list has whole
HELP = "⏎ edit   / filter   c changed only   r read again   esc close"


class ParametersScreenText(Wording):
    READING = "asking {node}"
    NO_SESSION = "no session runs"
    READ_ONLY = "this console is read-only"
    COUNTS = "{count} parameters, {read_only} read-only, {changed} changed since this screen was opened; read at {time}"
    NO_MATCH = "no match"
    MAY_NOT = "{name}: {reason}"
    TOO_LARGE = "too large for a form: rsb-console param set, or load a file"
    ASK = "Set {name} of {node}?"
    MEANS = "{change}\nof {side}. What the node drives may move otherwise at once."
    HELP = "{type}, in YAML. {about}"


class ParameterRow(NamedTuple):
    parameter: NodeParameter
    is_changed: bool

    @property
    def key(self) -> str:
        return self.parameter.name


class ParameterTable(CellTable[ParameterRow]):
    HEADINGS = "NAME", "VALUE", "TYPE", ""
    WHOLE = frozenset({"TYPE", ""})

    def cells(self, row: ParameterRow) -> tuple[tuple[str, str], ...]:
        parameter, is_changed = row
        mark = "read-only" if parameter.read_only else "changed" if is_changed else ""
        name = parameter.name, "dim" if parameter.read_only else ""
        value = value_text(parameter), "waiting" if is_changed else ""
        return name, value, (parameter.value.type, "dim"), (mark, "dim")


class ParameterForm(FormScreen[ParameterChange]):
    """One parameter's value."""

    def __init__(self, node: str, parameter: NodeParameter) -> None:
        self._parameter = parameter
        text = "" if not parameter.value.content else shown_value(parameter.value.plain(), _EDITED)
        meaning = ParametersScreenText.HELP(type=parameter.value.type, about=about(parameter))
        super().__init__(node, [Field(Spec("value", parameter.name, meaning, text, edited=True))], "Set")

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        try:
            self.result(values)
        except ValueError as error:
            return {"value": str(error)}
        return {}

    def result(self, values: Mapping[str, str]) -> ParameterChange:
        return change_of(self._parameter, partial(parameter_value, values["value"]))


class ParametersScreen(FilteredScreen[None]):
    """The parameters of a node. They are read when it opens, after a change, and by a key.

    Args:
        link: whose other side has the node, or empty for this side.
    """

    BINDINGS: ClassVar = [
        Binding("escape", "back", show=False),
        Binding("q", "dismiss(None)", show=False),
        Binding("enter", "edit", show=False),
        Binding("c", "changed", show=False),
        Binding("r", "read", show=False),
    ]
    AUTO_FOCUS = "#parameters"
    DEFAULT_CSS = """
    #parameters-summary { height: auto; background: $surface; }
    #parameters { height: 1fr; margin: 1 0; background: $surface; }
    #parameter-about { height: 3; background: $surface; }
    """

    def __init__(self, console: Console, link: str, node: str) -> None:
        super().__init__(Prompt(""))
        self.console = console
        self._link, self._node = link, node
        self._side = side_of(console.snapshot().role, link)
        self._found: dict[str, NodeParameter] = {}
        self._first: dict[str, NodeParameter] = {}  # as they were when the screen was opened
        self._problem = self._read_at = ""
        self._changed_only = False
        self.summary, self.table = FixedLines(id="parameters-summary"), ParameterTable(id="parameters")
        self.about = ScrolledLines(id="parameter-about")

    def compose(self) -> ComposeResult:
        title = f"Parameters ▸ {self._side} ▸ {self._node}"
        yield Dialog(title, self.summary, self.table, self.about, self.prompt, keys=HELP, shape="-high")

    def on_mount(self) -> None:
        self.action_read()

    def action_read(self) -> None:
        self._problem = ""
        self.summary.put([((ParametersScreenText.READING(node=self._node), "dim"),)])
        self._read()

    @work(exclusive=True, group="parameters")
    async def _read(self) -> None:
        engine = self.console.engine
        if engine is None:
            self._problem = ParametersScreenText.NO_SESSION()
        else:
            try:
                found = await asyncio.wrap_future(engine.do(ReadParameters(self._node, link=self._link)))
            except EngineError as error:
                self._problem = str(error)
            else:
                self._found = {each.name: each for each in found}
                self._read_at = time_of_day(time.time())
                self._first = self._first or self._found
        self.show()

    def show(self) -> None:
        changed = {name for name, each in self._found.items() if self._first.get(name) != each}
        shown = [
            ParameterRow(each, name in changed)
            for name, each in self._found.items()
            if (name in changed or not self._changed_only) and self._matches(each)
        ]
        self.table.show(shown)
        read_only = sum(each.read_only for each in self._found.values())
        counts = {"count": len(self._found), "read_only": read_only, "changed": len(changed), "time": self._read_at}
        lines = [(self._problem, "down")]
        if self._read_at:
            lines.append((ParametersScreenText.COUNTS(**counts), ""))
        if self._found and not shown:
            lines.append((ParametersScreenText.NO_MATCH(), ""))
        width = max(20, self.summary.size.width or _WIDTH)
        self.summary.put([((part, look),) for line, look in lines for part in textwrap.wrap(line, width)])
        self.on_selectable_list_cursor_moved()

    def _matches(self, parameter: NodeParameter) -> bool:
        text = f"{parameter.name} {value_text(parameter)} {parameter.value.type} {about(parameter)}"
        return self.pattern is None or self.pattern.matches({"": text})

    @property
    def _selected(self) -> NodeParameter | None:
        return self._found.get(self.table.cursor_key or "")

    def on_selectable_list_cursor_moved(self) -> None:
        parameter = self._selected
        text = "" if parameter is None else about(parameter)
        self.about.show([((each, "dim"),) for each in textwrap.wrap(text, self.about.size.width or _WIDTH)])

    def on_selectable_list_chosen(self) -> None:
        self.action_edit()

    def action_changed(self) -> None:
        self._changed_only = not self._changed_only
        self.show()

    def action_back(self) -> None:
        """Drop the filters, or close."""
        if self.pattern is None and not self._changed_only:
            self.dismiss(None)
            return
        self.pattern, self._changed_only = None, False
        self.show()

    def action_edit(self) -> None:
        parameter = self._selected
        if parameter is None or not self.table.is_seen():
            return
        if self.console.readonly:
            self._warn(ParametersScreenText.READ_ONLY())
        elif parameter.read_only or parameter.size:
            reason = (ParameterText.READ_ONLY if parameter.read_only else ParametersScreenText.TOO_LARGE)()
            self._warn(ParametersScreenText.MAY_NOT(name=parameter.name, reason=reason))
        else:
            self._edit(parameter)

    @work(group=DIALOG)
    async def _edit(self, parameter: NodeParameter) -> None:
        change = await self.console.ask(ParameterForm(self._node, parameter))
        if change is None or change.value.value == parameter.value:
            return
        title = ParametersScreenText.ASK(name=change.name, node=self._node)
        means = ParametersScreenText.MEANS(change=change, side=self._side)
        if await self.console.ask(ConfirmScreen(title, means, "Set", Effect.MOVES | Effect.LOSES)) is not True:
            return
        if (engine := self.console.engine) is not None:
            # Not in this worker, for which keys wait, nor of this screen, which may be closed before the end.
            _set(self.app, self, engine, change)

    async def set(self, engine: EngineApi, change: ParameterChange) -> None:
        """Have the node set a value, say how that has ended, and read all again."""
        try:
            command = ChangeNodes(self._node, "set", self._link, (change.value,))
            outcome = await asyncio.wrap_future(engine.do(command))
        except EngineError as error:
            self._warn(str(error))
        else:
            text = LifecycleText.ENDED(target=self._node, side=self._side, text=ChangeText.of("set", outcome))
            if outcome.done:
                self.console.notify(text, markup=False)
            else:
                self._warn(text)
        if self.is_attached:
            self.action_read()

    def _warn(self, text: str) -> None:
        self.console.notify(text, severity="warning", markup=False, timeout=8)


@work(group="node-changes")
async def _set(_: App[Any], screen: ParametersScreen, engine: EngineApi, change: ParameterChange) -> None:
    await screen.set(engine, change)


async def parameters_of_node(console: Console, link: str, node: str) -> None:
    """Show the parameters of a node."""
    await console.ask(ParametersScreen(console, link, node))

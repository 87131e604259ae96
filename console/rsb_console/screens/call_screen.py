"""A form that calls a service by hand, sends a goal, or sets a parameter: YAML in, YAML out."""

from __future__ import annotations

import asyncio
import textwrap
import time
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rich.cells import chop_cells
from textual import on, work
from textual.binding import Binding

from rsb_bridge.api import EngineError
from rsb_bridge.model.calls import FieldError
from rsb_bridge.model.commands import Effect, Template
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import join_first, sanitize_text
from rsb_bridge.model.wording import Wording
from rsb_console.notation import formats
from rsb_console.notation.glyphs import DONE, FAILED, STATE_SIGN, STATE_WORD, UNDER_WAY
from rsb_console.screens.by_hand_screen import ByHandScreen, FieldsText, fields_problem
from rsb_console.screens.dialog import ConfirmScreen, beginning
from rsb_console.session.parameter_values import refusal, set_request
from rsb_console.terminal.driver import copy
from rsb_console.terminal.input_queue import DIALOG
from rsb_console.widgets.form import Field, Spec, TextField
from rsb_console.widgets.lines import ScrolledLines

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from textual.app import ComposeResult

    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.console_api import Console
    from rsb_console.widgets.lines import Line

_SET, _SET_LANE = "set", "set_parameters"
"""The choice that sets one parameter by name and value, and the service behind it."""
_MOST_LINES = 2_000
"""Lines of an answer that are shown. A round figure: the event loop, for which keys wait, lays them out."""
_NODES = 3
_KEYS = "F9 call   tab next   y copy the answer   esc close"


class CallText(Wording):
    """Texts of the form."""

    NOTHING_CALLED = "no call yet"
    WAITING = "{sign} waiting for the answer, {waited}"
    WAITING_UNTIL = "{sign} waiting for the answer, {waited}; gives up after {limit:g} s"
    NAME_MISSING = "missing: name the parameter, as `ros2 param list` does"
    REQUEST_SENT = "It is sent once, {where}:"
    ANSWERED = "{sign} {report}"
    VALUE_SET = "{sign} {report}: it is set"


class PlannedCall(NamedTuple):
    """A call that is to be made.

    Attributes:
        lane: name of the service, if the route has several.
        text: the request's fields, as YAML.
        question: asks for a confirmation, with its consequences (`means`) and the label of its button (`yes`).
        sets: whether it sets one parameter.
    """

    lane: str
    text: str
    question: str
    means: str
    yes: str
    sets: bool


class CallResult(NamedTuple):
    """The outcome in words, with its look, and the answer as YAML, if there is one."""

    text: str
    look: str
    answer: str = ""


class CallScreen(ByHandScreen[PlannedCall]):
    """Asks for a request, calls once the operator has confirmed, and shows the answer; it stays open for more."""

    AUTO_FOCUS = ".field TextArea, .field Input, .field Choice"
    BINDINGS: ClassVar = [*ByHandScreen.BINDINGS, Binding("y", "copy", show=False)]

    def __init__(self, console: Console, route: RouteSnapshot) -> None:
        self._route = route
        self._templates: dict[str, str] = {}
        self._outcome: CallResult | None = None
        self._under_way_since: float | None = None
        self._pane = ScrolledLines(id="answer")
        self._laid_out: tuple[object, ...] = ()
        fields = [TextField(spec) if spec.key == "request" else Field(spec) for spec in _specs(route)]
        super().__init__(console, f"Call {route.topic} by hand", fields, "Call…", _KEYS, "-call")

    def compose_result(self) -> ComposeResult:
        yield self._pane

    def on_mount(self) -> None:
        self._show_lane()
        self._pane.border_title = " Answer "
        self.set_interval(0.5, self._draw)
        # Before the first layout, the pane has no width.
        self.call_after_refresh(self._draw)

    def on_resize(self) -> None:
        self.call_after_refresh(self._draw)

    # -- the request --------------------------------------------------------------------------------------------------

    @property
    def _lane(self) -> str:
        """The chosen operation: one of the route's services, or setting one parameter."""
        field = self.form.fields.get("lane")
        return self._route.lanes[0] if field is None else field.value

    def _show_lane(self) -> None:
        sets = self._lane == _SET
        for key, field in self.form.fields.items():
            field.display = key == "lane" or (key == "request") is not sets
        if not sets:
            self._offer_template(self._lane)

    @work(group="template", exclusive=True)
    async def _offer_template(self, lane: str) -> None:
        """Write all fields of the request with their defaults, unless the operator has written something else."""
        field = self.form.fields["request"]
        if lane not in self._templates:
            try:
                assert self.console.engine is not None
                made = await asyncio.wrap_future(self.console.engine.do(Template(self._route.key, lane)))
            except EngineError as error:
                field.note.set_text(f"Its fields are not known: {error}")
                made = ""
            else:
                field.note.set_text("")
                self._templates[lane] = made.strip()
        # The operator may have gone on meanwhile, to another operation or by typing.
        if lane == self._lane and field.value in ("", *self._templates.values()):
            field.value = self._templates.get(lane, "")

    @on(Field.Changed)
    def _another_lane(self, event: Field.Changed) -> None:
        if event.field.spec.key == "lane":
            self._show_lane()
            self.check()

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        if self._lane != _SET:
            problem = fields_problem(values["request"])
            return {"request": problem} if problem else {}
        found = {} if values["name"] else {"name": CallText.NAME_MISSING()}
        try:
            set_request(values["name"], values["value"])
        except FieldError as error:
            found["value"] = str(error)
        return found

    def result(self, values: Mapping[str, str]) -> PlannedCall:
        name = self._route.topic
        if self._lane == _SET:
            made = set_request(values["name"], values["value"])
            means = f"Its new value is sent {self._where}:\n{made.meaning}"
            return PlannedCall(_SET_LANE, made.text, f"Set {values['name']} of {name}?", means, "Set", sets=True)
        service = f"{self._lane} of {name}" if self._lane else name
        fields = beginning(values["request"]) or FieldsText.ALL_DEFAULTS()
        means = f"{CallText.REQUEST_SENT(where=self._where)}\n{fields}"
        return PlannedCall(self._lane, values["request"], f"Call {service}?", means, "Call", sets=False)

    @property
    def _where(self) -> str:
        nodes = join_first(self._route.subscribers, _NODES) or "the node"
        return f"to {nodes} {f'behind {self.console.peer_of(self._route)}' if self._route.outgoing else 'on this side'}"

    # -- the call -----------------------------------------------------------------------------------------------------

    @work(group=DIALOG)
    async def accept(self, result: PlannedCall) -> None:
        if self._under_way_since is not None:
            self.notify("the previous call is not answered yet", timeout=3)
        elif await self.console.ask(ConfirmScreen(result.question, result.means, result.yes, Effect.MOVES)):
            self._pane.focus()
            self._call(result)

    @work(group="call")
    async def _call(self, request: PlannedCall) -> None:
        """Wait for the answer. Closing the form ends the wait, but not the call."""
        began = self._under_way_since = time.monotonic()
        # The answer of the call before would be taken for this one's.
        self._outcome = None
        self._draw()
        try:
            if self.console.engine is None:
                raise EngineError("no session runs")
            answer = await asyncio.wrap_future(self.console.engine.call(self._route.key, request.text, request.lane))
        except EngineError as error:
            self._outcome = CallResult(f"{FAILED} {_clean(str(error))}", "down")
        else:
            report = formats.answer_report(self._route, time.monotonic() - began)
            # The call itself succeeds if a node refuses a parameter: that is in its answer.
            if request.sets and (refused := refusal(answer)) is not None:
                text = f"{FAILED} {report}: the node refuses it: {_clean(refused)}"
                self._outcome = CallResult(text, "down", answer)
            else:
                done = CallText.VALUE_SET if request.sets else CallText.ANSWERED
                self._outcome = CallResult(_clean(done(sign=DONE, report=report)), "ok", answer)
        finally:
            self._under_way_since = None
        self._draw()
        self._pane.scroll_home(animate=False)

    def action_copy(self) -> None:
        if self._outcome is not None and self._outcome.answer:
            self.notify(copy(self.app, self._outcome.answer), timeout=3, markup=False)

    # -- the picture --------------------------------------------------------------------------------------------------

    def _draw(self) -> None:
        """Draw only the changes: laying out a long answer takes a while."""
        if not self._pane.is_attached:
            return
        self.state.set_text(self._state_text())
        width = max(10, self._pane.scrollable_content_region.width)
        progress = self._progress()
        if (progress, self._outcome, width) != self._laid_out:
            self._laid_out = (progress, self._outcome, width)
            self._pane.show(self._lines(progress, width))

    def _state_text(self) -> str:
        route = next((each for each in self.console.snapshot().routes if each.key == self._route.key), None)
        if route is None:
            return f"{FAILED} it is no longer bridged"
        reason = "" if route.state is State.OK or not route.reason else f"  {route.reason}"
        return f"{STATE_SIGN[route.state]} {STATE_WORD[route.state]}  {route.type_name}{reason}"

    def _progress(self) -> Line:
        if self._under_way_since is None:
            return ((CallText.NOTHING_CALLED(), "dim"),) if self._outcome is None else ()
        waited = formats.age(self.console.as_seen(time.monotonic() - self._under_way_since))
        if self._route.spec.kind == "action":
            return ((CallText.WAITING(sign=UNDER_WAY, waited=waited), "waiting"),)
        limit = self._route.spec.call_timeout
        return ((CallText.WAITING_UNTIL(sign=UNDER_WAY, waited=waited, limit=limit), "waiting"),)

    def _lines(self, progress: Line, width: int) -> Iterator[Line]:
        if progress:
            yield progress
        if self._outcome is not None:
            yield from (((text, self._outcome.look),) for text in textwrap.wrap(self._outcome.text, width))
            yield ()
            yield from answer_lines(self._outcome.answer, width)


def _specs(route: RouteSnapshot) -> Iterator[Spec]:
    if len(route.lanes) > 1:
        sets = [(_SET, "set one parameter")] if _SET_LANE in route.lanes else []
        yield Spec("lane", "What", "The service to call.", options=(*sets, *((lane, lane) for lane in route.lanes)))
    if _SET_LANE in route.lanes:
        yield Spec("name", "Parameter", "Its name, as the node has it: controller_frequency.")
        kinds = "5 is an integer, 5.0 a double, true a bool, [1, 2] an array; anything else is text."
        yield Spec("value", "Value", f"{kinds} The node refuses a value of another type.")
    fields = "Its fields as YAML, one a line. Missing fields get their defaults."
    yield Spec("request", "Request", fields, blank="empty: every field has its default")


def answer_lines(answer: str, width: int) -> Iterator[Line]:
    """Format an answer in YAML as lines that fit, with a note if it is cut."""
    pieces = (
        (piece, "dim" if text.startswith("#") else "")
        for text in answer.splitlines()
        # Cut first: a line of megabytes, such as an image's data, is not laid out beyond what is shown.
        for piece in (chop_cells(_clean(text[: width * (_MOST_LINES + 1)]), width) or [""])
    )
    for count, piece in enumerate(pieces):
        if count == _MOST_LINES:
            yield ((f"… only the first {formats.thousands(_MOST_LINES)} lines are shown; y copies all", "stale"),)
            return
        yield (piece,)


def _clean(text: str) -> str:
    return sanitize_text(text, len(text))

"""One change of a topic for several robots: what is typed, what it would change on each, and how it goes."""

from __future__ import annotations

import asyncio
import threading
import time
from enum import Enum, auto
from typing import TYPE_CHECKING, ClassVar

from textual import on, work
from textual.binding import Binding
from textual.screen import ModalScreen
from textual.widgets import Static

from rsb_bridge.api import EngineError
from rsb_bridge.model.text import join_first
from rsb_console.fleet.rolling import Rollout, bridged_by
from rsb_console.fleet.words import report, said, way_back
from rsb_console.look import formats
from rsb_console.look.glyphs import DONE, FAILED, UNDER_WAY
from rsb_console.screens.change_field import ChangeField, change_of
from rsb_console.widgets.dialog import Dialog
from rsb_console.widgets.form import Field, Spec
from rsb_console.widgets.picker import PickField
from rsb_console.widgets.scrolled import ScrolledLines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from textual.app import ComposeResult

    from rsb_console.console import ConsoleShell
    from rsb_console.fleet.fleet import Fleet, Robot
    from rsb_console.fleet.rolling import Bridged, Outcome, Step
    from rsb_console.widgets.lines import Line

SETTLE = 10.0
"""s that a robot has to be as well as before."""
_NAMED = 5


class Phase(Enum):
    """How far it is."""

    TYPING = auto()
    PLANNING = auto()
    ASKING = auto()
    RUNNING = auto()
    ENDED = auto()


_KEYS = {
    Phase.TYPING: "↑ ↓ ⏎ pick   ⏎ on a whole change: show what it would do   esc close",
    Phase.PLANNING: "looking …   esc close",
    Phase.ASKING: "y change them, one after the other   esc back",
    Phase.RUNNING: "esc stop after this robot",
    Phase.ENDED: "esc close",
}
_CAN_UNDO = "u put back what was before   esc close"


class RolloutScreen(ModalScreen[None]):
    """Asks for a change, shows it, and makes it after a yes.

    Args:
        console: the app.
        fleet: whose robots they are.
        robots: to change.
        settle: s that a robot has to be as well as before.
    """

    BINDINGS: ClassVar = [
        Binding("escape", "leave", show=False),
        Binding("y", "apply", show=False),
        Binding("u", "undo", show=False),
    ]
    AUTO_FOCUS = "ChangeField Input"

    def __init__(self, console: ConsoleShell, fleet: Fleet, robots: Sequence[Robot], settle: float = SETTLE) -> None:
        super().__init__()
        self.console, self._fleet, self._robots, self._settle = console, fleet, robots, settle
        self.phase = Phase.TYPING
        self.outcome: Outcome | None = None
        self.steps: list[Step] = []
        self._rollout: Rollout | None = None
        self._marks: dict[str, str] = {}
        self._put_back: set[str] = set()
        self._below: list[str] = []
        self._gone = threading.Event()
        self._lines = ScrolledLines(id="rollout")
        self._change = ChangeField(Spec("change", "Change", "", blank="/camera max_rate=5", edited=True))

    def compose(self) -> ComposeResult:
        names = join_first([robot.summary.name for robot in self._robots], _NAMED)
        yield Dialog(
            f"Edit a topic of {formats.counted(len(self._robots), 'robot')}",
            Static(names, classes="hint", markup=False),
            self._change,
            Static("", id="problem", classes="problem", markup=False),
            self._lines,
            keys=_KEYS[Phase.TYPING],
        )

    def on_mount(self) -> None:
        """Ask the robots for their topics."""
        self._change.offer()
        self._ask()

    @work(exclusive=True, group="ask", exit_on_error=False)
    async def _ask(self) -> None:
        found: list[Bridged] = []
        silent: list[str] = []
        for number, robot in enumerate(self._robots, 1):
            try:
                found += await asyncio.to_thread(bridged_by, robot)
            except EngineError:
                silent.append(robot.summary.name)
            if self._gone.is_set():
                return
            self._change.set_bridged(found, waiting=number < len(self._robots))
            asked = f"asked {number} of {len(self._robots)} robots" if number < len(self._robots) else ""
            not_reached = f"no answer from {join_first(silent, _NAMED)}" if silent else ""
            self._change.note.set_text("; ".join(filter(None, (asked, not_reached))))

    def on_unmount(self) -> None:
        """Whatever still waits for a robot ends."""
        self._gone.set()
        if self._rollout is not None:
            self._rollout.cancelled = True

    # -- phases -------------------------------------------------------------------------------------------------------

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        can_undo = phase is Phase.ENDED and self.outcome is not None and bool(self.outcome.changed)
        failed = can_undo and self.outcome is not None and bool(self.outcome.failed or self.outcome.left)
        self.query_one(".keys", Static).update(_CAN_UNDO if failed else _KEYS[phase])
        self._change.list.display = phase is Phase.TYPING
        self._show()

    @on(Field.Changed)
    def _typed(self, event: Field.Changed) -> None:
        """List suggestions, and show the first mistake in the values."""
        if not isinstance(event, PickField.Picked):
            event.stop()
            self._change.offer()
            self._say(self._change.mistake())

    @on(PickField.Picked)
    def _picked(self, event: PickField.Picked) -> None:
        """Continue the change with a picked suggestion; show the effect of a whole change."""
        event.stop()
        if self.phase is not Phase.TYPING:
            return
        if event.suggestion is not None:
            self._change.put(event.suggestion)
            return
        if (change := change_of(self._change.value)) is None:
            self._say("a topic and what to change, for example: /camera max_rate=5")
            return
        self._say("")
        self._rollout = Rollout(self._fleet, self._robots, *change, self._settle, now=time.monotonic, sleep=self._sleep)
        self._plan(self._rollout)

    def _say(self, problem: str) -> None:
        self.query_one("#problem", Static).update(problem)

    def _sleep(self, seconds: float) -> None:
        if self._gone.wait(seconds):
            raise EngineError("nobody waits for the robot any more")

    @work(exclusive=True, exit_on_error=False)
    async def _plan(self, rollout: Rollout) -> None:
        self._enter(Phase.PLANNING)
        self.steps = await asyncio.to_thread(rollout.plan)
        self._marks, self._put_back, self._below = {}, set(), []
        if any(step.new is not None for step in self.steps):
            self.set_focus(self._lines)
            self._enter(Phase.ASKING)
        else:
            self._enter(Phase.TYPING)

    @work(exclusive=True, exit_on_error=False)
    async def action_apply(self) -> None:
        """Change one robot after the other."""
        if self.phase is not Phase.ASKING or self._rollout is None:
            return
        self._enter(Phase.RUNNING)
        self.outcome = await asyncio.to_thread(self._rollout.run, self.steps, self._tell)
        outcome = self.outcome
        if outcome.failed is not None:
            self._marks[outcome.failed.robot.key] = "failed"
        if outcome.failed is not None or outcome.left:
            self._below = [*report(self._rollout, outcome), *way_back(self._rollout, outcome)]
        else:
            self._below = [f"done on {formats.counted(len(outcome.done), 'robot')}"]
        self._enter(Phase.ENDED)

    @work(exclusive=True, exit_on_error=False)
    async def action_undo(self) -> None:
        """Put back what was before."""
        if self.phase is not Phase.ENDED or self._rollout is None or self.outcome is None or not self.outcome.changed:
            return
        self._enter(Phase.RUNNING)
        failed = await asyncio.to_thread(self._rollout.undo, self.outcome, self._tell)
        names = join_first([step.name for step in self.outcome.changed], _NAMED)
        not_back = {step.robot.key for step, _ in failed}
        for step in self.outcome.changed:
            key = step.robot.key
            self._marks[key] = "failed" if key in not_back else "done"
        self._put_back = {step.robot.key for step in self.outcome.changed} - not_back
        self._below = [f"{step.name}: not put back: {why}" for step, why in failed] or [f"put back on {names}"]
        self.outcome = None
        self._enter(Phase.ENDED)

    def _tell(self, step: Step, what: str) -> None:
        """On another thread."""
        self.app.call_later(self._told, step.robot.key, what)

    def _told(self, key: str, what: str) -> None:
        if self.is_mounted and self.phase is Phase.RUNNING:
            self._marks[key] = what
            self._show()

    def action_leave(self) -> None:
        """Close it; while robots are changed, stop after the present one; before, go back to what was typed."""
        if self.phase is Phase.RUNNING:
            if self._rollout is not None:
                self._rollout.cancelled = True
        elif self.phase is Phase.ASKING:
            self.steps = []
            self.set_focus(self._change.control)
            self._enter(Phase.TYPING)
        else:
            self.dismiss()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Leave the letters to the input while somebody types (Textual's)."""
        if action == "apply":
            return self.phase is Phase.ASKING
        if action == "undo":
            return self.phase is Phase.ENDED
        return super().check_action(action, parameters)

    # -- what is shown ------------------------------------------------------------------------------------------------

    def _show(self) -> None:
        lines = [self._line(step) for step in self.steps]
        if self._below:
            lines += [(), *(((text, "strong" if not number else ""),) for number, text in enumerate(self._below))]
        self._lines.styles.height = min(len(lines), max(3, self.size.height - 12))
        self._lines.show(lines)

    def _line(self, step: Step) -> Line:
        mark = self._marks.get(step.robot.key, "")
        sign, look = {
            "": (" ", ""), "done": (DONE, "ok"), "failed": (FAILED, "down"),
        }.get(mark, (UNDER_WAY, "waiting"))  # fmt: skip
        text = said(step.reversed if step.robot.key in self._put_back else step)
        doing = f"  {mark} …" if mark and look == "waiting" and self.phase is Phase.RUNNING else ""
        of_text = "stale" if step.problem else "" if step.new is not None else "dim"
        return ((f"{sign} ", look), (f"{step.name:<14} ", "strong"), (text, of_text), (doing, "waiting"))

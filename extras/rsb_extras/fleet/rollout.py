"""One change of a topic for several robots: the field it is typed in, its effect on each robot, and its progress."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import Counter
from enum import Enum, auto
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rich.cells import cell_len
from textual import on, work
from textual.binding import Binding
from textual.screen import ModalScreen
from textual.widgets import Static

from rsb_bridge.config.file_form import KEYS
from rsb_bridge.feature_api import Effect, EngineError, join_first, plural
from rsb_console.feature_console import (
    DONE,
    FAILED,
    ConfirmScreen,
    Dialog,
    Field,
    Line,
    ScrolledLines,
    Spec,
    Suggestion,
    clip,
)
from rsb_console.notation import formats
from rsb_console.notation.glyphs import UNDER_WAY
from rsb_console.screens.topic_fields import fields_by_kind
from rsb_console.screens.topic_suggestions import padded
from rsb_console.session.draft import SWITCHES, Ends, TypedError, typed_topic, values_of
from rsb_console.terminal.input_queue import InputGate
from rsb_console.widgets.controls import FieldInput
from rsb_console.widgets.picker import PickField
from rsb_extras.fleet.rolling import Rollout, bridged_by, report, said, way_back

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from textual.app import ComposeResult

    from rsb_console.console_api import ConsoleShell
    from rsb_extras.fleet.fleet import Robot, RobotFleet
    from rsb_extras.fleet.rolling import Bridged, RobotChange, RolloutOutcome

_NAME, _COUNT, _RATE, _TYPE = (18, 40), 16, 14, 20
"""Cells of a topic's columns; the name gets the rest of the line, within bounds."""
_KEY, _VALUES = 16, 26
"""Cells of a key, and of its present values."""
_CHECKED = 5
"""Most entries against which a value is checked while it is typed; the plan checks all."""
_FIXED = ("topic", "direction", "kind")
"""Fields that identify a topic: changing one means another topic."""
SETTLE = 10.0
"""Seconds that a robot has to be as well as before. A round figure; it passes for each robot, one after the other."""
_NAMED = 5
_CAN_UNDO = "u undo the change   esc close"


class Typed(NamedTuple):
    """An incomplete change, split at its last word.

    Attributes:
        head: the words before the last one.
        last: the last word, which may be empty.
    """

    head: tuple[str, ...]
    last: str

    @classmethod
    def of(cls, text: str) -> Typed:
        """Take the text of a field apart."""
        head, _, last = text.rpartition(" ")
        return cls(tuple(head.split()), last)

    @property
    def topic(self) -> str:
        """The topic, or an empty string while it is still being typed."""
        return next((word for word in self.head if word.startswith("/")), "")

    @property
    def key(self) -> str:
        """The key whose value is being typed, or an empty string."""
        key, is_pair, _ = self.last.partition("=")
        return key if is_pair and self.topic else ""


def change_of(text: str) -> tuple[str, list[str]] | None:
    """Return the topic and the ``KEY=VALUE`` pairs of a whole change, or None if it is incomplete."""
    words = text.split()
    topics = [word for word in words if word.startswith("/")]
    keys = [word for word in words if "=" in word and not word.startswith("/")]
    whole = len(topics) == 1 and bool(keys) and len(words) == len(keys) + 1
    return (topics[0], keys) if whole else None


class ChangeField(PickField):
    """A line such as ``/camera max_rate=5`` above a list of topics, keys or values that can follow."""

    def __init__(self, spec: Spec) -> None:
        super().__init__(spec, is_literal=self._is_whole)
        self._bridged: dict[str, list[Bridged]] = {}
        self._waiting = True

    # -- the robots' entries ------------------------------------------------------------------------------------------

    def set_bridged(self, bridged: Sequence[Bridged], *, waiting: bool) -> None:
        """Offer the robots' entries.

        Args:
            bridged: all entries so far.
            waiting: whether some have not answered yet.
        """
        self._bridged = {}
        for each in bridged:
            self._bridged.setdefault(each.route.spec.topic, []).append(each)
        self._waiting = waiting
        self.offer()

    def offer(self) -> None:
        """List the suggestions for the next word."""
        typed = self.typed
        if not typed.topic:
            self.suggest(list(self._topics()), lambda _: self._no_topic(typed))
        elif typed.key:
            self.suggest(list(self._values(typed)), lambda _: self._about(typed))
        else:
            empty = f"no key is named {typed.last}" if self._entries(typed) else self._no_topic(typed)
            self.suggest(list(self._keys(typed)), lambda _: empty)

    @property
    def typed(self) -> Typed:
        """The text, split at its last word."""
        return Typed.of(self.control.value)

    def filter_text(self) -> str:
        """Return the word that narrows the list."""
        typed = self.typed
        if not typed.topic:
            return super().filter_text()
        return typed.last.partition("=")[2] if typed.key else typed.last

    def put(self, suggestion: Suggestion) -> None:
        """Append a picked suggestion to the text."""
        typed = self.typed
        head = " ".join(typed.head) if typed.topic else ""
        value = suggestion.value
        if typed.key:
            value = f"{typed.key}={value}" + ("" if value else " ")  # an empty value is one, too
        assert isinstance(self.control, FieldInput)
        self.control.value = f"{head} {value}".lstrip()
        self.control.cursor_position = len(self.control.value)
        self.offer()

    def mistake(self) -> str:
        """Return the first mistake in the typed values, or an empty string."""
        if (change := change_of(self.value)) is None:
            return ""
        topic, keys = change
        seen: list[object] = []
        for each in self._bridged.get(topic, ()):
            # Robots mostly have the same entry, which one check covers.
            if each.route.spec in seen:
                continue
            if len(seen) == _CHECKED:
                break
            seen.append(each.route.spec)
            try:
                typed_topic(values_of(each.route.spec), keys, each.session, each.route.spec)
            except TypedError as error:
                return f"{each.robot}: {error}"
        return ""

    def _is_whole(self, text: str) -> bool:
        """Whether enter takes the text; otherwise it picks a suggestion."""
        typed = self.typed
        is_open = typed.last == f"{typed.key}=" and bool(typed.key) and bool(list(self._values(typed)))
        return change_of(text) is not None and not is_open

    def _no_topic(self, typed: Typed) -> str:
        return "asking the robots …" if self._waiting else f"no robot has {typed.topic or 'such a topic'}"

    def _entries(self, typed: Typed) -> list[Bridged]:
        return self._bridged.get(typed.topic, [])

    # -- suggestions --------------------------------------------------------------------------------------------------

    def _topics(self) -> Iterator[Suggestion]:
        robots = {each.robot for entries in self._bridged.values() for each in entries}
        order = sorted(self._bridged.items(), key=lambda item: (-len({each.robot for each in item[1]}), item[0]))
        for topic, entries in order:
            count = len({each.robot for each in entries})
            of_all = f"{count} of {len(robots)} {plural(len(robots), 'robot')}"
            types = sorted({each.route.type_name for each in entries} - {""})
            kinds = sorted({each.route.spec.kind for each in entries} - {"topic"})
            about = " ".join([*kinds, join_first([name.replace("/msg/", "/") for name in types], 1)]).strip()
            rates = [each.route.rate for each in entries if each.route.spec.kind == "topic"]
            rate = f"{min(rates):.1f} Hz" if rates and min(rates) == max(rates) else ""
            if rates and not rate:
                rate = f"{min(rates):.1f}-{max(rates):.1f} Hz"
            yield Suggestion(topic, f"{topic} ", partial(_topic_line, topic, of_all, rate, about))

    def _keys(self, typed: Typed) -> Iterator[Suggestion]:
        entries = self._entries(typed)
        if not entries:
            return
        specs = self._specs(entries)
        taken = {word.partition("=")[0] for word in typed.head}
        for key, field in KEYS[entries[0].route.spec.kind].items():
            if field not in _FIXED and key not in taken:
                spec = specs.get(field)
                about = spec.help if spec is not None else ""
                yield Suggestion(key, f"{key}=", partial(_key_line, key, _now(entries, field, spec), about))

    def _values(self, typed: Typed) -> Iterator[Suggestion]:
        entries = self._entries(typed)
        if not entries:
            return
        field = KEYS[entries[0].route.spec.kind].get(typed.key, "")
        spec = self._specs(entries).get(field)
        for value, label in spec.options if spec is not None else ():
            text = value or ("no" if field in SWITCHES else "")
            yield Suggestion(f"value {text}", text, partial(_value_line, text, label))

    def _about(self, typed: Typed) -> str:
        """Return the meaning of a key and its present values."""
        entries = self._entries(typed)
        if not entries:
            return self._no_topic(typed)
        if not (field := KEYS[entries[0].route.spec.kind].get(typed.key, "")):
            return f"no key is named {typed.key}"
        spec = self._specs(entries).get(field)
        return f"{'' if spec is None else spec.help} Now: {_now(entries, field, spec)}.".strip()

    def _specs(self, entries: Sequence[Bridged]) -> dict[str, Spec]:
        """Return the fields of a topic's form by their names."""
        first = entries[0]
        ends = Ends(first.session.role == "server", first.route.link, use_name=False)
        kind = first.route.spec.kind
        return fields_by_kind(first.session, ends, first.route)[kind]


def _now(entries: Sequence[Bridged], field: str, spec: Spec | None) -> str:
    """Format the present values of a field, with their robots, the most frequent first: ``30 on 2, none on 1``."""
    distinct = dict.fromkeys((each.robot, _value(each, field, spec)) for each in entries)  # a robot may have several
    values = Counter(value for _, value in distinct)
    if len(values) == 1:
        return next(iter(values))
    return join_first([f"{value} on {count}" for value, count in values.most_common()], 3)


def _value(entry: Bridged, field: str, spec: Spec | None) -> str:
    text = values_of(entry.route.spec).get(field, "")
    if field in SWITCHES:
        return "yes" if text else "no"
    if text or spec is None:
        return text or "none"
    return dict(spec.options).get("") or ("auto" if spec.blank == "auto" else "none")


def _topic_line(topic: str, count: str, rate: str, about: str, width: int) -> Line:
    name = min(_NAME[1], max(_NAME[0], width - _COUNT - _RATE - _TYPE))
    return (*padded(topic, name, "strong"), *padded(count, _COUNT, "dim"), *padded(rate, _RATE, ""), (about, "dim"))


def _key_line(key: str, now: str, about: str, _width: int) -> Line:
    if cell_len(now) >= _VALUES:
        now = f"{clip(now, _VALUES - 2).rstrip(', ')}…"  # the most frequent values come first
    return (*padded(key, _KEY, "strong"), *padded(now, _VALUES, ""), (about, "dim"))


def _value_line(value: str, label: str, _width: int) -> Line:
    return (*padded(value, _KEY, "strong"), (label, "dim")) if value else ((label, "strong"),)


class RolloutPhase(Enum):
    TYPING = auto()
    PLANNING = auto()
    ASKING = auto()
    RUNNING = auto()
    ENDED = auto()


_KEYS = {
    RolloutPhase.TYPING: "↑ ↓ ⏎ pick   ⏎ on a whole change: show its effect   esc close",
    RolloutPhase.PLANNING: "looking …   esc close",
    RolloutPhase.ASKING: "y change them, one after the other   esc back",
    RolloutPhase.RUNNING: "esc stop after this robot",
    RolloutPhase.ENDED: "esc close",
}


class RolloutScreen(ModalScreen[None]):
    """Asks for a change, shows its effect, and applies it after a yes.

    Args:
        settle: seconds that a robot has to be as well as before.
    """

    BINDINGS: ClassVar = [
        Binding("escape", "leave", show=False),
        Binding("y", "apply", show=False),
        Binding("u", "undo", show=False),
    ]
    AUTO_FOCUS = "ChangeField Input"

    def __init__(
        self, console: ConsoleShell, fleet: RobotFleet, robots: Sequence[Robot], settle: float = SETTLE
    ) -> None:
        super().__init__()
        self.console, self._fleet, self._robots, self._settle = console, fleet, robots, settle
        self.phase = RolloutPhase.TYPING
        self.outcome: RolloutOutcome | None = None
        self.steps: list[RobotChange] = []
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
            keys=_KEYS[RolloutPhase.TYPING],
        )

    def on_mount(self) -> None:
        """Request the robots' topics."""
        self._change.offer()
        self._ask()

    # Here and below: an error of one robot must not end the screen of all.
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
        self._gone.set()
        if self._rollout is not None:
            self._rollout.cancelled = True

    # -- phases -------------------------------------------------------------------------------------------------------

    def _enter(self, phase: RolloutPhase) -> None:
        self.phase = phase
        can_undo = phase is RolloutPhase.ENDED and self.outcome is not None and bool(self.outcome.changed)
        self.query_one(".keys", Static).update(_CAN_UNDO if can_undo else _KEYS[phase])
        self._change.list.display = phase is RolloutPhase.TYPING
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
        if self.phase is not RolloutPhase.TYPING:
            return
        if event.suggestion is not None:
            self._change.put(event.suggestion)
            return
        if (change := change_of(self._change.value)) is None:
            self._say("a topic and a change, for example: /camera max_rate=5")
            return
        self._say("")
        self._rollout = Rollout(self._fleet, self._robots, *change, self._settle, now=time.monotonic, sleep=self._sleep)
        self._plan(self._rollout)

    def _say(self, problem: str) -> None:
        self.query_one("#problem", Static).update(problem)

    def _sleep(self, seconds: float) -> None:
        if self._gone.wait(seconds):
            raise EngineError("the wait for the robot was cancelled")

    @work(exclusive=True, exit_on_error=False)
    async def _plan(self, rollout: Rollout) -> None:
        self._enter(RolloutPhase.PLANNING)
        self.steps = await asyncio.to_thread(rollout.plan)
        self._marks, self._put_back, self._below = {}, set(), []
        if any(step.new is not None for step in self.steps):
            self.set_focus(self._lines)
            self._enter(RolloutPhase.ASKING)
        else:
            self._enter(RolloutPhase.TYPING)

    def action_apply(self) -> None:
        """Change one robot after the other, after a question if the key may be an old one: a change may end demands."""
        if self.phase is RolloutPhase.ASKING and self._rollout is not None:
            self._apply(self._rollout, is_sure=InputGate.of(self.app).is_young)

    @work(exclusive=True, exit_on_error=False)
    async def _apply(self, rollout: Rollout, *, is_sure: bool) -> None:
        title = f"Change {formats.counted(len(self._robots), 'robot')}?"
        question = ConfirmScreen(title, self._change.value, "Change", Effect.MOVES)
        if not is_sure and not await self.console.ask(question):
            return
        self._enter(RolloutPhase.RUNNING)
        outcome = self.outcome = await asyncio.to_thread(rollout.run, self.steps, self._tell)
        if outcome.failed is not None:
            self._marks[outcome.failed.robot.key] = "failed"
        if outcome.failed is not None or outcome.left:
            self._below = [*report(rollout, outcome), *way_back(rollout, outcome)]
        else:
            self._below = [f"done on {formats.counted(len(outcome.done), 'robot')}"]
        self._enter(RolloutPhase.ENDED)

    @work(exclusive=True, exit_on_error=False)
    async def action_undo(self) -> None:
        """Undo the change on all robots that have it, after a question."""
        if (
            self.phase is not RolloutPhase.ENDED
            or self._rollout is None
            or self.outcome is None
            or not self.outcome.changed
        ):
            return
        lines = [f"{step.name}: {said(step.reversed)}" for step in self.outcome.changed]
        title = f"Undo the change of {formats.counted(len(lines), 'robot')}?"
        if not await self.console.ask(ConfirmScreen(title, "\n".join(lines), "Undo", Effect.MOVES)):
            return
        self._enter(RolloutPhase.RUNNING)
        failed = await asyncio.to_thread(self._rollout.undo, self.outcome, self._tell)
        names = join_first([step.name for step in self.outcome.changed], _NAMED)
        not_back = {step.robot.key for step, _ in failed}
        for step in self.outcome.changed:
            key = step.robot.key
            self._marks[key] = "failed" if key in not_back else "done"
        self._put_back = {step.robot.key for step in self.outcome.changed} - not_back
        self._below = [f"{step.name}: not restored: {why}" for step, why in failed] or [f"restored on {names}"]
        self.outcome = None
        self._enter(RolloutPhase.ENDED)

    def _tell(self, step: RobotChange, what: str) -> None:
        """Report an action; called on another thread."""
        # Not call_from_thread, which would wait for a terminal that stalls.
        self.app.call_later(self._told, step.robot.key, what)

    def _told(self, key: str, what: str) -> None:
        # A report may come after the end, or after the screen has closed.
        if self.is_mounted and self.phase is RolloutPhase.RUNNING:
            self._marks[key] = what
            self._show()

    def action_leave(self) -> None:
        """Close the screen; while robots change, stop after the present one; before that, return to typing."""
        if self.phase is RolloutPhase.RUNNING:
            if self._rollout is not None:
                self._rollout.cancelled = True
        elif self.phase is RolloutPhase.ASKING:
            self.steps = []
            self.set_focus(self._change.control)
            self._enter(RolloutPhase.TYPING)
        else:
            self.dismiss()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Leave letters to the input while the operator types (Textual's)."""
        if action == "apply":
            return self.phase is RolloutPhase.ASKING
        if action == "undo":
            return self.phase is RolloutPhase.ENDED
        return super().check_action(action, parameters)

    # -- what is shown ------------------------------------------------------------------------------------------------

    def _show(self) -> None:
        lines = [self._line(step) for step in self.steps]
        if self._below:
            lines += [(), *(((text, "strong" if not number else ""),) for number, text in enumerate(self._below))]
        self._lines.styles.height = min(len(lines), max(3, self.size.height - 12))
        self._lines.show(lines)

    def _line(self, step: RobotChange) -> Line:
        mark = self._marks.get(step.robot.key, "")
        sign, look = {
            "": (" ", ""), "done": (DONE, "ok"), "failed": (FAILED, "down"),
        }.get(mark, (UNDER_WAY, "waiting"))  # fmt: skip
        text = said(step.reversed if step.robot.key in self._put_back else step)
        doing = f"  {mark} …" if mark and look == "waiting" and self.phase is RolloutPhase.RUNNING else ""
        of_text = "stale" if step.problem else "" if step.new is not None else "dim"
        return ((f"{sign} ", look), (f"{step.name:<14} ", "strong"), (text, of_text), (doing, "waiting"))

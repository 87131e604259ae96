"""Dialogs: their frame, the questions and offers that an operator answers with a button, and the steps of a restart."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from rich.cells import cell_len
from textual import work
from textual.binding import Binding
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Button, Static

from rsb_bridge.api import EngineError
from rsb_bridge.model.commands import Effect
from rsb_console.actions.all_actions import BY_ID
from rsb_console.notation import formats
from rsb_console.notation.glyphs import DONE, FAILED
from rsb_console.terminal.input_queue import SEEN_AFTER, GuardedScreen, InputGate
from rsb_console.widgets.key_hints import GAP, KeyHints, spelled
from rsb_console.widgets.lines import Line, LiveLines

if TYPE_CHECKING:
    from textual import events
    from textual.app import App, ComposeResult
    from textual.geometry import Size, Spacing
    from textual.screen import Screen
    from textual.widget import Widget

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.console_api import ConsoleShell
    from rsb_console.library_internals.textual_internals import ButtonVariant
    from rsb_console.session.changes import Undo

T = TypeVar("T")
_AROUND = 12
"""Lines that are not the message: frame, buttons, keys, the empty ones between, and below the dialog a toast."""
_SMALL_WIDTH, _SMALL_HEIGHT = 50, 12
"""Of a screen with room for a question's frame: four buttons in it take 50 cells, and a message gets four lines."""
_SCROLL = {
    "up,k": "up",
    "down,j": "down",
    "pageup": "page_up",
    "pagedown": "page_down",
    "g,home": "home",
    "G,end": "end",
}
_ASKED_LINES, _ASKED_CHARACTERS = 200, 4 << 10
"""Limits of the part of an operator's YAML that a question shows, as much as a person can read."""
RUNNING = "◌"
_NO_KEYS_YET = "…"
_SCROLL_KEYS = "↑ ↓ scroll"
_KEYS_AGAIN = "press a key, and then answer"
_LOOK_EVERY = 0.1
"""s between two looks whether the keys of a question count: so much later, at most, it says that they do."""


def suit_size(question: Screen[Any], message: Widget, size: Size) -> None:
    """Give a question's message the remaining room; on a small screen, drop the frame and the empty lines."""
    is_small = size.width < _SMALL_WIDTH or size.height < _SMALL_HEIGHT
    question.set_class(is_small, "-small")
    message.styles.max_height = None if is_small else max(1, size.height - _AROUND)


def beginning(fields: str) -> str:
    """Shorten fields in YAML for a question."""
    lines = fields[:_ASKED_CHARACTERS].splitlines()[:_ASKED_LINES]
    shown = "\n".join(lines)
    more = len(fields.rstrip()) - len(shown)
    return f"{shown}…\n(and {formats.counted(more, 'character')} more)" if more > 0 else shown


class Dialog(Vertical):
    """A dialog's widgets, with a title on the frame, and the keys as its last line; `shape` is a CSS class."""

    def __init__(self, title: str, *widgets: Widget, keys: str, shape: str = "-wide") -> None:
        super().__init__(*widgets, KeyHints(keys), classes=f"dialog {shape}")
        self.border_title = Content(title)  # plain text: names of the other side may look like markup


class FullScreen(ModalScreen[T]):
    """A screen that hides all below it, which is not drawn meanwhile."""

    BINDINGS: ClassVar = [Binding(BY_ID["new_session"].keys, "leave_for('new_session')", show=False)]

    def action_leave_for(self, action: str) -> None:
        """Close the screen, and do something of the main screen."""
        self.dismiss(None)
        # Later: the action is looked up on the screen that is on top then.
        self.app.call_later(self.app.run_action, f"screen.{action}")


class SideBox(ModalScreen[T]):
    """A box beside what is below, which stays in sight and makes room for it."""

    def room(self, size: Size) -> Spacing:
        """Return the room that it takes of a screen of a size."""
        raise NotImplementedError


class ConfirmScreen(ModalScreen[bool], GuardedScreen):
    """Yes or No, with the focus on No; escape is No.

    A message for which the screen has no room scrolls; the buttons stay in sight. On a small screen, the title stands
    above the message instead of on the frame, and scrolls with it. If Yes has an effect, keys that were
    pressed before the question was to be read are not for it.

    Args:
        title: the action: ``Remove /scan?``.
        yes: the label of its button: ``Remove``.
    """

    SAFE_KEYS = frozenset({"n", "escape", "ctrl+c"})
    seen_after = SEEN_AFTER

    BINDINGS: ClassVar = [
        Binding("y", "answer(True)", show=False),
        Binding("n,escape", "answer(False)", show=False),
        Binding("left,right", "app.focus_next", show=False),
        *(Binding(keys, f"scroll('{to}')", show=False) for keys, to in _SCROLL.items()),
    ]
    AUTO_FOCUS = "#no"
    SHAPE = ""
    VARIANT: ClassVar[ButtonVariant] = "error"
    KEYS = "y yes   n no"
    MORE_KEYS: tuple[str, ...] = ("← → ⏎ choose",)

    def __init__(self, title: str, message: str, yes: str, effect: Effect) -> None:
        super().__init__()
        self._title, self._message, self._yes = title, message, yes
        self.is_guarded = bool(effect)
        self.moves = Effect.MOVES in effect
        # Not to be focused: ← and → go from button to button.
        self._scrolled = VerticalScroll(classes="message", can_focus=False)
        self._instead_of_keys = ""
        self._keys = Static(_NO_KEYS_YET, classes="hint keys", markup=False)

    def compose(self) -> ComposeResult:
        with Vertical(classes=f"dialog {self.SHAPE}") as dialog:
            dialog.border_title = Content(self._title)
            with self._scrolled:
                yield Static(self._title, classes="title", markup=False)
                yield from self.compose_message()
            with Horizontal(classes="buttons"):
                yield from self.compose_buttons()
            yield self._keys

    def on_resize(self, event: events.Resize) -> None:
        suit_size(self, self._scrolled, event.size)
        self.call_after_refresh(self._show_keys)

    def _show_keys(self) -> None:
        keys = [self.KEYS, *self.MORE_KEYS, *([_SCROLL_KEYS] if self._scrolled.max_scroll_y > 0 else [])]
        keys = [spelled(each, ascii_only=self.app.ascii_only) for each in keys]  # type: ignore[attr-defined]
        while len(keys) > 1 and cell_len(GAP.join(keys)) > self._keys.size.width:
            keys.pop(1)  # a second line would take one from the message
        self._keys.update(self._instead_of_keys or GAP.join(keys))

    def action_scroll(self, to: str) -> None:
        """Show other lines of the message, in a direction of Textual's ``scroll_...`` methods."""
        getattr(self._scrolled, f"scroll_{to}")(animate=False)

    def compose_message(self) -> ComposeResult:
        yield Static(self._message, markup=False)

    def compose_buttons(self) -> ComposeResult:
        yield Button(self._yes, id="yes", variant=self.VARIANT, compact=True)
        yield Button("No", id="no", compact=True)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        self.dismiss(event.button.id == "yes")

    def action_answer(self, answer: bool) -> None:
        self.dismiss(answer)

    def on_mount(self) -> None:
        """Name the keys only once they count."""
        # Without a terminal, as in tests, no input is late.
        if self.is_guarded and InputGate.of(self.app).is_on:
            self._instead_of_keys = _NO_KEYS_YET
            self.call_after_refresh(self.set_interval, _LOOK_EVERY, self._name_keys_while_they_count)

    def _name_keys_while_they_count(self) -> None:
        gate, before = InputGate.of(self.app), self._instead_of_keys
        if self.drawn_at is None and gate.has_shown(self.children[0].region):
            # The time counts from the picture on: earlier, there is no question to answer.
            self.drawn_at = time.monotonic()
        waits = _KEYS_AGAIN if gate.waits_for_key(self) else _NO_KEYS_YET
        self._instead_of_keys = "" if gate.takes_keys(self) else waits
        if self._instead_of_keys != before:
            self._show_keys()


async def is_meant(console: ConsoleShell, app: App[Any], title: str, message: str, yes: str) -> bool:
    """Whether the operator means a key that lets messages cross: it is young, or they confirm it."""
    if InputGate.of(app).is_young:
        return True
    return await console.ask(ConfirmScreen(title, message, yes, Effect.MOVES)) is True


class ArmScreen(ConfirmScreen):
    """Asks whether to arm a topic or a service."""

    def __init__(self, route: RouteSnapshot) -> None:
        deadman = route.arming.deadman if route.arming is not None else 0.0
        keys = f", or no key is pressed here for {deadman:g} s" if deadman else ""
        way = f"to {route.remote_topic} on the other side" if route.outgoing else f"from there to {route.topic} here"
        what = "messages" if route.calls is None else "calls"
        now = f"\n{formats.drivers_now(route)}" if route.calls is None else ""
        means = (
            f"From now on its {what} cross the link of {route.link}, {way}: {route.link} may move.\n"
            f"It disarms when the link drops, this console ends{keys}.{now}"
        )
        super().__init__(f"Arm {route.topic} of {route.link}?", means, "Arm", Effect.MOVES)


class OfferScreen(ConfirmScreen):
    """A question with the focus on Yes, as Yes loses nothing."""

    AUTO_FOCUS = "#yes"
    VARIANT = "primary"

    def __init__(self, title: str, message: str, yes: str) -> None:
        super().__init__(title, message, yes, Effect.HARMLESS)


class UndoScreen(ConfirmScreen):
    """Yes or No. The focus is on No if the undo removes something, or lets messages cross that do not cross now."""

    SHAPE = "-wide"

    def __init__(self, undo: Undo) -> None:
        super().__init__(undo.title, "\n".join(undo.lines), undo.yes, Effect.MOVES | Effect.LOSES)
        self._careful = undo.careful

    def on_mount(self) -> None:
        # Textual calls the handler of ConfirmScreen, too.
        if not self._careful:
            self.query_one("#yes").focus()

    def compose_buttons(self) -> ComposeResult:
        yield Button(self._yes, id="yes", variant="error" if self._careful else "primary", compact=True)
        yield Button("No", id="no", compact=True)


class Steps(LiveLines, can_focus=False):
    """The steps so far, each with its duration."""

    def __init__(self) -> None:
        super().__init__(id="steps")
        self._steps: list[tuple[str, float]] = []
        self._end: tuple[str, str, float] | None = None  # look, message and time

    @property
    def line_count(self) -> int:
        return len(self._steps) + (self._end is not None)

    def line(self, index: int) -> Line:
        if index == len(self._steps):
            assert self._end is not None
            look, message, _ = self._end
            return ((f"{DONE if look == 'ok' else FAILED} ", look), (message, look))
        message, began = self._steps[index]
        if index + 1 < len(self._steps):
            look, ended = "ok", self._steps[index + 1][1]
        elif self._end is not None:
            look, _, ended = self._end
        else:
            return ((f"{RUNNING} ", "waiting"), (message, "strong"))
        sign = DONE if look == "ok" else FAILED
        return ((f"{sign} ", look), (f"{message:<60}", ""), (f"{ended - began:6.2f} s", "dim"))

    def add(self, message: str) -> None:
        self._steps.append((message, time.monotonic()))
        self._lay_out()

    def end(self, look: str, message: str) -> None:
        self._end = (look, message, time.monotonic())
        self._lay_out()

    def _lay_out(self) -> None:
        self.styles.height = self.line_count
        self.sync()


class RestartScreen(ModalScreen[None]):
    """Restarts an engine at once; closing the dialog does not stop the restart."""

    BINDINGS: ClassVar = [Binding("escape,q", "dismiss", show=False)]

    def __init__(self, engine: EngineApi) -> None:
        super().__init__()
        self._engine = engine
        self.steps = Steps()

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog -steps") as dialog:
            dialog.border_title = "Restart"
            yield self.steps
            with Horizontal(classes="buttons"):
                yield Button("Close", compact=True)

    def on_button_pressed(self) -> None:
        self.dismiss()

    @work
    async def on_mount(self) -> None:
        def step(message: str) -> None:  # on the engine's thread, which must not wait for us
            self.call_later(self.steps.add, message)

        try:
            await asyncio.wrap_future(self._engine.restart(step))
        except EngineError as error:
            self.steps.end("down", str(error))
        else:
            self.steps.end("ok", "restarted")

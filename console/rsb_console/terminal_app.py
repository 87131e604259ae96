"""The common part of all terminal apps: themes, keys, help, order of input, and an end that restores the terminal."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import inspect
import os
import signal
import sys
import threading
import traceback
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from platformdirs import user_log_path
from rich.console import COLOR_SYSTEMS
from textual import events, work
from textual.app import App, ReturnType
from textual.screen import Screen, SystemModalScreen
from textual.signal import Signal

from rsb_bridge.config.files import make_folder, owner_only, remove_file
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import several_lines
from rsb_console.actions.action import Action, Group, call_of, late_modules
from rsb_console.actions.all_actions import ACTIONS, bindings
from rsb_console.library_internals.rich_internals import colours_of, use_colours
from rsb_console.library_internals.textual_internals import ChopsUpdate, LayoutUpdate, OpenApp, style_scope
from rsb_console.notation.formats import AGE_STEP
from rsb_console.notation.glyphs import STATE_SIGN, AsciiFilter, ControlFilter
from rsb_console.preferences import (
    DEFAULT_THEME,
    LIGHT_THEME,
    REFRESH_RATES,
    SIXTEEN_COLORS,
    SIXTEEN_ON_LIGHT,
    THEME_VARIABLES,
    PreferenceError,
    Preferences,
    config_path,
)
from rsb_console.screens.help import ActionsProvider
from rsb_console.terminal import desktop_notification
from rsb_console.terminal.driver import ConsoleDriver
from rsb_console.terminal.input_queue import InputGate, InputQueue, is_guarded
from rsb_console.terminal.pulse import ASKED_EVERY
from rsb_console.terminal.screen_writer import NoTerminal, ScreenWriter
from rsb_console.terminal.terminal_facts import facts_before_answers
from rsb_console.widgets.lines import LOOK_CLASSES

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from types import FrameType

    from rich.console import RenderableType
    from textual.filter import LineFilter
    from textual.widget import Widget

    from rsb_console.preferences import Setting
    from rsb_console.terminal.terminal_facts import TerminalFacts

T = TypeVar("T")
_PREPARES_AFTER = 1.0
"""s after the first picture. A round figure: what the console shows at first is there by then."""
_BETWEEN_IMPORTS = 0.05
"""s in which keys have their effect. A round figure: an import takes up to 0.05 s of a core."""
_ENDS_WITHIN = 10.0
"""s. A round figure: with much less, a busy machine would leave the terminal as the app has it."""


class ShutdownReason(Enum):
    QUIT = "quit"
    TERMINATED = "terminated"
    HANGUP = "hangup"
    CRASH = "crash"


_SIGNALS = {
    signal.SIGTERM: ShutdownReason.TERMINATED,
    signal.SIGINT: ShutdownReason.TERMINATED,
    signal.SIGHUP: ShutdownReason.HANGUP,
}


class TerminalApp(OpenApp[ReturnType]):
    """Fulfils `rsb_console.console_api.ConsoleShell`.

    Args:
        theme: name of the theme, or None for one that suits the terminal.
        config: the user's configuration folder, or None for the platform's.
        dialogs: groups of the workers that may open a dialog.

    Attributes:
        needs_young_keys: something can be driven, armed, resumed or linked again, so that the terminal has to prove how
            young its keys are.
        terminal: file descriptor of the terminal.
        facts: what the terminal can show, as far as it is known.
        text_drawn: published when text was written: for each part of a line the row, the first column, and the column
            behind the last one.
        terminal_changed: published when the terminal is found to show other things than before.
        pictures: widgets whose content is written after all else.
        signals: the reasons that signals and a terminal that is gone gave to shut down, also to an app that had ended.
        writer: writes the screen to the terminal.
    """

    TITLE = "rsb-console"
    CSS_PATH = Path(__file__).with_name("console.tcss")
    COMPONENT_CLASSES: ClassVar[set[str]] = set(LOOK_CLASSES.values())
    BINDINGS = bindings(Group.CONSOLE)
    COMMANDS: ClassVar = {ActionsProvider}
    actions: Sequence[Action] = ACTIONS
    refresh_rate: float
    needs_young_keys = False
    terminal = 1

    def __init__(
        self,
        *,
        readonly: bool,
        ascii_only: bool,
        theme: str | None,
        config: Path | None,
        dialogs: Collection[str] = (),
    ) -> None:
        super().__init__(driver_class=ConsoleDriver)
        self._readonly = readonly
        self.ascii_only = self._ascii_always = ascii_only
        self.config = config_path() if config is None else config
        self.preferences = Preferences(self.config, theme)
        self.facts = self.preferences.terminal.over(facts_before_answers(os.environ, self.terminal))
        if self.preferences.terminal.colours is not None:
            self._use_colours()
        self._without_control, self._to_ascii = ControlFilter(), AsciiFilter()
        self.shutdown_reason = ShutdownReason.QUIT
        self.signals: set[ShutdownReason] = set()
        self.input_queue = InputQueue(self, dialogs)
        self.input_gate = InputGate(self)
        self.text_drawn: Signal[Sequence[tuple[int, int, int]]] = Signal(self, "text-drawn")
        self.terminal_changed: Signal[TerminalFacts] = Signal(self, "terminal-changed")
        self.writer: ScreenWriter | NoTerminal = NoTerminal()
        self.pictures: set[Widget] = set()
        self._forced_end: threading.Timer | None = None

    @property
    def readonly(self) -> bool:
        return self._readonly

    def stop(self) -> None:
        """Close what must not stay open; may take some seconds, on any thread."""
        raise NotImplementedError

    def pull(self) -> None:
        raise NotImplementedError

    # --- what Textual asks

    def get_theme_variable_defaults(self) -> dict[str, str]:
        return THEME_VARIABLES

    def get_line_filters(self) -> Sequence[LineFilter]:
        return [*super().get_line_filters(), self._without_control, *([self._to_ascii] if self.ascii_only else [])]

    def on_mount(self) -> None:
        # The key t goes through all themes. Only ours are checked to keep to the 256 colours that SSH leaves.
        for name in self.available_themes:
            self.unregister_theme(name)
        for theme in self.preferences.themes.values():
            self.register_theme(theme)
        self.theme = self.preferences.theme
        self.set_keymap(self.preferences.keymap)
        if isinstance(self.driver_now, ConsoleDriver):
            self.input_gate.pulse = self.driver_now.pulse
            self.set_interval(ASKED_EVERY, self._look_at_terminal)
            # A worker, as a timer's own call would let keys wait for all of it.
            self.set_timer(_PREPARES_AFTER, lambda: self.run_worker(call_of(prepare, self), exit_on_error=False))

    def _look_at_terminal(self) -> None:
        if isinstance(self.driver_now, ConsoleDriver):
            self.driver_now.look_for_answers()
            is_guarding = any(map(is_guarded, self.screen_stack))
            if (self.needs_young_keys or is_guarding) and self.driver_now.pulse.is_due(at_rest=not is_guarding):
                self.driver_now.ask()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Disable the actions that change something while read-only."""
        known = next((each for each in self.actions if each.id == action), None)
        if known is not None and known.changes and self.readonly:
            return False
        return super().check_action(action, parameters)

    async def on_event(self, event: events.Event) -> None:
        """Handle an event as Textual does, but input only when it is its turn."""
        if isinstance(event, events.Resize):
            self.writer.forget()
        elif isinstance(event, events.Key | events.MouseDown) and not event.is_forwarded:
            self.writer.expect_effect()
        # The queue comes first: until an event's turn, another screen may be on top, which takes late keys or does not.
        if self.input_queue.takes(event):
            return
        if event.is_forwarded or not self.screen_stack or not self.input_gate.refuses(event, self.screen):
            await super().on_event(event)

    def write_drawn(self, screen: Screen[Any], renderable: RenderableType | None) -> None:
        if not isinstance(renderable, ChopsUpdate | LayoutUpdate) or not isinstance(self.driver_now, ConsoleDriver):
            super().write_drawn(screen, renderable)
            if isinstance(renderable, ChopsUpdate):
                self.text_drawn.publish(renderable.spans)
            elif isinstance(renderable, LayoutUpdate):
                region = renderable.region
                self.text_drawn.publish([(y, region.x, region.right) for y in region.line_range])
        elif self.draws:
            if isinstance(self.writer, NoTerminal):
                self.writer = self.input_gate.sight = ScreenWriter(
                    self, self.driver_now, colours_of(self.console), self.pictures, self.text_drawn.publish
                )
            self.writer.draw(renderable)

    # --- the terminal

    @property
    def losses(self) -> int:
        """Number of times that the terminal was cleared."""
        return self.driver_now.losses if isinstance(self.driver_now, ConsoleDriver) else 0

    def write_to_terminal(self, sequence: str) -> None:
        """Write what Textual does not know of, such as an image. It has to leave cursor and colours as they were."""
        if sequence and isinstance(self.driver_now, ConsoleDriver):
            self.driver_now.write(sequence)

    # --- what screens ask

    def as_seen(self, seconds: float) -> float:
        """Return an age or the present time (s) as it is when the operator sees it, on a terminal that is late.

        A lateness that no age would show changes nothing.
        """
        late = self.writer.late
        return seconds + late if late >= AGE_STEP else seconds

    def tell_problems(self) -> None:
        """Tell what is wrong with the preferences."""
        for title, message in self.preferences.problems:
            self.notify(message, title=title, severity="warning", markup=False, timeout=15)

    def key_labels(self, action: Action) -> list[str]:
        return self.preferences.key_labels(action, ascii_only=self.ascii_only)

    def entitle(self, name: str, faults: int) -> None:
        """Show in the terminal's title what the app is about, and how many faults it has."""
        sign = "x" if self.ascii_only else STATE_SIGN[State.DOWN]
        title = " ".join(filter(None, (name or self.TITLE, f"{sign}{faults}" if faults else "")))
        if isinstance(self.driver_now, ConsoleDriver):
            self.driver_now.entitle("".join(filter(str.isprintable, title)))

    @work
    async def tell_desktop(self, title: str, text: str) -> None:
        """Show a notification on the operator's desktop by way of the terminal, if it supports that."""
        made = await asyncio.to_thread(desktop_notification.sequence, os.environ, self.facts.name, title, text)
        if made and isinstance(self.driver_now, ConsoleDriver):
            self.driver_now.write(made)

    async def ask(self, dialog: Screen[T]) -> T | None:
        self.input_queue.waits_for(dialog)
        return await self.push_screen_wait(dialog)

    def begin_pulling(self) -> None:
        """Call `pull` as often as `refresh_rate` says, from now on."""
        self._pulling = self.set_interval(1 / self.refresh_rate, self.pull)

    def action_faster(self) -> None:
        self._change_refresh_rate(1)

    def action_slower(self) -> None:
        self._change_refresh_rate(-1)

    def _change_refresh_rate(self, step: int) -> None:
        index = REFRESH_RATES.index(self.refresh_rate) + step
        self.refresh_rate = REFRESH_RATES[max(0, min(len(REFRESH_RATES) - 1, index))]
        self._pulling.stop()  # Textual cannot change the interval of a timer
        self.begin_pulling()
        self.remember("refresh_rate", self.refresh_rate)
        self.pull()

    def remember(self, name: str, value: Setting) -> bool:
        try:
            self.preferences.remember(name, value)
        except PreferenceError as error:
            self.notify(str(error), title="Not kept", severity="warning", markup=False, timeout=8)
            return False
        return True

    # --- actions

    def key_question_mark(self) -> None:
        """Show the keys. Textual calls this if no binding has the key: dialogs' bindings leave out the app's."""
        from rsb_console.screens.help import HelpScreen  # noqa: PLC0415 -- keeps the start short

        if not isinstance(self.screen, HelpScreen | SystemModalScreen):
            self.action_help()

    key_f1 = key_question_mark

    def action_help(self) -> None:
        from rsb_console.screens.help import HelpScreen  # noqa: PLC0415 -- keeps the start short

        self.push_screen(HelpScreen(self, self.actions, self.screen))

    async def action_help_quit(self) -> None:  # type: ignore[override]  # Textual's waits for nothing
        """Ctrl+C: Textual would only explain it; to an operator it means quit."""
        await self.run_action("app.quit")

    action_palette = OpenApp.action_command_palette

    def suit_terminal(self, facts: TerminalFacts) -> None:
        """Draw with the colours that the terminal has, in a theme for them."""
        facts = self.preferences.terminal.over(facts)
        had, self.facts = self.facts, facts
        self.ascii_only = self._ascii_always or facts.ascii_only
        if (facts.colours, facts.ascii_only) != (had.colours, had.ascii_only):
            self._use_colours()
            self.refresh_css(animate=False)
            for screen in self.screen_stack:
                for widget in screen.walk_children(with_self=True):
                    widget.refresh()  # lines that are drawn already stay as they are, without a new style
        few, many = (SIXTEEN_COLORS, SIXTEEN_ON_LIGHT), (DEFAULT_THEME, LIGHT_THEME)
        if self.preferences.suits_terminal and self.theme in (*few, *many):
            self.theme = (many if facts.colours > 16 else few)[bool(facts.light)]
        elif self.theme == SIXTEEN_COLORS and facts.light:
            self.theme = SIXTEEN_ON_LIGHT
        self.terminal_changed.publish(facts)

    def _use_colours(self) -> None:
        """Have Textual write the colours that the terminal has: rich finds them out by TERM, and once."""
        if self.console.color_system is not None and self.facts.colours:
            use_colours(self.console, COLOR_SYSTEMS[self.facts.colour_system])
            self.writer.use_colours(colours_of(self.console))

    def action_theme(self) -> None:
        names = sorted(self.available_themes)
        self.preferences.suits_terminal = False
        self.theme = names[(names.index(self.theme) + 1) % len(names)]
        self.remember("theme", self.theme)
        self.notify(f"theme: {self.theme}", timeout=2)

    def action_mouse(self) -> None:
        """Leave the mouse to the terminal, or take it back."""
        if isinstance(self.driver_now, ConsoleDriver):
            self.driver_now.mouse = not self.driver_now.mouse
            self.notify(f"the mouse is the {'console' if self.driver_now.mouse else 'terminal'}'s", timeout=3)

    # --- end

    def shut_down(self, reason: ShutdownReason) -> None:
        """End the app; what it shows goes on until `stop`."""
        self.shutdown_reason = reason
        self.exit()

    def shut_down_on_signals(self) -> None:
        """Have SIGTERM, SIGINT and SIGHUP call `shut_down_soon`.

        These handlers outlive the app's event loop, unlike asyncio's: a second SIGHUP is usual, and must not kill a
        bridge that goes on without the console.
        """

        def signalled(number: int, _: FrameType | None) -> None:
            reason = _SIGNALS[signal.Signals(number)]
            self.signals.add(reason)
            self.shut_down_soon(reason)

        for number in _SIGNALS:
            signal.signal(number, signalled)

    def shut_down_soon(self, reason: ShutdownReason) -> None:
        """Call `shut_down` from a signal handler or another thread; end the process if the app hangs."""
        # In tests the process is theirs, and must not be killed.
        if self._forced_end is None and not self.is_headless:
            self._forced_end = threading.Timer(_ENDS_WITHIN, self._force_end)
            self._forced_end.daemon = True
            self._forced_end.start()
        # Not call_from_thread, which waits for the app for as long as a terminal stalls it.
        self.call_later(self.shut_down, reason)

    def _force_end(self) -> None:
        self.stop()
        os._exit(1)  # sys.exit would end this thread only

    def has_ended(self) -> None:
        """Note that the app has ended by itself, so the process is not killed."""
        if self._forced_end is not None:
            self._forced_end.cancel()
            self._forced_end = None

    def terminal_gone(self) -> None:
        """Shut down because the terminal has hung up; called by the driver's thread."""
        self.signals.add(ShutdownReason.HANGUP)
        self.shut_down_soon(ShutdownReason.HANGUP)

    def failed(self) -> None:
        self.crashed()
        super().failed()

    def crashed(self) -> None:
        """Write the exception that is being handled to `crash_path`, if that is possible, for a report."""
        self.shutdown_reason = ShutdownReason.CRASH
        path = crash_path()
        with contextlib.suppress(OSError):
            make_folder(path.parent)
            remove_file(path)  # one of before may be open to others
            with open(path, "w", encoding="utf-8", opener=owner_only) as file:
                file.write(several_lines(traceback.format_exc()))


async def prepare(app: App[Any]) -> None:
    """Do what would hold up the first key that opens a box: 0.3 s of a core, on a busy machine seconds.

    What fails is left to the key that needs it.
    """
    for module in late_modules():
        if module not in sys.modules:
            with contextlib.suppress(Exception):
                import_module(module)
            await asyncio.sleep(_BETWEEN_IMPORTS)
    with contextlib.suppress(Exception):
        _read_styles(app)
    gc.collect()
    gc.freeze()  # a collection of everything holds up a key for 0.07 s


def _read_styles(app: App[Any]) -> None:
    """Read the styles of all screens. With those of each new one, Textual reads all again."""
    kinds: list[type[Screen[Any]]] = [Screen]
    styles = app.stylesheet.copy()  # faulty ones would end the app when it changes its theme
    for kind in kinds:
        kinds += kind.__subclasses__()
        if kind.CSS:
            try:
                file = inspect.getfile(kind)
            except (TypeError, OSError):
                file = ""  # as in Textual
            scope = style_scope(kind) if kind.SCOPED_CSS else ""
            styles.add_source(kind.CSS, read_from=(file, f"{kind.__name__}.CSS"), scope=scope)
    styles.parse()
    app.stylesheet = styles
    styles.update(app)


def crash_path() -> Path:
    """Return the file that describes the last crash."""
    return user_log_path("rsb-console") / "crash.txt"


def output_path() -> Path:
    """Return the file that libraries' own output goes to while the app has the terminal."""
    return user_log_path("rsb-console") / "output.txt"

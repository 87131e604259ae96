"""The inside of Textual: what drives the terminal, draws, and hands messages on.

Importing this mends three faults of Textual: bytes that are not UTF-8, sizes that alternate, and timers that skip their
only call.
"""

from __future__ import annotations

from codecs import getincrementaldecoder
from functools import partial
from typing import TYPE_CHECKING, Any

from textual._ansi_sequences import SYNC_END, SYNC_START
from textual._compositor import ChopsUpdate, LayoutUpdate
from textual._parser import ParseTimeout
from textual._xterm_parser import XTermParser
from textual.app import App, ReturnType
from textual.command import CommandPalette
from textual.drivers import linux_driver
from textual.drivers.linux_driver import LinuxDriver
from textual.keys import _character_to_key as key_of
from textual.message_pump import MessagePump
from textual.screen import Screen, ScreenResultType
from textual.widget import Widget
from textual.widgets._button import ButtonVariant
from textual.widgets._toast import Toast, ToastRack

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable
    from queue import Queue
    from threading import Thread

    from rich.console import RenderableType
    from textual import events
    from textual.content import Content
    from textual.driver import Driver
    from textual.timer import Timer

__all__ = [
    "PALETTE_GROUP", "SYNC_END", "SYNC_START", "ButtonVariant", "ChopsUpdate", "DrawsChangesOnly", "HasPlace",
    "KeyReader", "LayoutUpdate", "OpenApp", "TerminalDriver", "Toast", "ToastRack", "crash", "entitle",
    "has_messages", "holds_message", "is_idle", "key_of", "read_keys_with", "style_scope",
]  # fmt: skip

# --- keys

# Textual 8 ends on bytes that are not UTF-8, such as the legacy mouse reports that tmux sends (its issue 6668).
_lenient = partial(getincrementaldecoder("utf-8"), "replace")
vars(linux_driver)["getincrementaldecoder"] = lambda _encoding: _lenient


class KeyReader(XTermParser):
    """Textual's reader of keys. It waits after an Escape, which may begin a sequence, and nothing public ends that."""

    @property
    def waits(self) -> bool:
        """Whether an Escape waits for what follows."""
        return self._awaiting.timeout is not None

    def wait_no_longer(self) -> None:
        """Let an Escape wait without an end."""
        self._timeout_time = None

    def end_escape(self) -> None:
        """Take the Escape that waits for a key: what Textual does itself once its timeout is over."""
        self._timeout_time = None
        self._awaiting = self._gen.throw(ParseTimeout())

    def drop_keys(self) -> None:
        """Drop the keys that are read, and not given yet."""
        self._tokens.clear()

    def keys_of(self, sequence: str, alt: bool) -> Iterable[events.Key]:
        """Return the keys that a sequence means."""
        return super()._sequence_to_key_events(sequence, alt)

    def _sequence_to_key_events(self, sequence: str, alt: bool = False) -> Iterable[events.Key]:
        return self.keys_of(sequence, alt)


def read_keys_with(make: Callable[[bool], KeyReader]) -> None:
    """Have drivers read keys with a reader of one's own: they make one by the class's name."""
    vars(linux_driver)["XTermParser"] = make


# --- the terminal


class TerminalDriver(LinuxDriver):
    """Textual's driver. It leaves open to nobody where it writes, whether it may, and the modes that it sets.

    Attributes:
        app: the app that it serves.
    """

    def __init__(self, app: Any, file: Any, **options: Any) -> None:
        super().__init__(app, **options)
        self.app = app
        self._file = file

    def terminal_size(self) -> tuple[int, int]:
        """Return columns and rows, as the environment or standard output says."""
        return super()._get_terminal_size()

    def _get_terminal_size(self) -> tuple[int, int]:
        return self.terminal_size()

    @property
    def writer(self) -> Thread | None:
        """The thread that writes to the terminal, in application mode."""
        return self._writer_thread

    @property
    def queue(self) -> Queue[str | None]:
        """The texts that the thread has not written yet, at most 30; None ends it."""
        assert self._writer_thread is not None, "application mode"
        return self._writer_thread._queue

    @property
    def can_synchronize(self) -> bool:
        """Whether the terminal can show a frame at once."""
        available: bool = self.app._sync_available
        return available

    @property
    def tells_size_among_keys(self) -> bool:
        return self._in_band_window_resize

    @tells_size_among_keys.setter
    def tells_size_among_keys(self, tells: bool) -> None:
        self._in_band_window_resize = tells

    @property
    def mouse_in_pixels(self) -> bool:
        return self._mouse_pixels

    @mouse_in_pixels.setter
    def mouse_in_pixels(self, wanted: bool) -> None:
        self._mouse_pixels = wanted

    def set_mouse(self) -> None:
        """Set the modes of the mouse again."""
        self._enable_mouse_support()

    def set_text_modes(self) -> None:
        """Set the other modes again, and ask whether the terminal can show frames at once and tell its size."""
        self._enable_bracketed_paste()
        self._disable_line_wrap()
        self._request_terminal_sync_mode_support()
        self._query_in_band_window_resize()

    @property
    def mouse(self) -> bool:
        """Whether the app gets mouse events. If not, the terminal has the mouse, for selecting text."""
        return self._mouse

    @mouse.setter
    def mouse(self, wanted: bool) -> None:
        if not wanted:
            # Textual writes this only while the mouse counts as on, so before the change.
            self._disable_mouse_support()
        self._mouse = wanted
        self._enable_mouse_support()

    @property
    def resumes(self) -> bool:
        """Whether SIGTSTP came before SIGCONT, so that the driver takes the terminal back by itself."""
        return self._must_signal_resume

    def continued(self) -> None:
        """Take the terminal back, as SIGCONT came."""
        super()._sigcont_application()

    def _sigcont_application(self, *_: object) -> None:
        self.continued()


_textual_on_resize = Screen._on_resize


async def _on_resize(screen: Screen[Any], event: events.Resize) -> None:
    """Take a size, unless the terminal has another one by now.

    Each size that a screen takes comes back to it as one more event once it is laid out. With two sizes in flight, as
    when a terminal is resized while the app starts, or with COLUMNS and LINES of another size, they alternate for ever,
    at 100 % CPU, and the app does not go on.
    """
    if event.size == screen.app.size:
        await _textual_on_resize(screen, event)


Screen._on_resize = _on_resize  # type: ignore[method-assign, assignment]

# --- messages

PALETTE_GROUP = CommandPalette._GATHER_COMMANDS_GROUP
"""The group of the workers that search for a command palette: more input has to wait for what they find."""

_textual_set_timer = MessagePump.set_timer


def _set_timer(pump: MessagePump, *arguments: Any, **options: Any) -> Timer:
    """Make a timer of one call, which it does not skip.

    Textual skips a call whose time is over when the timer begins, as on a machine that is busy for so long: with the
    only one lost, a message stayed for ever, or no further size of the terminal was taken
    (findings/textual-one-shot-timer.sh).
    """
    timer = _textual_set_timer(pump, *arguments, **options)
    timer._skip = False
    return timer


MessagePump.set_timer = _set_timer  # type: ignore[method-assign, assignment]


def has_messages(pump: MessagePump) -> bool:
    """Whether messages wait for a pump."""
    return not pump._message_queue.empty()


def holds_message(pump: MessagePump) -> bool:
    """Whether a pump has taken a message that it has not begun with, which its queue does not show any more."""
    return pump._pending_message is not None


def is_idle(pump: MessagePump) -> bool:
    """Whether a message pump waits for its next message."""
    ready: asyncio.Event = pump._message_queue.ready_event
    return bool(ready._waiters) and not ready.is_set()


# --- drawing


def crash(app: App[Any], error: Exception) -> None:
    """End an app by an exception, as one of its own handlers would, where asyncio has called and not Textual."""
    app._handle_exception(error)


class OpenApp(App[ReturnType]):
    """An app whose drawing and whose end can be another one's."""

    @property
    def driver_now(self) -> Driver | None:
        """The terminal's driver, or None before the app runs."""
        return self._driver

    @property
    def draws(self) -> bool:
        """Whether it runs, and shows what it draws: in a batch, it draws at its end."""
        return self._running and not self._closed and not self._batch_count

    def write_drawn(self, screen: Screen[Any], renderable: RenderableType | None) -> None:
        """Write what a screen has drawn."""
        super()._display(screen, renderable)

    def _display(self, screen: Screen[Any], renderable: RenderableType | None) -> None:
        self.write_drawn(screen, renderable)

    def failed(self) -> None:
        """Handle an exception that nothing else handles. Textual would print it with all local variables."""
        self._close_messages_no_wait()

    def _fatal_error(self) -> None:
        self.failed()


class DrawsChangesOnly(Screen[ScreenResultType]):
    """A screen that draws only what has changed.

    Below a box, Textual then draws all of a screen once more, and pictures would take each other's sixels away. A class
    names this one last, as Textual takes the style of its first base.
    """

    def _compositor_refresh(self) -> None:
        super()._compositor_refresh()
        if self is not self.app.screen:
            self._repaint_required = False


class HasPlace(Widget):
    """A widget with a place in its form, which counts when the focus goes on.

    Textual orders widgets by their place on the screen. One that has just appeared has none yet and would come before
    all others, so that fast typing would go to it. A class names this one last, as Textual takes the style of its first
    base.

    Attributes:
        position: its place among the widgets of its form.
    """

    position = 0

    @property
    def _focus_sort_key(self) -> tuple[int, int]:
        return self.position, 0


def style_scope(kind: type[Screen[Any]]) -> str:
    """Return the name by which the styles of a class of screens are kept to it."""
    name: str = kind._css_type_name
    return name


def entitle(widget: Widget, title: Content) -> None:
    """Set the title on a widget's border. Textual's public attribute has all of the widget drawn."""
    widget._border_title = title

"""The terminal under the app: one that stops reading, sends broken bytes or goes away must cost pictures only."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
from codecs import getincrementaldecoder
from functools import partial
from queue import Full
from typing import TYPE_CHECKING, Any

from textual.drivers import linux_driver
from textual.drivers.linux_driver import LinuxDriver

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path
    from queue import Queue

# Textual 8 dies of bytes that are no UTF-8, like the legacy mouse reports that tmux sends: its issue 6668.
_lenient = partial(getincrementaldecoder("utf-8"), "replace")
vars(linux_driver)["getincrementaldecoder"] = lambda _encoding: _lenient

_LOOK_EVERY_MS = 500
CLOSE_TIMEOUT = 1.0  # s until a terminal that does not read is given up


@contextlib.contextmanager
def terminal_to_itself(log: Path) -> Iterator[int]:
    """Give the terminal to the app alone: what else writes to descriptors 1 and 2, as Fast DDS does, goes to `log`.

    Args:
        log: what was in it before is lost; where it cannot be written, nothing is kept.

    Yields:
        A descriptor of the terminal. It is never closed: a thread may be stuck in a write to it.
    """
    sys.stdout.flush()
    terminal, errors = os.dup(1), os.dup(2)
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        target = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o600)
    except OSError:
        target = os.open(os.devnull, os.O_WRONLY)
    os.dup2(target, 1)
    os.dup2(target, 2)
    os.close(target)
    try:
        yield terminal
    finally:
        sys.stdout.flush()
        os.dup2(terminal, 1)
        os.dup2(errors, 2)
        os.close(errors)


class TerminalFile:
    """The terminal as a file that writes straight through, and says so once when it is gone.

    A buffered stream would be locked by a write that never ends, and hold up the interpreter's exit.
    """

    def __init__(self, fd: int, gone: Callable[[], None]) -> None:
        self._fd = fd
        self._gone: Callable[[], None] | None = gone

    def write(self, text: str) -> None:
        """Write all of `text`; blocks while the terminal does not read."""
        data = text.encode("utf-8", "replace")
        while data and self._gone is not None:
            try:
                data = data[os.write(self._fd, data) :]
            except OSError:
                self.hung_up()

    def hung_up(self) -> None:
        """The terminal is gone; there is nobody to tell but the app."""
        gone, self._gone = self._gone, None
        if gone is not None:
            gone()

    def flush(self) -> None:
        """Nothing is held back."""

    def fileno(self) -> int:
        return self._fd


class ConsoleDriver(LinuxDriver):
    """Textual's driver, whose `write` never blocks the app.

    Textual hands frames to a thread through a queue of 30 and waits when that is full: with the app would wait its keys
    and signals. Here what doesn't fit is dropped, and once the terminal reads again the whole screen is drawn anew.
    """

    def __init__(self, app: Any, **options: Any) -> None:
        super().__init__(app, **options)
        self._file: Any = TerminalFile(app.terminal, app.terminal_gone)
        self._behind = False
        self._unwatched = threading.Event()
        self._continuing = False

    def _get_terminal_size(self) -> tuple[int, int]:
        """Columns and lines; Textual would ask standard output, which need not be the terminal."""
        with contextlib.suppress(OSError):
            columns, lines = os.get_terminal_size(self._file.fileno())
            if columns and lines:
                return columns, lines
        return super()._get_terminal_size()

    @property
    def _queue(self) -> Queue[str | None]:
        assert self._writer_thread is not None, "application mode"
        return self._writer_thread._queue

    def write(self, data: str) -> None:
        """Hand `data` to the terminal, or drop it if that is far behind."""
        if self._behind and self._queue.empty():
            self._behind = False
            self._app.call_later(self._app.refresh)
        try:
            self._queue.put_nowait(data)
        except Full:
            self._behind = True

    @property
    def mouse(self) -> bool:
        """Whether the app gets the mouse; else it is the terminal's, to select text with."""
        return self._mouse

    @mouse.setter
    def mouse(self, wanted: bool) -> None:
        if not wanted:
            self._disable_mouse_support()
        self._mouse = wanted
        self._enable_mouse_support()

    def _sigcont_application(self, *_: object) -> None:
        """Take the terminal again, soon: signals may come faster than that goes, and one taking is enough for all."""
        if self._writer_thread is not None and not self._continuing:
            self._continuing = True
            self._app.call_later(self._continue)

    def _continue(self) -> None:
        """Take the terminal again, and draw everything.

        Textual would begin a second time where SIGTSTP had not ended the first, as after SIGSTOP and at a hangup: it
        would leave threads behind, and raw mode as the one to go back to.
        """
        self._continuing = False
        if not self._must_signal_resume:
            self.suspend_application_mode()
        super()._sigcont_application()
        self._app.refresh()

    def run_input_thread(self) -> None:
        """Read keys until the terminal is gone: what reads as nothing would be read again and again."""
        self._unwatched = ended = threading.Event()
        threading.Thread(target=self._watch_hangup, args=(ended,), name="terminal-hangup", daemon=True).start()
        with contextlib.suppress(OSError):
            super().run_input_thread()

    def _watch_hangup(self, ended: threading.Event) -> None:
        poll = select.poll()
        poll.register(self.fileno, 0)  # POLLHUP and POLLERR are told unasked
        while not ended.is_set():
            if poll.poll(_LOOK_EVERY_MS):
                ended.set()
                self.exit_event.set()
                self._file.hung_up()

    def close(self) -> None:
        """Let the last frames out, unless the terminal does not read."""
        self._unwatched.set()
        thread = self._writer_thread
        if thread is None:
            return
        try:
            self._queue.put(None, timeout=CLOSE_TIMEOUT)
        except Full:
            return  # a daemon thread: it ends with the process
        thread.join(CLOSE_TIMEOUT)


def prefers_ascii(environ: Mapping[str, str]) -> bool:
    """Whether the terminal is better given no Unicode: the locale isn't UTF-8, or it is Linux's own console.

    Args:
        environ: the process's; where no locale is set, Python has made it C.UTF-8 (PEP 538).
    """
    locale = environ.get("LC_ALL") or environ.get("LC_CTYPE") or environ.get("LANG") or "C.UTF-8"
    return "utf" not in locale.lower() or environ.get("TERM") == "linux"

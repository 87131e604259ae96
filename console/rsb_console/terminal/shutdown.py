"""The end of the app: why it came, the signals that bring it, and what is kept of a crash."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import traceback
from enum import Enum
from typing import TYPE_CHECKING

from platformdirs import user_log_path

from rsb_bridge.config.files import owner_only
from rsb_bridge.model.text import several_lines

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from types import FrameType


class ShutdownReason(Enum):
    QUIT = "quit"
    TERMINATED = "terminated"
    HANGUP = "hangup"
    CRASH = "crash"


ENDS_WITHIN = 10.0
"""s. A round figure: with much less, a busy machine would leave the terminal as the app has it."""
_FAILURE = 1  # exit status

SIGNALS = {
    signal.SIGTERM: ShutdownReason.TERMINATED,
    signal.SIGINT: ShutdownReason.TERMINATED,
    signal.SIGHUP: ShutdownReason.HANGUP,
}


class ForcedEnd:
    """Ends the process if the app hangs while it shuts down.

    Args:
        stop: called first; closes what must not stay open.
    """

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop = stop
        self._timer: threading.Timer | None = None

    def begin(self) -> None:
        """Give the app `ENDS_WITHIN` to shut down, counted from the first call."""
        if self._timer is None:
            self._timer = threading.Timer(ENDS_WITHIN, self._end)
            self._timer.daemon = True
            self._timer.start()

    def cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _end(self) -> None:
        self._stop()
        os._exit(_FAILURE)  # sys.exit would end this thread only


def shut_down_on_signals(shut_down: Callable[[ShutdownReason], None]) -> None:
    """Have SIGTERM, SIGINT and SIGHUP call `shut_down`.

    These handlers outlive the app's event loop, unlike asyncio's: a second SIGHUP is usual, and must not kill a bridge
    that goes on without the console.
    """

    def handle(number: int, _frame: FrameType | None) -> None:
        shut_down(SIGNALS[signal.Signals(number)])

    for number in SIGNALS:
        signal.signal(number, handle)


def crash_path() -> Path:
    """Return the file that describes the last crash."""
    return user_log_path("rsb-console") / "crash.txt"


def output_path() -> Path:
    """Return the file that libraries' own output goes to while the app has the terminal."""
    return user_log_path("rsb-console") / "output.txt"


def record_crash() -> None:
    """Write the exception that is being handled to `crash_path`, if that is possible."""
    path = crash_path()
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)  # one of before may be open to others
        with open(path, "w", encoding="utf-8", opener=owner_only) as file:
            file.write(several_lines(traceback.format_exc()))

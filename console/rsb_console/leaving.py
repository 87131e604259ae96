"""The end of the app: why it came, and what becomes of the bridge."""

from __future__ import annotations

import contextlib
import signal
import traceback
from enum import Enum
from typing import TYPE_CHECKING

from platformdirs import user_log_path

from rsb_console.shell import FAILURE, OK, complain

if TYPE_CHECKING:
    from pathlib import Path
    from types import FrameType

    from rsb_console.app import ConsoleApp


class Leaving(Enum):
    """Why the app ended."""

    QUIT = "quit"
    TERMINATED = "terminated"
    HANGUP = "hangup"
    CRASH = "crash"


SIGNALS = {
    signal.SIGTERM: Leaving.TERMINATED,
    signal.SIGINT: Leaving.TERMINATED,
    signal.SIGHUP: Leaving.HANGUP,
}


def leave_on_signals(app: ConsoleApp) -> None:
    """End `app` cleanly on SIGTERM, SIGINT and SIGHUP.

    These handlers outlive the app's event loop, as asyncio's would not: a second SIGHUP, which is usual, must not kill
    a bridge that is to go on.
    """

    def handle(number: int, _frame: FrameType | None) -> None:
        app.leave_soon(SIGNALS[signal.Signals(number)])

    for number in SIGNALS:
        signal.signal(number, handle)


def crash_path() -> Path:
    """Where the last crash of the app is told."""
    return user_log_path("rsb-console") / "crash.txt"


def output_path() -> Path:
    """Where libraries' own output goes while the app has the terminal."""
    return user_log_path("rsb-console") / "output.txt"


def record_crash() -> None:
    """Write the error that is being handled where it can be reported from, if it can be written there."""
    path = crash_path()
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(traceback.format_exc(), encoding="utf-8")


def finish(app: ConsoleApp, on_hangup: str) -> int:
    """Stop the engine that the app has left, or bridge on without it.

    Args:
        app: has ended.
        on_hangup: ``stop`` or ``continue``.

    Returns:
        The exit code.
    """
    crashed = app.leaving is Leaving.CRASH
    code = FAILURE if crashed else OK
    if crashed:
        complain(f"the console has crashed; please report {crash_path()}")
    if app.engine is not None and (crashed or (app.leaving is Leaving.HANGUP and on_hangup == "continue")):
        from rsb_console.headless import bridge_on  # noqa: PLC0415 -- seldom needed

        code = bridge_on(app.engine, crashed=crashed)
    app.stop()
    return code

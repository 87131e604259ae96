"""An app in the terminal: its run, and the exit code that follows from its end."""

from __future__ import annotations

import os
from typing import Any, TypeVar

from rsb_bridge.control.control_sockets import identify
from rsb_bridge.model.commands import acting
from rsb_console.command.shell import FAILURE, HUNG_UP, OK, print_error
from rsb_console.terminal.driver import terminal_to_itself
from rsb_console.terminal_app import ShutdownReason, TerminalApp, crash_path, output_path

T = TypeVar("T")


def run_app(app: TerminalApp[T], *, mouse: bool) -> T | None:
    """Run an app in the terminal and return its result. `TerminalApp.shutdown_reason` has the reason for its end."""
    # The handlers come before the terminal is prepared: a SIGTERM meanwhile has to leave it as it was, too.
    app.shut_down_on_signals()
    returned = None
    try:
        with terminal_to_itself(output_path()) as app.terminal, acting(identify(os.getpid(), os.geteuid())):
            returned = app.run(mouse=mouse)
    except Exception:  # noqa: BLE001 -- the bridge survives any failure of the app
        app.crashed()
    app.has_ended()
    return returned


def exit_code(app: TerminalApp[Any]) -> int:
    if app.shutdown_reason is ShutdownReason.CRASH:
        print_error(f"the console has crashed; please report {crash_path()}")
        return FAILURE
    return HUNG_UP if app.shutdown_reason is ShutdownReason.HANGUP else OK

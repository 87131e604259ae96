"""The console as a command, and the bridge after its app has ended."""

from __future__ import annotations

import os
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.config.session_file import load
from rsb_bridge.model.commands import ReleaseArmed
from rsb_console.app import ConsoleApp
from rsb_console.command import app_run
from rsb_console.notation.ascii_signs import prefers_ascii
from rsb_console.terminal_app import ShutdownReason

if TYPE_CHECKING:
    from contextlib import ExitStack
    from pathlib import Path

    from rsb_bridge.api import EngineApi
    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.control.control_server import ControlServer
    from rsb_bridge.model.session import Session
    from rsb_console.command.target import Attach


def run_console(
    path: Path | None,
    *,
    readonly: bool = False,
    ascii_only: bool = False,
    theme: str | None = None,
    on_hangup: str = "stop",
    control: Path | None = None,
    attach_to: Path | Attach | None = None,
    mouse: bool = True,
    temporary: bool = False,
    resources: ExitStack | None = None,
) -> int:
    """Open the console, and return when both it and the engine have ended.

    Args:
        path: session file to run, or None to ask.
        theme: name of the theme, or None for one that suits the terminal.
        on_hangup: ``stop`` or ``continue``: the bridge's reaction when the terminal hangs up.
        control: control socket to serve the engine on, or None for one in the user's folder.
        attach_to: control socket of a bridge to attach to, or a function that attaches to one, or None.
        temporary: whether the session file is deleted when the session ends, as the demo's is.
        resources: closed when that session ends, or None.

    Returns:
        The exit code: 0, 1 after a crash of the app, or 129 if the terminal has gone.

    Raises:
        SessionError: the session file has mistakes.
    """
    app = ConsoleApp(
        load(path) if path is not None else None,
        path,
        readonly=readonly,
        ascii_only=ascii_only or prefers_ascii(os.environ),
        theme=theme,
        serve=partial(_serve, control),
        attach_to=attach_to,
        temporary=temporary,
        resources=resources,
    )
    app_run.run_app(app, mouse=mouse)
    return _finish(app, on_hangup)


def _serve(
    control: Path | None, engine: EngineApi, session: Session, path: Path | None
) -> tuple[ControlServer | None, RunningBridge | None]:
    """Serve an engine that is about to start, or find the bridge that runs its session."""
    from rsb_bridge.control.bridges import AlreadyRunningError, serve  # noqa: PLC0415 -- keeps the start short

    try:
        return serve(engine, session, file=path, control=control), None
    except AlreadyRunningError as error:
        return None, error.bridge


def _finish(app: ConsoleApp, on_hangup: str) -> int:
    """Stop the engine, or bridge on without the app. Return the exit code."""
    crashed = app.shutdown_reason is ShutdownReason.CRASH
    survives_hangup = on_hangup == "continue"
    goes_on = crashed or (app.shutdown_reason is ShutdownReason.HANGUP and survives_hangup)
    # This reports the crash, before `bridge_on` prints hours of log.
    code = app_run.exit_code(app)
    if app.engine is not None and not app.attached_to and goes_on:
        from rsb_console.command.headless import Signals, bridge_on  # noqa: PLC0415 -- seldom needed

        ends = {ShutdownReason.TERMINATED} if survives_hangup else {ShutdownReason.TERMINATED, ShutdownReason.HANGUP}
        with Signals(ignore_hangup=True, has_terminal=True) as signals:
            # One that came before was the app's, which had ended.
            if app.signals.isdisjoint(ends):
                app.has_ended()
                # Nobody presses keys any more, so that nothing may stay armed for this console.
                app.engine.do(ReleaseArmed())
                code = bridge_on(app.engine, signals, crashed=crashed)
    app.stop()
    return code

"""The fleet's screen as a command: it gives way to the console on a robot, and comes back after it."""

from __future__ import annotations

import os
from functools import partial
from typing import TYPE_CHECKING, Any

from rsb_console.command.console import run_app
from rsb_console.command.shell import FAILURE, HUNG_UP, OK, print_error
from rsb_console.fleet_app import BRIDGES_GO_ON, FleetApp, RobotApp
from rsb_console.terminal.driver import prefers_ascii
from rsb_console.terminal.shutdown import ShutdownReason, crash_path
from rsb_console.widgets.fleet_table import FleetView

if TYPE_CHECKING:
    from rsb_console.fleet.fleet import Fleet
    from rsb_console.terminal_app import TerminalApp


def run_fleet(
    fleet: Fleet,
    *,
    readonly: bool,
    ascii_only: bool,
    theme: str | None,
    mouse: bool,
    after_quit: str = BRIDGES_GO_ON,
) -> int:
    """Show the fleet, and the robots that the operator opens, until they quit.

    Args:
        fleet: started.
        readonly: nothing may be changed.
        ascii_only: draw only ASCII, whatever the terminal can do.
        theme: its name; None: the one that suits the terminal.
        mouse: take the mouse from the terminal.
        after_quit: says whether the bridges go on when the operator quits.

    Returns:
        The exit code: 0, 1 after a crash, or 129 if the terminal has gone.
    """
    view, ascii_only = FleetView(), ascii_only or prefers_ascii(os.environ)
    while True:
        app = FleetApp(fleet, view, readonly=readonly, ascii_only=ascii_only, theme=theme, after_quit=after_quit)
        robot = run_app(app, mouse=mouse)
        if robot is None or app.shutdown_reason is not ShutdownReason.QUIT:
            return _code(app)
        theme = app.theme
        console = RobotApp(
            None,
            None,
            readonly=readonly,
            ascii_only=ascii_only,
            theme=theme,
            attach_to=partial(robot.source.open, robot.summary.name, read_only=readonly),
        )
        run_app(console, mouse=mouse)
        console.stop()
        if console.shutdown_reason is not ShutdownReason.QUIT:
            return _code(console)
        theme = console.theme


def _code(app: TerminalApp[Any]) -> int:
    if app.shutdown_reason is ShutdownReason.CRASH:
        print_error(f"the console has crashed; please report {crash_path()}")
        return FAILURE
    return HUNG_UP if app.shutdown_reason is ShutdownReason.HANGUP else OK

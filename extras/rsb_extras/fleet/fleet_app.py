"""The apps of a fleet: the screen of all robots, and the console on one of them."""

from __future__ import annotations

import os
from functools import partial
from typing import TYPE_CHECKING, Any

from textual import work

from rsb_bridge.feature_api import Effect
from rsb_console.app import SSH_RATE, ConsoleApp
from rsb_console.command import app_run
from rsb_console.feature_console import DIALOG, MainScreen, TerminalApp
from rsb_console.notation.ascii_signs import prefers_ascii
from rsb_console.terminal_app import ShutdownReason
from rsb_extras.fleet.fleet_actions import FLEET_ACTIONS
from rsb_extras.fleet.fleet_screen import FleetScreen
from rsb_extras.fleet.fleet_table import FleetView

if TYPE_CHECKING:
    from pathlib import Path

    from textual.screen import Screen

    from rsb_console.feature_console import Action
    from rsb_extras.fleet.fleet import Robot, RobotFleet

_BRIDGES_GO_ON = "All bridges go on; only this console ends."
_OPENS_ANOTHER = frozenset({"sessions", "new_session", "import_session", "demo", "welcome"})


class FleetApp(TerminalApp["Robot"]):
    """Shows the robots of a fleet until the operator opens one, which it returns, or quits.

    Args:
        fleet: a started fleet, which outlives the app.
        theme: name of the theme, or None for one that suits the terminal.
        config: the user's configuration folder, or None for the platform's.
        after_quit: text about the bridges when the operator quits, or empty if they go on.
    """

    actions = FLEET_ACTIONS

    def __init__(
        self,
        fleet: RobotFleet,
        view: FleetView,
        *,
        readonly: bool = False,
        ascii_only: bool = False,
        theme: str | None = None,
        config: Path | None = None,
        after_quit: str = "",
    ) -> None:
        super().__init__(readonly=readonly, ascii_only=ascii_only, theme=theme, config=config)
        self._after_quit = after_quit
        self.main = FleetScreen(self, fleet, view, self._open)
        self.refresh_rate = self.preferences.refresh_rate or SSH_RATE

    def get_default_screen(self) -> Screen[Any]:
        return self.main

    def on_ready(self) -> None:
        self.tell_problems()
        self.begin_pulling()
        self.pull()

    def pull(self) -> None:
        if self.screen_stack:
            self.main.show()
            self.entitle("fleet", self.main.fault_count)

    def _open(self, robot: Robot) -> None:
        self.exit(robot)

    @work(exclusive=True, group=DIALOG)
    async def action_quit(self) -> None:  # type: ignore[override]  # a worker, because it asks
        from rsb_console.feature_console import ConfirmScreen  # noqa: PLC0415 -- keeps the start short

        effect = Effect.LOSES if self._after_quit else Effect.HARMLESS
        if await self.ask(ConfirmScreen("Quit?", self._after_quit or _BRIDGES_GO_ON, "Quit", effect)):
            self.shut_down(ShutdownReason.QUIT)

    def stop(self) -> None:
        """Stop nothing: the fleet belongs to the caller."""


class RobotScreen(MainScreen):
    """The main screen of one robot of a fleet: escape returns to the fleet if nothing else is open."""

    def act(self, action: Action) -> None:
        """Do an action; go back to the fleet if there is nothing else to go back from."""
        shows_all = self.topics.pattern is None and not self.topics.faults_only
        if action.id == "back" and self.mode is None and self.topics.has_focus and shows_all:
            self.console.request_quit()
        else:
            super().act(action)


class RobotApp(ConsoleApp):
    """The console on one robot. It ends without a question, as nothing is lost and the fleet's screen returns."""

    main_screen = RobotScreen

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Forbid opening another session in the robot's place (Textual's): leaving would end it without a question."""
        return action not in _OPENS_ANOTHER and super().check_action(action, parameters)

    def request_quit(self) -> None:
        self.shut_down(ShutdownReason.QUIT)

    async def action_quit(self) -> None:  # type: ignore[override]  # ConsoleApp's is a worker, because it asks
        self.request_quit()


def run_fleet(
    fleet: RobotFleet,
    *,
    readonly: bool = False,
    ascii_only: bool = False,
    theme: str | None = None,
    mouse: bool = True,
    after_quit: str = "",
) -> int:
    """Show the fleet, and the robots that the operator opens, until they quit.

    Args:
        ascii_only: draw only ASCII, even if the terminal can draw more.
        theme: name of the theme, or None for one that suits the terminal.
        mouse: take the mouse from the terminal.
        after_quit: text about the bridges when the operator quits, or empty if they go on.

    Returns:
        The exit code: 0, 1 after a crash, or 129 if the terminal has gone.
    """
    view, ascii_only = FleetView(), ascii_only or prefers_ascii(os.environ)
    while True:
        app = FleetApp(fleet, view, readonly=readonly, ascii_only=ascii_only, theme=theme, after_quit=after_quit)
        robot = app_run.run_app(app, mouse=mouse)
        if robot is None or app.shutdown_reason is not ShutdownReason.QUIT:
            return app_run.exit_code(app)
        # Each app is a new one, and the operator's choice of a theme would be lost with each robot that is opened.
        theme = app.theme
        console = RobotApp(
            None,
            None,
            readonly=readonly,
            ascii_only=ascii_only,
            theme=theme,
            attach_to=partial(robot.source.open, robot.summary.name, read_only=readonly),
        )
        app_run.run_app(console, mouse=mouse)
        console.stop()
        if console.shutdown_reason is not ShutdownReason.QUIT:
            return app_run.exit_code(console)
        theme = console.theme

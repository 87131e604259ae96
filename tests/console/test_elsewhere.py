"""The console of an operator who may look, on a robot of another machine: it offers no change, and reads no files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.console.driving import drive, scripted_app, shown, until
from tests.support.operators import BOB, Reachable, granted

from rsb_bridge.config.keys import write_key
from rsb_console.screens.keys_screen import KeysScreen

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.control import Machine
    from textual.pilot import Pilot


def test_who_may_look_has_console_that_only_looks(machine: Machine, tmp_path: Path) -> None:
    write_key(tmp_path / "r.key")  # of the name that the robot's session has, where its files would be
    robot = Reachable(machine, file=tmp_path / "robot1.yaml")
    app = scripted_app(session=None, path=None, attach_to=lambda: robot.attach("bob", BOB))

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        assert app.readonly
        await pilot.press("p")
        await pilot.press("K")
        await until(pilot, lambda: isinstance(app.screen, KeysScreen), "the keys")
        assert isinstance(app.screen, KeysScreen)
        assert app.screen.table.selected is None
        await pilot.press("escape")
        robot.access.grant(granted("bob", BOB, "change"))
        await until(pilot, lambda: not app.readonly and app.snapshot().running, "the rights of now")
        await pilot.press("p")
        await until(pilot, lambda: bool(robot.engine.commands), "a change")

    drive(app, steps)
    app.stop()
    assert [name for name, *_ in robot.engine.commands] == ["pause"], "one, after the rights were given"

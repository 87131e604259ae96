"""F6 shows how the session file differs from what runs, and has the bridge do what it says if the operator agrees."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace
from tests.console.driving import engine_of, on_main, shown

from rsb_bridge.model.commands import Reload
from rsb_bridge.model.snapshot import Reloaded
from rsb_console.operations.bridge_operations import ReloadText
from rsb_console.screens.dialog import ConfirmScreen

if TYPE_CHECKING:
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp


@on_main()
async def test_what_differs_is_shown_before_anything_changes(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("f6")
    await shown(pilot, "/scan (transmit): max_rate none → 5.0")
    assert engine_of(app).commands == [("reload", True, "drop_arm")]
    assert isinstance(app.screen, ConfirmScreen)
    assert app.screen.is_guarded  # the file may end demands, and resume topics
    await pilot.press("n")
    await pilot.press("f6")
    await shown(pilot, "/scan (transmit): max_rate none → 5.0")
    await pilot.press("y")
    await shown(pilot, "reloaded")
    assert engine_of(app).commands == [
        ("reload", True, "drop_arm"),
        ("reload", True, "drop_arm"),
        ("reload", False, "drop_arm"),
    ]


@on_main()
async def test_failure_is_told_and_session_differs_from_file(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine_of(app).reloads = Reloaded(("/scan: added",), failed=("/scan: no leave",), digest="seen")
    saved, engine_of(app).session = app.saved, replace(engine_of(app).session, stale_after=9.0)
    await pilot.press("f6")
    await shown(pilot, "/scan: added")
    await pilot.press("y")
    await shown(pilot, "/scan: no leave")
    assert app.saved == saved
    assert engine_of(app).given[-1] == Reload(drop_arm=True, seen="seen")


@on_main()
async def test_what_cannot_change_is_said(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine_of(app).reloads = Reloaded((), ("server_port 1 → 2: restart",))
    await pilot.press("f6")
    await shown(pilot, "server_port 1 → 2: restart")
    engine_of(app).reloads = Reloaded()
    await pilot.press("f6")
    await shown(pilot, ReloadText.AS_IN_FILE)
    assert engine_of(app).commands == [("reload", True, "drop_arm"), ("reload", True, "drop_arm")]

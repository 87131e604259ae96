"""The screen of a node's parameters: its list, a form with a question for each change, and the way from the node."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.console.driving import NARROW, WIDE, engine_of, gone, notified, on_main, shown, text, until

from rsb_bridge.api import EngineError
from rsb_extras.node_control.lifecycle_rows import LifecycleText
from rsb_extras.node_control.parameter_requests import ReadParameters
from rsb_extras.node_control.parameters_screen import ParametersScreen, ParametersScreenText

if TYPE_CHECKING:
    import pytest
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp
    from rsb_extras.node_control.parameter_records import NodeParameter

NODE = "/nav/planner_server"


def told(app: ConsoleApp) -> list[tuple[Any, ...]]:
    """Return the values that the engine was told to set."""
    commands: list[Any] = [each for each in engine_of(app).commands if each[0] == "change nodes"]
    return [(*each[1:4], *(value.value.plain() for value in each[4])) for each in commands]


async def opened(app: ConsoleApp, pilot: Pilot[None], parameter: str = "") -> ParametersScreen:
    screen = ParametersScreen(app, "robot1", NODE)
    app.push_screen(screen)
    await shown(pilot, "7 parameters, 1 read-only, 0 changed")
    while parameter and screen.table.cursor_key != parameter:
        await pilot.press("j")
    return screen


@on_main(WIDE, NARROW)
async def test_parameters_are_shown_with_their_marks(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(app, pilot, "max_speed")
    lines = [" ".join(line.strip(" │▌").split()) for line in text(app).splitlines()]
    assert "max_speed 0.5 double" in lines
    assert any(line == "serial A-17 string read-only" for line in lines)
    assert any(line.startswith("description (string") and line.endswith(" string") for line in lines)
    await shown(pilot, "read at")
    await shown(pilot, "0 to 2 in steps of 0.1; m/s, in the plane")
    await pilot.press("slash", *"plug", "enter")
    await gone(pilot, "max_speed")
    await shown(pilot, "planner.plugins")
    await pilot.press("escape")
    await shown(pilot, "max_speed")


@on_main(NARROW)
async def test_values_of_a_lost_side_keep_their_time(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    await opened(app, pilot)

    def answer(_: ReadParameters) -> tuple[NodeParameter, ...]:
        raise EngineError("robot1 is not linked: no route to host")

    monkeypatch.setattr("tests.console.scripted.answers", lambda: {ReadParameters: answer})
    await pilot.press("r")
    await shown(pilot, "robot1 is not linked: no route to host")
    await shown(pilot, "max_speed")
    assert "read at" in text(app)


@on_main(NARROW)
async def test_a_change_is_checked_and_asked_first(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(app, pilot, "max_speed")
    await pilot.press("enter")
    await shown(pilot, "double, in YAML.")
    await pilot.press("ctrl+u", *"2.5")
    await shown(pilot, "2.5 is not in its range, 0 to 2 in steps of 0.1")
    await pilot.press("ctrl+u", *"1", "enter")
    await shown(pilot, f"Set max_speed of {NODE}?")
    await shown(pilot, "max_speed: 0.5 → 1.0")
    assert told(app) == []
    await pilot.press("y")
    await until(pilot, lambda: told(app) == [(NODE, "set", "robot1", 1.0)], "the change")
    await notified(pilot, LifecycleText.ENDED, target=NODE, side="the server")


@on_main(NARROW)
async def test_what_cannot_be_changed_says_so(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(app, pilot, "serial")
    await pilot.press("enter")
    await notified(pilot, ParametersScreenText.MAY_NOT, name="serial", reason="it is read-only")
    assert told(app) == []


@on_main(NARROW, readonly=True)
async def test_a_read_only_console_only_reads(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await opened(app, pilot, "max_speed")
    await pilot.press("enter")
    await notified(pilot, ParametersScreenText.READ_ONLY)


@on_main(WIDE)
async def test_a_node_leads_to_its_parameters(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("H")
    await shown(pilot, "planner_server")
    nodes = app.screen
    await shown(pilot, "p parameters")
    while nodes.table.cursor_key != NODE:  # type: ignore[attr-defined]  # the screen of nodes
        await pilot.press("j")
    await pilot.press("p")
    await shown(pilot, "7 parameters, 1 read-only")
    await pilot.press("escape")
    await until(pilot, lambda: app.screen is nodes, "the nodes")

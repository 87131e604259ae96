"""Every button of every dialog, pressed as an operator does: each does its thing once, and the console goes on."""

import re
from pathlib import Path
from typing import Any

import pytest
from tests.console.driving import ended, fill, on_main, put, shown, text, until
from tests.console.scripted import SESSION, route
from textual.pilot import Pilot
from textual.screen import Screen
from textual.widgets import Button

import rsb_console
from rsb_bridge.config.session_file import save
from rsb_bridge.model.snapshot import ArmingSnapshot
from rsb_console.app import ConsoleApp
from rsb_console.screens.session_files import FileText
from rsb_console.screens.take_over import AskHolderScreen
from rsb_console.widgets.form import FieldSearch

KEYS = {  # dialog: the key that opens it on the main screen
    "Sessions": "o",
    "New session": "f2",
    "Import": "f3",
    "Save as": "W",
    "Add a topic": "a",
    "Edit": "e",
    "Remove": "d",
    "Restart?": "R",
    "Quit?": "q",
}
LABELS = {
    "Sessions": ["Open", "Cancel", "New…", "Import…", "Save", "Save as…"],
    "New session": ["Bluetooth…", "Create", "Cancel"],
    "Import": ["Import", "Cancel"],
    "Save as": ["Save", "Cancel"],
    "Add a topic": ["Go to (F7)", "More (F8)", "Add", "Cancel"],
    "Edit": ["Go to (F7)", "Change", "Cancel"],
    "Remove": ["Remove", "No"],
    "Restart?": ["Restart", "No"],
    "Quit?": ["Quit", "No"],
}
FILLED = {
    "Sessions": {"path": "nav2.yaml"},
    "New session": {"name": "robot7", "server_ip": "10.0.0.20"},
    "Save as": {"path": "other.yaml"},
    "Add a topic": {"topic": "/added"},
}
BACK = ("Cancel", "No")
PRESSES = [(dialog, label) for dialog, labels in LABELS.items() for label in labels if label not in BACK]


def buttons(app: ConsoleApp) -> dict[str, Button]:
    return {str(button.label): button for button in app.screen.query(Button)}


async def press(app: ConsoleApp, pilot: Pilot[None], dialog: str, label: str) -> None:
    await pilot.press(KEYS[dialog])
    await until(pilot, lambda: list(buttons(app)) == LABELS[dialog], f"the dialog {dialog}")
    await fill(pilot, **FILLED.get(dialog, {}))
    screen = app.screen
    buttons(app)[label].focus()
    await pilot.press("enter")
    if label == "More (F8)":
        await shown(pilot, "Stale after")
    elif label == "Go to (F7)":
        await until(pilot, lambda: isinstance(app.focused, FieldSearch), "the search for a field")
    elif label == "Import":  # nothing is filled in
        await shown(pilot, FileText.MISSING)
    else:
        await until(pilot, lambda: app.screen is not screen or ended(app), f"{label} to do something")
    await pilot.pause()  # what is dismissed twice fails now
    assert not app.return_code, text(app)


def nav2() -> dict[str, Any]:
    path = Path("nav2.yaml").resolve()
    save(SESSION, path)
    return {"path": path}


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(("dialog", "label"), PRESSES)
@on_main(before=nav2)
async def test_every_button_with_enter(app: ConsoleApp, pilot: Pilot[None], dialog: str, label: str) -> None:
    await press(app, pilot, dialog, label)


@pytest.mark.usefixtures("folder")
@on_main(before=nav2)
async def test_every_button_that_leads_back(app: ConsoleApp, pilot: Pilot[None]) -> None:
    for dialog, labels in LABELS.items():
        (label,) = set(labels) & set(BACK)
        await press(app, pilot, dialog, label)
        await until(pilot, lambda: app.screen is app.main, "the main screen")


@pytest.mark.parametrize(("button", "answer"), [("yes", True), ("take", True), ("disarm", True), ("no", False)])
@on_main()
async def test_a_question_closes_itself_alone(app: ConsoleApp, pilot: Pilot[None], button: str, answer: bool) -> None:
    below: Screen[None] = Screen()
    answers: list[bool | None] = []
    await app.push_screen(below)
    held = route("/cmd_vel", arming=ArmingSnapshot(armed=True, by="anna"))
    put(app, held)
    await app.push_screen(AskHolderScreen(app, held, may_take=True), answers.append)
    app.screen.query_one(f"#{button}", Button).focus()
    await pilot.press("enter")
    await until(pilot, lambda: bool(answers), "an answer")
    await pilot.pause()
    assert (answers, app.screen) == ([answer], below)


def test_no_handler_calls_the_one_of_its_base() -> None:
    """Textual calls the handlers of all classes by itself, so it would run twice."""
    for path in Path(rsb_console.__file__).parent.rglob("*.py"):
        assert not re.search(r"super\(\)\.on_(?!event)", path.read_text(encoding="utf-8")), path

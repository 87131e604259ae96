"""Toasts cover neither a form nor a question nor the log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.driving import NARROW, on_main, shown, until
from tests.support.long import long
from textual.widgets._toast import Toast

from rsb_bridge.model.commands import Effect
from rsb_console.screens.dialog import ConfirmScreen
from rsb_console.screens.save_screens import ChangedScreen
from rsb_console.screens.topic_form import TopicScreen

if TYPE_CHECKING:
    from collections.abc import Callable

    from textual.geometry import Region
    from textual.pilot import Pilot
    from textual.screen import Screen

    from rsb_console.app import ConsoleApp

SIZES = [(200, 50), *long((120, 36), (100, 30)), (80, 24)]
TEXT = "the session is saved, and one topic of it could not be added: it is bridged already by another client"


async def toast_on(pilot: Pilot[None], screen: Screen[Any]) -> Region:
    pilot.app.notify(TEXT, title="Not done", severity="error", markup=False)
    await until(pilot, lambda: any(each.region for each in screen.query(Toast)), "a toast")
    return screen.query_one(Toast).region


@on_main(*SIZES)
async def test_on_the_main_screen_and_on_a_form(app: ConsoleApp, pilot: Pilot[None]) -> None:
    region = await toast_on(pilot, app.main)
    for pane in (app.main.log_pane, app.main.status, app.main.key_bar):
        assert not region.overlaps(pane.region), pane
    app.clear_notifications()
    await pilot.press("a")
    await until(pilot, lambda: isinstance(app.screen, TopicScreen), "the form")
    await pilot.pause()
    region = await toast_on(pilot, app.screen)
    (dialog,) = app.screen.query(".dialog")
    assert dialog.region.bottom <= app.size.height
    assert not region.overlaps(dialog.region)


QUESTIONS: dict[str, Callable[[], Screen[Any]]] = {
    "short": lambda: ConfirmScreen("Remove /scan?", "It is removed on both sides.", "Remove", Effect.LOSES),
    "long": lambda: ConfirmScreen("Remove /scan?", "It is removed.\n" * 80, "Remove", Effect.LOSES),
    "changed": lambda: ChangedScreen(Path("robot1.yaml")),
}


@pytest.mark.parametrize("question", QUESTIONS)
@on_main(*SIZES)
async def test_on_a_question(app: ConsoleApp, pilot: Pilot[None], question: str) -> None:
    screen = QUESTIONS[question]()
    app.push_screen(screen)
    await until(pilot, lambda: screen.is_active and bool(screen.query(".dialog")), "the question")
    region = await toast_on(pilot, screen)
    (dialog,) = screen.query(".dialog")
    assert dialog.region.bottom <= app.size.height
    assert not region.overlaps(dialog.region)


@on_main(NARROW)
async def test_last_line_of_a_message_is_shown(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """The rack measured messages as wide as without its scroll bar, and drew them narrower: the last line was lost."""
    await pilot.press("c")
    await shown(pilot, "Links")
    for length in range(33, 41):
        app.clear_notifications()
        app.notify(f"{'y' * length} {'z' * 36} end{length}", timeout=60)
        await shown(pilot, f"end{length}")

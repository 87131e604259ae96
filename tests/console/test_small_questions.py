"""Questions on small screens: each shows itself in short, and its answers with their keys."""

from __future__ import annotations

import importlib
import pkgutil
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.arming_helpers import ARMED, DISARMED
from tests.console.driving import on_main, put, shown, text, until
from tests.console.live import COMMAND, Pair
from tests.console.tmux import Tmux

import rsb_console
import rsb_extras
from rsb_bridge.model.commands import Effect
from rsb_bridge.model.session import Topic
from rsb_console.screens.dialog import ArmScreen, ConfirmScreen, OfferScreen, UndoScreen
from rsb_console.screens.save_screens import ChangedScreen, DiffScreen
from rsb_console.screens.take_over import AskHolderScreen, HandOverScreen
from rsb_console.session.changes import Undo

if TYPE_CHECKING:
    from collections.abc import Callable

    from textual.pilot import Pilot
    from textual.screen import Screen

    from rsb_bridge.api import EngineApi
    from rsb_console.app import ConsoleApp

SIZES = ((20, 5), (20, 8), (30, 6), (49, 24), (80, 11), (50, 12))
YES_NO = ("y yes", "n no")
ASKED = replace(ARMED, arming=replace(ARMED.arming, asked_by="ben", goes_in=20.0))  # type: ignore[type-var]
MESSAGE = "What it does, at some length: the screen has no room for all of it.\n" * 3


async def undo(_: EngineApi) -> None:
    """Do nothing."""


QUESTIONS: dict[str, tuple[Callable[[ConsoleApp], Screen[Any]], str, tuple[str, ...]]] = {
    "ConfirmScreen": (
        lambda _: ConfirmScreen("Overwrite nav2.yaml?", MESSAGE, "Overwrite", Effect.LOSES),
        "Overwrite nav2.yaml?",
        (*YES_NO, "Overwrite", "No"),
    ),
    "ArmScreen": (lambda _: ArmScreen(DISARMED), "Arm /cmd_vel of robot1?", (*YES_NO, "Arm", "No")),
    "OfferScreen": (lambda _: OfferScreen("Attach?", MESSAGE, "Attach"), "Attach?", (*YES_NO, "Attach", "No")),
    "UndoScreen": (
        lambda _: UndoScreen(Undo("Undo the change?", ("/scan: removed",), "Undo", careful=True, act=undo)),
        "Undo the change?",
        (*YES_NO, "Undo", "No"),
    ),
    "DiffScreen": (
        lambda _: DiffScreen("Save nav2.yaml?", MESSAGE, "Save", ["+ a: 1"] * 40),
        "Save nav2.yaml?",
        (*YES_NO, "Save", "No"),
    ),
    "AskHolderScreen": (
        lambda app: AskHolderScreen(app, ARMED, may_take=True),
        "/cmd_vel is armed by somebody else",
        ("y ask", "t take", "A disarm", "n no", "Ask", "Take", "No"),
    ),
    "HandOverScreen": (
        lambda app: HandOverScreen(app, ASKED),
        "Give /cmd_vel of robot1 to somebody else?",
        (*YES_NO, "Give", "No"),
    ),
    "ChangedScreen": (
        lambda _: ChangedScreen(Path("nav2.yaml")),
        "nav2.yaml was",
        ("Reload", "Overwrite", "Save as", "Cancel"),
    ),
}


def test_every_kind_of_question_is_here() -> None:
    for package in (rsb_console, rsb_extras):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if ".tests" not in module.name and not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    kinds = [ConfirmScreen]
    for kind in kinds:
        kinds += kind.__subclasses__()
    assert {kind.__name__ for kind in kinds} <= set(QUESTIONS)


@pytest.mark.parametrize("kind", QUESTIONS)
@on_main(*SIZES, landmark="")
async def test_question_and_answers_are_in_sight(app: ConsoleApp, pilot: Pilot[None], kind: str) -> None:
    make, title, answers = QUESTIONS[kind]
    await until(pilot, lambda: app.engine is not None, "a session that runs")
    put(app, ASKED if kind == "HandOverScreen" else ARMED if kind == "AskHolderScreen" else DISARMED)
    app.push_screen(make(app))

    def missing() -> list[str]:
        unwrapped = " ".join(text(app).translate(dict.fromkeys(map(ord, "│┌┐└┘─"), " ")).split())
        return [each for each in (title, *answers) if each not in unwrapped]

    await until(pilot, lambda: not missing(), f"{title} with {answers}", 30.0)


@on_main((20, 5), landmark="")
async def test_small_question_is_answered_by_its_keys(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await until(pilot, lambda: app.engine is not None, "a session that runs")
    for key, is_left in (("n", False), ("y", True)):
        await pilot.press("q")
        await shown(pilot, "Quit?")
        await shown(pilot, "y yes")
        await pilot.press(key)
        await until(pilot, lambda: not isinstance(app.screen, ConfirmScreen), "an answer")
        assert (app.return_code is not None) is is_left


@pytest.mark.skipif(shutil.which("tmux") is None, reason="needs tmux")
def test_quit_question_in_smallest_terminal(tmp_path: Path) -> None:
    pair = Pair(tmp_path, Topic("/scan", "transmit"))
    with Tmux(tmp_path, f"{COMMAND} run {pair.client_path}; echo exit code $?; cat", size=(20, 5)) as tmux:
        tmux.wait_for("1 topic")
        tmux("send-keys", "q")
        picture = tmux.wait_for("y yes   n no")
        assert picture.startswith("Quit?\n")
        assert " Quit   No" in picture
        tmux.agree("Quit?")
        tmux.wait_for("exit code 0")

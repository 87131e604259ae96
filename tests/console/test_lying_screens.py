"""The screens of root's console on a service that lies in every field of every answer."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import pytest
from tests.console.driving import drive, ended, scripted_app, text, until
from tests.support import constants
from tests.support.long import long_cases
from tests.support.lying import LyingBridge, lies
from tests.support.other_user import OTHER, files_in, folder_for_all, only_root, theirs
from textual.keys import _character_to_key

from rsb_bridge.model.text import is_clean
from rsb_console.actions.all_actions import ACTIONS
from rsb_console.preferences import split_keys

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp

pytestmark = only_root
LEAVES = {"quit", "demo", "welcome", "new_session", "sessions", "import_session", "bluetooth"}
"""Actions that have nothing to do with this bridge, or end its console."""
OF_LINKS = ("c", "enter", "d", "a", "n", "e", "k")


@pytest.fixture
def bed(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a file that nobody may touch, and the folder of services."""
    with folder_for_all() as folder:
        (folder / "own").mkdir(mode=0o700)
        (folder / "own" / "pc.yaml").write_text("kept")
        (folder / "work").mkdir()
        (folder / "services").mkdir(mode=0o700)
        constants.SERVICES_SOCKETS.set(monkeypatch, theirs(folder / "services"))
        monkeypatch.chdir(folder / "work")
        yield folder


# With thousands of characters in every field, all these screens take minutes: the commands meet such a bridge.
KINDS = [each for each in lies("") if each != "very long"]


@pytest.mark.parametrize(
    ("kind", "honest"),
    [("escapes", True), *long_cases(*[case for case in product(KINDS, (True, False)) if case != ("escapes", True)])],
)
def test_no_screen_fails_or_shows_control_characters(kind: str, bed: Path, *, honest: bool) -> None:
    path, own = bed / "services" / "robot1.sock", bed / "own"
    before = files_in(own)

    async def steps(pilot: Pilot[None]) -> None:
        app: ConsoleApp = pilot.app  # type: ignore[assignment]
        await until(pilot, lambda: app.engine is not None and app.engine.snapshot().links, "attached")
        for action in ACTIONS:
            if action.id in LEAVES:
                continue
            await _pressed(pilot, next(iter(split_keys(action.keys))))
        for key in OF_LINKS:
            await pilot.press("c")
            await _pressed(pilot, key)

    with LyingBridge(path, lies(str(own / "pc.yaml"))[kind], uid=OTHER, honest_names=honest):
        app = scripted_app(session=None, path=None, attach_to=path)
        drive(app, steps)
    assert app.path is None
    assert files_in(own) == before


async def _pressed(pilot: Pilot[None], key: str) -> None:
    """Press a key, look at the screen that it opens, and leave that."""
    await pilot.press(_character_to_key(key) if len(key) == 1 else key)
    await pilot.pause(0.05)
    assert not ended(pilot.app), key
    shown = [line for line in text(pilot.app).splitlines() if not is_clean(line)]
    assert not shown, (key, shown)
    for _ in range(3):
        if len(pilot.app.screen_stack) > 1:
            await pilot.press("escape")

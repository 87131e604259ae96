"""The terminal's bell: when it rings for a fault, and when it does not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.driving import on_main, put, shown, until
from tests.console.scripted import LINK, NOW, ScriptedEngine, route

from rsb_bridge.model.faults import LASTS
from rsb_bridge.model.snapshot import Snapshot, State
from rsb_console.app import RINGS_EVERY, Bell
from rsb_console.preferences import Preferences

if TYPE_CHECKING:
    from pathlib import Path

    from textual.pilot import Pilot

    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.app import ConsoleApp

FINE, SLOW = route("/scan"), route("/scan", State.SLOW, cause="slow")
ENGINE = ScriptedEngine()


class Rung:
    """A bell that is looked at four times a second, and how often it has rung."""

    def __init__(self, *, is_on: bool = True) -> None:
        self.times = 0
        self.now = 0.0
        self.bell = Bell(self._ring, is_on=is_on, clock=lambda: self.now)

    def _ring(self, _begun: object) -> None:
        self.times += 1

    def sees(self, *routes: RouteSnapshot, seconds: float = LASTS + 1, engine: Any = ENGINE) -> int:
        """Return how often it has rung after the console has shown this for a while."""
        for _ in range(int(4 * seconds)):
            self.now += 0.25
            snapshot = Snapshot(NOW + self.now, "robot1", "client", "", 0, running=True, links=(LINK,), routes=routes)
            self.bell.ring_for_new(engine, snapshot)
        return self.times


def test_it_rings_once_when_a_fault_begins() -> None:
    rung = Rung()
    assert rung.sees(FINE) == 0
    assert rung.sees(SLOW, seconds=60) == 1
    assert rung.sees(replace(SLOW, cause="lossy"), seconds=60) == 1
    assert rung.sees(FINE, seconds=60) == 1
    assert rung.sees(SLOW, seconds=60) == 2


def test_bell_rings_once_for_faults_close_together() -> None:
    rung = Rung()
    rung.sees(FINE)
    faults = [route(f"/topic{number}", State.DOWN) for number in range(20)]
    assert rung.sees(*faults[:10], seconds=RINGS_EVERY / 2) == 1
    assert rung.sees(*faults[:15], seconds=RINGS_EVERY / 2) == 1
    rung.sees(*faults[:15], seconds=RINGS_EVERY)
    assert rung.sees(*faults) == 2


def test_bell_rings_once_for_new_flapping_fault() -> None:
    rung = Rung()
    assert rung.sees(SLOW, seconds=60) == 0
    rung.sees(FINE)
    for _ in range(50):
        rung.sees(SLOW, seconds=1)
        rung.sees(FINE, seconds=1)
    assert rung.times == 1


def test_another_engine_begins_without_a_ring() -> None:
    rung = Rung()
    rung.sees(FINE)
    assert rung.sees(SLOW, engine=ScriptedEngine()) == 0


def test_it_does_not_ring_while_it_is_off() -> None:
    rung = Rung(is_on=False)
    rung.sees(FINE)
    assert rung.sees(SLOW) == 0
    rung.bell.is_on = True
    assert rung.sees(SLOW, seconds=60) == 0, "the fault was there before"


@on_main()
async def test_a_key_turns_it_on_and_off(app: ConsoleApp, pilot: Pilot[None]) -> None:
    rung: list[bool] = []
    bell = app.fault_bell = Bell(lambda _: rung.append(True), is_on=False)
    put(app, FINE)
    await pilot.press("exclamation_mark")
    await shown(pilot, "the bell rings")
    app.pull()  # it watches
    put(app, SLOW)
    await until(pilot, lambda: rung == [True], "it rings")
    await pilot.press("exclamation_mark")
    assert not bell.is_on


@pytest.mark.parametrize(
    ("text", "bell", "problems"),
    [
        (None, False, 0),
        ("", False, 0),
        ("bell: true", True, 0),
        ("bell: false", False, 0),
        ("bell: loud", False, 1),
        ("bel: true", False, 1),
        ("- bell", False, 1),
        ("{", False, 1),
    ],
)
def test_the_user_turns_it_on_in_a_file(tmp_path: Path, text: str | None, bell: bool, problems: int) -> None:
    if text is not None:
        (tmp_path / "console.yaml").write_text(text)
    preferences = Preferences(tmp_path, None)
    assert (preferences.bell, len(preferences.problems)) == (bell, problems)

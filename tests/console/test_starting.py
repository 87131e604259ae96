"""The engine starts slowly: after any keys meanwhile, one engine runs in the end."""

import asyncio
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from tests.console.driving import drive, notices, scripted_app, until
from tests.console.scripted import SESSION, ScriptedEngine
from textual.pilot import Pilot

from rsb_bridge.model.session import Session


class Slow(ScriptedEngine):
    """An engine whose start lasts until the test lets it go on."""

    def __init__(self, session: Session = SESSION, base: Path = Path()) -> None:
        super().__init__(session, base)
        self.now = replace(self.now, running=False)
        self.may_start = threading.Event()
        self.was_started = False

    def start(self) -> None:
        assert self.may_start.wait(60)
        super().start()
        self.was_started = True
        self.now = replace(self.now, running=True)


def making(made: list[Slow]) -> Callable[[Session, Path], Slow]:
    """Makes engines, and remembers them; those after the first start at once."""

    def make(session: Session, base: Path) -> Slow:
        engine = Slow(session, base)
        if made:
            engine.may_start.set()
        made.append(engine)
        return engine

    return make


def test_restart_while_starting_makes_no_second_engine() -> None:
    made: list[Slow] = []
    app = scripted_app(make_engine=making(made))

    async def steps(pilot: Pilot[None]) -> None:
        await until(pilot, lambda: made, "an engine that starts")
        await pilot.press("R", "R")
        await pilot.pause()
        assert len(made) == 1
        assert {each.message for each in notices(app)} == {"the bridge is starting"}
        made[0].may_start.set()
        await until(pilot, lambda: made[0].running, "it runs")
        await until(pilot, lambda: not app.note, "the console knows")
        assert len(made) == 1
        assert app.engine is made[0]

    drive(app, steps)


def test_another_session_waits_for_start_of_first() -> None:
    made: list[Slow] = []
    app = scripted_app(make_engine=making(made))

    async def steps(pilot: Pilot[None]) -> None:
        await until(pilot, lambda: made, "an engine that starts")
        changing = asyncio.ensure_future(app.run_session(SESSION, Path("other.yaml")))
        await pilot.pause()
        assert len(made) == 1
        made[0].may_start.set()
        await until(pilot, lambda: len(made) == 2 and made[1].running, "the other session runs")
        assert made[0].was_started
        assert not made[0].running
        await changing

    drive(app, steps)

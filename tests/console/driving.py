"""Driving the app in a test: keys in, the screen's text out, conditions with deadlines."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

from tests.console.scripted import SESSION, ScriptedEngine
from textual.events import Paste
from textual.pilot import Pilot

from rsb_console.app import ConsoleApp

NOWHERE = Path("/nonexistent")
WIDE, NARROW = (120, 36), (80, 24)


def scripted_app(**options) -> ConsoleApp:
    """The app on an engine that plays a script, with nothing of the user's."""
    options = {"config": NOWHERE, "theme": "dark", "make_engine": ScriptedEngine} | options
    return ConsoleApp(options.pop("session", SESSION), options.pop("path", Path("nav2.yaml")), **options)


def empty_app(**options) -> ConsoleApp:
    """The app without a session."""
    return scripted_app(session=None, path=None, **options)


def text(app: ConsoleApp) -> str:
    """What stands on the screen."""
    strips = app.screen._compositor.render_strips()
    return "\n".join("".join(segment.text for segment in strip) for strip in strips)


async def until(pilot: Pilot, condition: Callable[[], object], what: str, seconds: float = 20.0) -> None:
    """Wait until `condition`."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"not within {seconds} s: {what}\n{text(pilot.app)}"
        await pilot.pause(0.02)


async def shown(pilot: Pilot, words: str, seconds: float = 20.0) -> None:
    """Wait until `words` stand on the screen."""
    await until(pilot, lambda: words in text(pilot.app), f"{words!r} on the screen", seconds)


async def gone(pilot: Pilot, words: str, seconds: float = 20.0) -> None:
    """Wait until `words` stand on the screen no more."""
    await until(pilot, lambda: words not in text(pilot.app), f"{words!r} gone", seconds)


async def settled(pilot: Pilot, seconds: float = 20.0) -> None:
    """Wait until the screen no longer changes: scrollbars come a refresh after what they scroll."""
    deadline = time.monotonic() + seconds
    before, same = "", 0
    while same < 3:
        assert time.monotonic() < deadline, "the screen keeps changing"
        await pilot.pause(0.05)
        before, same = text(pilot.app), same + 1 if text(pilot.app) == before else 0


def drive(app: ConsoleApp, steps: Callable[[Pilot], Awaitable[None]], size: tuple[int, int] = WIDE) -> None:
    """Run `app` without a terminal, and `steps` on it."""

    async def run() -> None:
        async with app.run_test(size=size, notifications=True) as pilot:
            await steps(pilot)

    asyncio.run(run())


async def fill(pilot: Pilot, **values: str) -> None:
    """Paste each value into the form's field of that key, in place of what is there."""
    for key, value in values.items():
        form = pilot.app.screen.form
        await until(pilot, lambda f=form: not f.typed_ahead.covers(Paste("")), "a form that listens")
        control = form.fields[key].control
        control.focus()
        control.value = ""
        control.post_message(Paste(value))
        await until(pilot, lambda c=control, v=value: c.value == v, f"{value!r} in {key}")


async def choose(pilot: Pilot, key: str, value: str) -> None:
    """Move a choice until `value` is chosen."""
    control = pilot.app.screen.form.fields[key].control
    control.focus()
    for _ in range(10):
        if control.value == value:
            return
        await pilot.press("right")
    raise AssertionError(f"{key} has no {value}")


def listed(app) -> list[str]:
    """The topics on screen, in their order."""
    return [shown_route.topic for shown_route in app.main.topics.listed]


def put(app, *routes, **changes) -> None:
    """The engine's next snapshot has `routes`."""
    app.engine.now = replace(app.engine.now, routes=routes or app.engine.now.routes, **changes)
    app.pull()


def on_main(size=(120, 36), **options):
    """A test's steps run once the topics are there."""

    def decorate(steps):
        def test() -> None:
            app = scripted_app(**options)

            async def run(pilot: Pilot) -> None:
                await shown(pilot, "/robot2/scan")
                await steps(app, pilot)

            drive(app, run, size)

        return test

    return decorate

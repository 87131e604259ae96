"""Driving the app in a test: keys in, the screen's text out, conditions with deadlines."""

import asyncio
import functools
import inspect
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import pytest
from tests.console.scripted import SESSION, ScriptedEngine
from tests.support.waiting import pauses
from tests.support.wording import says
from textual.app import App, ScreenStackError
from textual.events import Key, Paste
from textual.notifications import Notification
from textual.pilot import Pilot

from rsb_bridge.model.snapshot import RouteSnapshot
from rsb_bridge.model.wording import Wording
from rsb_console.app import ConsoleApp
from rsb_console.library_internals.textual_internals import is_idle
from rsb_console.terminal_app import TerminalApp
from rsb_console.widgets.form import Form, FormScreen

E = TypeVar("E", bound=ScriptedEngine)
Steps = Callable[[Pilot[None]], Awaitable[None]]
AppSteps = Callable[[ConsoleApp, Pilot[None]], Awaitable[None]]
WIDE, NARROW = (120, 36), (80, 24)


def scripted_app(**options: Any) -> ConsoleApp:
    """The app on an engine that plays a script, whose snapshot has `routes`; with nothing of the user's."""
    if (routes := options.pop("routes", None)) is not None:
        options["make_engine"] = lambda session, base: ScriptedEngine(session, base, routes)
    options = {"theme": "dark", "make_engine": ScriptedEngine, **options}
    return ConsoleApp(options.pop("session", SESSION), options.pop("path", Path("nav2.yaml")), **options)


def engine_as(app: ConsoleApp, kind: type[E]) -> E:
    """The engine that the app runs on, which is of that kind."""
    assert isinstance(app.engine, kind)
    return app.engine


def engine_of(app: ConsoleApp) -> ScriptedEngine:
    return engine_as(app, ScriptedEngine)


def selected_topic(app: ConsoleApp) -> str:
    """The topic under the cursor."""
    assert app.main.topics.selected is not None
    return app.main.topics.selected.topic


def form_of(app: App[Any]) -> Form:
    assert isinstance(app.screen, FormScreen)
    form: Form = app.screen.form
    return form


def text(app: App[Any]) -> str:
    strips = app.screen._compositor.render_strips()
    return "\n".join("".join(segment.text for segment in strip) for strip in strips)


async def until(pilot: Pilot[None], condition: Callable[..., object], what: str, seconds: float = 180.0) -> None:
    """Wait until `condition`, which still holds when the widgets have done what they had to do by then.

    Textual's pause sends a message to every widget, which takes more time than most conditions: only at the end.
    """
    deadline, pause = time.monotonic() + seconds, pauses()
    while not condition():
        try:
            while not condition():
                assert time.monotonic() < deadline, f"not within {seconds} s: {what}\n{text(pilot.app)}"
                await asyncio.sleep(next(pause))
                pilot.app.screen._on_timer_update()
            await pilot.pause(0)
        except ScreenStackError:  # the app has ended, perhaps as it should
            assert condition(), f"the app has ended without {what}"
            return


_BORDERS = "│┃▌▐█▊▎| "


def is_shown(app: App[Any], words: str | Wording, **parameters: object) -> bool:
    """Whether the screen shows some words, or a text of the program on one line or wrapped in a dialog."""
    if isinstance(words, str):
        return words in text(app)
    lines = text(app).splitlines()
    boxes = [dialog.region for dialog in app.screen.query(".dialog")]  # the screen below stays in sight around them
    parts = [lines, *([line[box.x : box.right] for line in lines[box.y : box.bottom]] for box in boxes)]
    unwrapped = (" ".join(line.strip(_BORDERS) for line in part) for part in parts)
    return any(says(each, words, **parameters) for each in (*lines, *unwrapped))


async def shown(pilot: Pilot[None], words: str | Wording, **parameters: object) -> None:
    """Wait until the screen shows some words, or a text of the program."""
    await until(pilot, lambda: is_shown(pilot.app, words, **parameters), f"{words!r} on the screen")


def notices(app: App[Any]) -> list[Notification]:
    """Return the notifications of an app, which Textual keeps to itself."""
    return list(app._notifications)


def ended(app: App[Any]) -> bool:
    return app.return_code is not None


def send(app: App[Any], *events: Key | Paste) -> None:
    """Give an app events as its terminal does, without waiting for their effect."""
    terminal = app._driver
    assert terminal is not None
    for event in events:
        terminal.send_message(event)


async def notified(pilot: Pilot[None], wording: Wording, **parameters: object) -> None:
    """Wait for a notification with a text of the program."""

    def is_there() -> bool:
        texts = [f"{each.title} {each.message}" for each in notices(pilot.app)]
        return any(says(each, wording, **parameters) for each in texts)

    await until(pilot, is_there, f"a notification: {wording!r}")


async def shown_at_the_end(pilot: Pilot[None], words: str, key: str = "G", seconds: float = 180.0) -> None:
    """Go to the end, which may still move, until the screen shows `words`."""
    deadline = time.monotonic() + seconds
    while words not in text(pilot.app):
        assert time.monotonic() < deadline, f"not within {seconds} s: {words!r} at the end\n{text(pilot.app)}"
        await pilot.press(key)
        await pilot.pause(0.05)


async def told_to_add(pilot: Pilot[None], app: ConsoleApp) -> tuple[object, ...]:
    """Wait until the engine gets the command to add a topic; the form may ask for the graph even after that."""

    def told() -> tuple[object, ...] | None:
        return next((command for command in engine_of(app).commands if command[0] == "add"), None)

    await until(pilot, told, "a command to add")
    return told() or ()


async def gone(pilot: Pilot[None], words: str | Wording, **parameters: object) -> None:
    """Wait until the screen no longer shows some words, or a text of the program."""
    await until(pilot, lambda: not is_shown(pilot.app, words, **parameters), f"{words!r} gone")


async def left_as_it_was(app: ConsoleApp, pilot: Pilot[None], name: str) -> None:
    """Confirm the form that edits `name`, in which nothing is changed: nothing is sent. Open it again."""
    await pilot.press("enter")
    await gone(pilot, f"Edit {name}")
    assert engine_of(app).commands == [], "nothing was changed"
    await pilot.press("e")
    await shown(pilot, f"Edit {name}")


async def settled(pilot: Pilot[None], seconds: float = 180.0) -> None:
    """Wait until the screen no longer changes: scrollbars come a refresh after what they scroll."""
    deadline = time.monotonic() + seconds
    before, same = "", 0
    while same < 3:
        assert time.monotonic() < deadline, "the screen keeps changing"
        await pilot.pause(0.05)
        before, same = text(pilot.app), same + 1 if text(pilot.app) == before else 0


class Operator(Pilot[None]):
    """Goes on only when the console has finished with a key or a click.

    Textual's pilot goes on when the process rests, and so it does on a busy machine that lets it rest too early.
    """

    def __init__(self, app: TerminalApp[Any]) -> None:
        super().__init__(app)
        self._console = app

    async def press(self, *keys: str) -> None:
        await super().press(*keys)
        await self._finished()

    async def click(self, *where: Any, **how: Any) -> bool:
        await settled(self)  # what is clicked stays where it is
        hit = await super().click(*where, **how)
        await self._finished()
        return hit

    async def _finished(self) -> None:
        app, queue = self._console, self._console.input_queue

        def has_finished() -> bool:
            if ended(app) or not app.screen_stack:
                return True
            handles_none = not queue.delivers and all(map(is_idle, (app, *app.screen.walk_children(with_self=True))))
            return handles_none and not app.message_queue_size

        await until(self, has_finished, "the console has finished with it")


def drive(app: ConsoleApp, steps: Steps, size: tuple[int, int] = WIDE) -> None:
    """Run `app` without a terminal, and `steps` on it."""

    async def run() -> None:
        async with app.run_test(size=size, notifications=True):
            await steps(Operator(app))

    asyncio.run(run())


async def fill(pilot: Pilot[None], **values: str) -> None:
    """Paste each value into the form's field of that key, in place of the old value."""
    for key, value in values.items():
        form = form_of(pilot.app)
        await until(pilot, lambda f=form: not f.input_guard.covers(Paste("")), "a form that listens")
        if not form.fields[key].display:
            await pilot.press("f8")  # all fields
        control = form.fields[key].control
        control.focus()
        control.value = ""
        control.post_message(Paste(value))
        await until(pilot, lambda c=control, v=value: c.value == v, f"{value!r} in {key}")


async def choose(pilot: Pilot[None], key: str, value: str) -> None:
    """Move a choice until `value` is chosen."""
    field = form_of(pilot.app).fields[key]
    if not field.display:
        await pilot.press("f8")  # all fields
    control = field.control
    control.focus()
    for _ in range(10):
        if control.value == value:
            return
        await pilot.press("right")
    raise AssertionError(f"{key} has no {value}")


def listed(app: ConsoleApp) -> list[str]:
    """The topics on screen, in their order."""
    return [shown_route.topic for shown_route in app.main.topics.listed]


def put(app: ConsoleApp, *routes: RouteSnapshot, **changes: Any) -> None:
    """The engine's next snapshot has `routes`."""
    engine = engine_of(app)
    engine.now = replace(engine.now, routes=routes or engine.now.routes, **changes)
    app.pull()


Test = Callable[..., None]
Decorator = Callable[[Callable[..., Awaitable[None]]], Test]
Opening = Callable[[Pilot[None]], Awaitable[dict[str, Any] | None]]


def as_test(test: Test, steps: Callable[..., Awaitable[None]], *makes: str, sizes: tuple[Any, ...] = ()) -> Test:
    """Return a test with the name of its steps and their parameters, without the parameters that it makes."""
    signature = inspect.signature(steps)
    parameters = [each for name, each in signature.parameters.items() if name not in makes]
    if len(sizes) > 1:
        parameters.append(inspect.Parameter("size", inspect.Parameter.KEYWORD_ONLY))
    functools.update_wrapper(test, steps)
    vars(test)["__signature__"] = signature.replace(parameters=parameters)
    return pytest.mark.parametrize("size", sizes)(test) if len(sizes) > 1 else test


def on_main(
    *sizes: Any,
    landmark: str | Wording = "/robot2/scan",
    opening: Opening | None = None,
    given: tuple[str, ...] = (),
    makes: tuple[str, ...] = (),
    before: Callable[[], dict[str, Any]] = dict,
    **options: Any,
) -> Decorator:
    """A test's steps run on the scripted app, once it shows the landmark.

    They get `app` and `pilot`, besides the test's fixtures and parameters, of which `given` go to the app, too. With
    several sizes of the terminal they run once in each. `before` runs before the app is made, and returns more options
    of it. `opening` runs before the steps, and returns what they get by the names in `makes`.
    """

    def decorate(steps: Callable[..., Awaitable[None]]) -> Test:
        def test(size: tuple[int, int] = sizes[0] if sizes else WIDE, **fixtures: Any) -> None:
            app = scripted_app(**options, **before(), **{name: fixtures[name] for name in given})

            async def run(pilot: Pilot[None]) -> None:
                await shown(pilot, landmark)
                made = await opening(pilot) if opening is not None else None
                await steps(app=app, pilot=pilot, **(made or {}), **fixtures)

            drive(app, run, size)

        return as_test(test, steps, "app", "pilot", *makes, sizes=sizes)

    return decorate


on_welcome = functools.partial(on_main, landmark="New session", session=None, path=None)
"""A test's steps run once the console without a session shows how to begin."""

"""Takes the README's pictures of the console on the running demo: ``make screenshots``."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_console.app import ConsoleApp
from rsb_console.session.demo import running_demo

if TYPE_CHECKING:
    from collections.abc import Callable

    from textual.pilot import Pilot

PICTURES = Path(__file__).parent / "pictures"
FLOWING = 6  # topics of the demo, its service, and its robot's parameters
HISTORY = 60  # s: long enough for a curve to be worth a picture
WIDE, NARROW = (120, 36), (80, 24)


async def take(pilot: Pilot[None], name: str, *keys: str) -> None:
    """Press `keys`, and keep what the screen shows then."""
    await pilot.press(*keys)
    await pilot.pause(1.0)
    pilot.app.save_screenshot(f"{name}.svg", str(PICTURES))


async def until(condition: Callable[[], bool], pilot: Pilot[None], seconds: float = 90.0) -> None:
    """Wait for it."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise SystemExit("the demo does not do what the pictures want")
        await pilot.pause(0.5)


def states(app: ConsoleApp) -> list[str]:
    """How the topics are."""
    return [route.state.value for route in app.snapshot().routes]


async def main() -> None:
    """All pictures."""
    with running_demo() as demo:
        app = ConsoleApp(demo.session, demo.path, theme="dark", config=PICTURES)
        try:
            async with app.run_test(size=WIDE) as pilot:
                await until(lambda: states(app).count("ok") == FLOWING, pilot)
                await until(lambda: len(app.snapshot().routes[0].history) > HISTORY, pilot)
                demo.desk.stop()
                await pilot.press("j", "j", "p")
                await until(lambda: "stale" in states(app), pilot)
                await take(pilot, "main", "g")
                await take(pilot, "add-topic", "a")
                await take(pilot, "help", "escape", "question_mark")
                await pilot.press("escape", "slash", *"set_light", "enter", "C")
                await until(lambda: "data" in app.screen.form.values.get("request", ""), pilot)  # type: ignore[attr-defined]
                await pilot.press("f9", "y")
                await take(pilot, "call")
                await take(pilot, "service", "escape")
                await pilot.press("escape", "g", "t", "t")
                await take(pilot, "light")
                await pilot.press("t", "t")
                await pilot.resize_terminal(*NARROW)
                await take(pilot, "narrow")
                await take(pilot, "detail", "enter")
        finally:
            await asyncio.to_thread(app.stop)


if __name__ == "__main__":
    PICTURES.mkdir(exist_ok=True)
    asyncio.run(main())

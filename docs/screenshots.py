"""Takes the README's pictures of the console on the running demo: ``make screenshots``."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_console.app import ConsoleApp
from rsb_console.demo import running_demo

if TYPE_CHECKING:
    from textual.pilot import Pilot

PICTURES = Path(__file__).parent / "pictures"
FLOWING = 4  # topics of the demo
WIDE, NARROW = (120, 36), (80, 24)


async def take(pilot: Pilot[None], name: str, *keys: str) -> None:
    """Press `keys`, and keep what the screen shows then."""
    await pilot.press(*keys)
    await pilot.pause(1.0)
    pilot.app.save_screenshot(f"{name}.svg", str(PICTURES))


async def until_flowing(app: ConsoleApp, pilot: Pilot[None], seconds: float = 60.0) -> None:
    """Wait until every topic flows, and long enough for its curve to be worth a picture."""
    deadline = time.monotonic() + seconds
    while sum(route.state == "ok" and len(route.history) > 30 for route in app.snapshot().routes) < FLOWING:
        if time.monotonic() > deadline:
            raise SystemExit("the demo does not flow")
        await pilot.pause(0.5)


async def main() -> None:
    """All pictures."""
    with running_demo() as demo:
        app = ConsoleApp(demo.session, demo.path, theme="dark", config=PICTURES)
        try:
            async with app.run_test(size=WIDE) as pilot:
                await until_flowing(app, pilot)
                await take(pilot, "main", "j", "j", "j")
                await take(pilot, "add-topic", "a")
                await take(pilot, "help", "escape", "question_mark")
                await pilot.press("escape", "t", "t")
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

"""Takes the pictures of the camera and the map of the running demo (``docs/screenshots.py``)."""

from __future__ import annotations

import asyncio

from docs.screenshots import FLOWING, NARROW, Album, states, until

from rsb_console.app import ConsoleApp
from rsb_console.session.demo_session import running_demo
from rsb_extras.pictures.view_screen import ViewScreen


async def of_pictures(album: Album) -> None:
    """Those of the robot's camera and map."""
    with running_demo() as demo:
        app = ConsoleApp(demo.session, demo.path, theme="dark", config=album.config)
        try:
            async with app.run_test(size=NARROW) as pilot:
                await until(lambda: states(app).count("ok") == FLOWING, pilot)
                await pilot.press("V")
                await pilot.pause(2.0)
                await pilot.press(*"camera", "enter")
                await until(lambda: drawn(app), pilot)
                await album.take(pilot, "look-camera", "greater_than_sign", when=lambda words: "rgb8" in words)
                await pilot.press("less_than_sign", "escape", "slash", *"map", "enter", "v")
                await until(lambda: drawn(app), pilot)
                await pilot.pause(3.0)
                await album.take(pilot, "look-map", when=lambda words: "5 m" in words)
                await album.take(pilot, "goal", "g", *["right"] * 8, *["up"] * 3, when=lambda words: "GOAL" in words)
        finally:
            await asyncio.to_thread(app.stop)


def drawn(app: ConsoleApp) -> bool:
    """Whether a picture of a message is on the screen."""
    return isinstance(app.screen, ViewScreen) and app.screen.content is not None


PARTS = {"look": of_pictures}

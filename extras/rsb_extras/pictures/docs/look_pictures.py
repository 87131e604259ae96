"""Takes the pictures of what the running demo's robot sees (``docs/screenshots.py``)."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, cast

from docs.real_terminals import Camera, InTerminal, is_whole, kitty
from docs.screenshots import FLOWING, NARROW, Album, states, until

from rsb_bridge.feature_api import State
from rsb_console.app import ConsoleApp
from rsb_extras.demo.demo_session import running_demo
from rsb_extras.pictures.look_screen import LookScreen
from rsb_extras.pictures.picture import Series
from rsb_extras.pictures.picture_tile import PictureTile
from rsb_extras.pictures.view_screen import ViewScreen

if TYPE_CHECKING:
    from textual.pilot import Pilot


async def of_pictures(album: Album) -> None:
    """The goal on the robot's map."""
    with running_demo() as demo:
        app = ConsoleApp(demo.session, demo.path, theme="dark", config=album.config)
        try:
            async with app.run_test(size=NARROW) as pilot:
                await until(lambda: states(app).count("ok") >= FLOWING // 2, pilot)  # the rest may be slow
                await pilot.press("slash", *"map", "enter", "v")
                await until(lambda: drawn(app), pilot)
                await album.take(pilot, "goal", "g", *["right"] * 8, *["up"] * 3, when=lambda words: "GOAL" in words)
        finally:
            await asyncio.to_thread(app.stop)


def drawn(app: ConsoleApp) -> bool:
    """Whether a picture of a message is on the screen."""
    return isinstance(app.screen, ViewScreen) and app.screen.content is not None


LAYOUTS = """
layouts:
  robot:
    - {topic: /camera/image_raw, link: demo}
    - {topics: [/map, /scan, /plan, /footprint], link: demo, rate: 5}
    - {topic: /odom, link: demo, as: plot, fields: [twist.twist.linear.x, twist.twist.angular.z], seconds: 30}
    - rates
"""
FAULTS = {State.SLOW, State.LATE, State.STALE, State.DOWN}


async def look(app: ConsoleApp, pilot: Pilot[Any], layout: str) -> ViewScreen:
    """Look at a layout, until all its tiles have a picture."""
    await pilot.press("V")
    await until(lambda: isinstance(app.screen, LookScreen), pilot)
    chooser = cast("LookScreen", app.screen)
    await pilot.press(*layout)
    await until(lambda: (found := chooser.list.current) is not None and found.key == f"layout {layout}", pilot)
    await pilot.press("enter")
    await until(lambda: isinstance(app.screen, ViewScreen), pilot)
    view = cast("ViewScreen", app.screen)
    await until(lambda: all(tile.content is not None for tile in view.query(PictureTile)), pilot)
    return view


async def of_tiles(camera: Camera, app: ConsoleApp, pilot: Pilot[Any]) -> None:
    """Camera, map, speed and rates of a robot that drives."""
    view = await look(app, pilot, "robot")
    await camera.photograph(
        pilot,
        "tiles",
        when=lambda: drives(view) and not FAULTS.intersection(states(app)),
        good=is_whole,
    )


def drives(view: ViewScreen) -> bool:
    """Whether the plot is full, and says that the robot moves ahead."""
    plots = [tile.content for tile in view.query(PictureTile) if isinstance(tile.content, Series)]
    speed, *_ = plots[0].curves
    return (speed.last or 0.0) > 0.1 and sum(low is not None for low in speed.lows) > 0.9 * len(speed.lows)


PARTS = {
    "look": of_pictures,
    "tiles": InTerminal("tiles", kitty(160, 44), of_tiles, LAYOUTS),
}

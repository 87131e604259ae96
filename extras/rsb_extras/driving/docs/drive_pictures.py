"""Takes the picture of driving on the running demo (``docs/screenshots.py``)."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from docs.screenshots import FLOWING, NARROW, Album, states, until, words_of

from rsb_console.app import ConsoleApp
from rsb_console.screens.dialog import ArmScreen
from rsb_extras.demo.demo_session import running_demo
from rsb_extras.driving.drive_screen import DriveScreen

if TYPE_CHECKING:
    from textual.pilot import Pilot


async def of_driving(album: Album) -> None:
    """Drive with the camera's picture in sight."""
    with running_demo() as demo:
        app = ConsoleApp(demo.session, demo.path, theme="dark", config=album.config)
        try:
            async with app.run_test(size=NARROW) as pilot:
                await until(lambda: states(app).count("ok") >= FLOWING // 2, pilot)  # the rest may be slow
                await pilot.press("V")
                await until(lambda: "/camera/image_raw" in words_of(app.export_screenshot()), pilot)
                await pilot.press(*"camera", "enter")
                await until(lambda: getattr(app.screen, "content", None) is not None, pilot)
                await pilot.press(*["less_than_sign"] * 2, "d")  # drawing takes the time that driving needs here
                album.keep("drive", await driving(app, pilot))
        finally:
            await asyncio.to_thread(app.stop)


async def driving(app: ConsoleApp, pilot: Pilot[None]) -> str:
    """Return the picture of a robot that drives. On a busy machine it is disarmed now and then, and armed again."""
    picture = ""

    async def drives() -> bool:
        nonlocal picture
        armed = [each.arming for each in app.snapshot().routes if each.arming and each.arming.armed]
        if isinstance(app.screen, ArmScreen):
            await pilot.press("y")
        elif isinstance(app.screen, DriveScreen) and not armed:
            await pilot.press("A")
        else:
            await pilot.press("u")  # ahead, and to the left
            if any(arming.velocity and arming.velocity[0] for arming in armed):
                picture = app.export_screenshot()
        return is_complete(words_of(picture))

    await until(drives, pilot)
    return picture


def is_complete(words: str) -> bool:
    """Whether the words have the motion on both sides, and the age of its newest message."""
    return all(each in words for each in ("turning", "forward", "given to DDS there, "))


PARTS = {"drive": of_driving}

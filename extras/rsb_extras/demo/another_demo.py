"""Beginning with the demo in the console."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EngineError
from rsb_console.operations.session_operations import confirm_end
from rsb_extras.demo.demo_session import running_demo

if TYPE_CHECKING:
    from rsb_console.feature_console import MainScreen

_ANOTHER_DEMO = "This robot and its bridges end; a new robot starts, with the demo's first topics."


async def demo(screen: MainScreen) -> None:
    """Run the demo: a simulated robot on this machine."""
    console = screen.console
    runs = console.temporary and console.engine is not None
    if runs and console.snapshot().running:
        title = "The demo runs already. Start it again?"
        agreed = await confirm_end(console, title, "Start again", means=_ANOTHER_DEMO)
    else:
        agreed = await confirm_end(console, "Run the demo instead?", "Run")
    if not agreed:
        return
    console.notify("the simulated robot starts …", timeout=3)
    resources = contextlib.ExitStack()
    starting = asyncio.ensure_future(asyncio.to_thread(resources.enter_context, running_demo()))
    try:
        # The thread cannot be cancelled: what it starts has to be ended once it is there.
        robot = await asyncio.shield(starting)
    except EngineError as error:
        console.notify(str(error), title="No demo", severity="error", markup=False, timeout=15)
    except asyncio.CancelledError:
        starting.add_done_callback(lambda _: resources.close())
        raise
    else:
        await console.run_session(robot.session, robot.path, resources, temporary=True)

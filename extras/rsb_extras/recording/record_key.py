"""The key that has the bridge write the last seconds to a file."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EngineError
from rsb_extras.recording.keep_last import KeepLast
from rsb_extras.recording.record_command import lines_about

if TYPE_CHECKING:
    from rsb_console.feature_console import Console, MainScreen


async def record_last(screen: MainScreen) -> None:
    await record_beside(screen.console)


async def record_beside(console: Console, *_: object) -> None:
    """Record all topics, whichever robot a screen shows."""
    if console.engine is None:
        return
    try:
        kept = await asyncio.wrap_future(console.engine.do(KeepLast()))
    except EngineError as error:
        console.notify(str(error), title="Not recorded", severity="warning", markup=False, timeout=15)
    else:
        console.notify(
            "\n".join(lines_about(kept, here=console.engine.trusted)), title="Recorded", markup=False, timeout=15
        )

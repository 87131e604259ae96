"""The key that has the bridge write the last seconds to a file."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_extras.recording.keep_last import KeepLast
from rsb_extras.recording.record_command import lines_about

if TYPE_CHECKING:
    from rsb_console.screens.main import MainScreen


async def record_last(screen: MainScreen) -> None:
    console = screen.console
    if console.engine is None:
        return
    try:
        kept = await asyncio.wrap_future(console.engine.do(KeepLast()))
    except EngineError as error:
        console.notify(str(error), title="Not recorded", severity="warning", markup=False, timeout=15)
    else:
        console.notify("\n".join(lines_about(kept)), title="Recorded", markup=False, timeout=15)

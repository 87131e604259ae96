"""Textual's timers of one call, in a process that gets no processor just as they begin."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

from tests.console.driving import on_main, until
from textual import timer

if TYPE_CHECKING:
    import pytest
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp


class Standing:
    """The clock of Textual's timers: the process stands still whenever one of a name looks at it."""

    def get_time(self) -> float:
        if (task := asyncio.current_task()) is not None and task.get_name() == "once":
            time.sleep(0.1)
        return time.monotonic()


@on_main()
async def test_only_call_is_not_skipped(app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timer, "_time", Standing())
    called: list[str] = []
    app.set_timer(0.05, lambda: called.append("app"), name="once")
    app.main.set_timer(0.05, lambda: called.append("screen"), name="once")
    await until(pilot, lambda: sorted(called) == ["app", "screen"], "both calls", 20.0)

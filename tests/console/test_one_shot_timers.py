"""Textual's timers of one call, in a process that gets no processor just as they begin."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
from tests.console.driving import on_main, until
from textual import timer

if TYPE_CHECKING:
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp


class Standing:
    """The clock of Textual's timers, which stands still in each of some looks."""

    looks = 0

    def get_time(self) -> float:
        if self.looks:
            self.looks -= 1
            time.sleep(0.1)
        return time.monotonic()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Standing:
    made = Standing()
    monkeypatch.setattr(timer, "_time", made)
    return made


@on_main()
async def test_only_call_is_not_skipped(app: ConsoleApp, pilot: Pilot[None], clock: Standing) -> None:
    called: list[str] = []
    clock.looks = 6
    app.set_timer(0.05, lambda: called.append("app"))
    app.main.set_timer(0.05, lambda: called.append("screen"))
    await until(pilot, lambda: sorted(called) == ["app", "screen"], "both calls", 20.0)

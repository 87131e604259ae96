"""Helpers of `test_pictures` and others."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from tests.console.driving import Steps, settled, shown
from textual.widgets import Input

if TYPE_CHECKING:
    from textual.pilot import Pilot

SnapCompare = Callable[..., bool]


def after(landmark: str, *keys: str) -> Steps:
    """Press `keys` once the topics are there, then require `landmark`."""

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        await shown(pilot, "q quit")
        await pilot.press(*keys)
        await shown(pilot, landmark)
        for field in pilot.app.screen.query(Input):
            field.cursor_blink = False
        await settled(pilot)

    return steps

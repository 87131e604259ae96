"""What an operator does to the bridge: every action that changes it, each a command to the engine."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, TypeVar

from textual import work
from textual.screen import Screen

from rsb_bridge.snapshot import State

if TYPE_CHECKING:
    from concurrent.futures import Future

    from rsb_bridge.snapshot import RouteSnapshot
    from rsb_console.app import ConsoleApp

T = TypeVar("T")


class OperationsScreen(Screen[None]):
    """The handlers of the registry's `Group.OPERATE`; the main screen adds how things are looked at."""

    app: ConsoleApp

    @property
    def selected(self) -> RouteSnapshot | None:
        """The topic under the cursor."""
        raise NotImplementedError

    async def command(self, future: Future[T], done: str = "") -> bool:
        """Wait for a command to the engine, and say how it went.

        Args:
            future: what the engine gave for it.
            done: what to say when it is done; empty: nothing.

        Returns:
            Whether it was done.
        """
        from rsb_bridge.engine import EngineError  # noqa: PLC0415 -- the first picture comes before the engine's imports

        try:
            await asyncio.wrap_future(future)
        except EngineError as error:
            self.notify(str(error), title="Not done", severity="error", markup=False, timeout=10)
            return False
        if done:
            self.notify(done, markup=False, timeout=3)
        self.app.pull()
        return True

    @work
    async def action_pause(self) -> None:
        """Pause the topic under the cursor, or resume it."""
        if self.app.engine is not None and self.selected is not None:
            paused = self.selected.state is State.PAUSED
            await self.command(
                self.app.engine.pause(self.selected.key, not paused),
                f"{self.selected.topic}: {'resumed' if paused else 'paused'}",
            )

    @work
    async def action_retry(self) -> None:
        """Connect again now."""
        if self.app.engine is not None:
            await self.command(self.app.engine.retry(), "trying again")

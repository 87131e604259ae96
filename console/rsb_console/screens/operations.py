"""What an operator does to the bridge: every action that changes it, each a command to the engine."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, TypeVar

from textual import work

from rsb_bridge.api import EngineError
from rsb_bridge.model.snapshot import State
from rsb_console.screens.session_operations import SessionOperationsScreen

if TYPE_CHECKING:
    from concurrent.futures import Future

    from rsb_bridge.model.snapshot import RouteSnapshot

T = TypeVar("T")


class OperationsScreen(SessionOperationsScreen):
    """The handlers of the registry's `Group.OPERATE`; the main screen adds how things are looked at."""

    @property
    def selected(self) -> RouteSnapshot | None:
        """The topic under the cursor."""
        raise NotImplementedError

    async def command(self, future: Future[T], done: str = "") -> bool:
        """Wait for a command to the engine, and say how it went.

        Args:
            future: what the engine gave for it.
            done: what to say when it is done, if the log doesn't say it; empty: nothing.

        Returns:
            Whether it was done.
        """
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
            await self.command(self.app.engine.pause(self.selected.key, not paused))

    @work
    async def action_retry(self) -> None:
        """Connect again now."""
        if self.app.engine is not None:
            await self.command(self.app.engine.retry(), "trying again")

    @work
    async def action_add_topic(self) -> None:
        """Bridge one more topic."""
        from rsb_console.screens.topic import TopicScreen  # noqa: PLC0415 -- keeps the start short

        engine = self.app.engine
        if engine is None:
            return
        draft = await self.app.push_screen_wait(TopicScreen(engine))
        if draft is not None:
            lasts = "" if engine.session.role == "client" else "; to last, it belongs in the client's session file"
            await self.command(engine.add_topic(draft.topic, draft.link), f"{draft.topic.topic}: added{lasts}")

    @work
    async def action_edit_topic(self) -> None:
        """Put something else in the place of the topic under the cursor."""
        from rsb_console.screens.topic import TopicScreen  # noqa: PLC0415 -- keeps the start short

        route, engine = self.selected, self.app.engine
        if route is None or engine is None:
            return
        draft = await self.app.push_screen_wait(TopicScreen(engine, route))
        if draft is not None and draft.topic != route.spec:
            await self.command(engine.edit_topic(route.key, draft.topic))

    @work
    async def action_remove_topic(self) -> None:
        """Bridge the topic under the cursor no longer; ask first."""
        from rsb_console.screens.confirm import ConfirmScreen  # noqa: PLC0415 -- keeps the start short

        route, engine = self.selected, self.app.engine
        if route is None or engine is None:
            return
        words = f"It stops crossing at once, on both sides of the link with {self.app.peer_of(route)}."
        if await self.app.push_screen_wait(ConfirmScreen(f"Remove {route.topic}?", words, "Remove")):
            await self.command(engine.remove_topic(route.key))

    @work
    async def action_restart(self) -> None:
        """Close the links on both sides and begin anew; ask first."""
        from rsb_console.screens.confirm import ConfirmScreen  # noqa: PLC0415 -- keeps the start short
        from rsb_console.screens.restart import RestartScreen  # noqa: PLC0415 -- keeps the start short

        engine = self.app.engine
        if engine is None:
            return
        if not self.app.snapshot().running:
            self.app.start_anew()
            return
        words = "Every link is closed on both sides and made anew. No topic crosses meanwhile: some seconds."
        if await self.app.push_screen_wait(ConfirmScreen("Restart the bridge?", words, "Restart")):
            await self.app.push_screen_wait(RestartScreen(engine))

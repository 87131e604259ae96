"""What changes the bridge: each action of the registry's `Group.OPERATE` is a command to the engine."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.model.snapshot import State
from rsb_console.look.patterns import PatternRow

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.console import Console
    from rsb_console.screens.topic import Draft


_LINES_SHOWN = 12
_RETRIED_ON_SERVER = "topics that were refused are opened again; clients whose links were shut down may come back"


def arming_means(route: RouteSnapshot) -> str:
    """What the operator is asked to agree to."""
    deadman = route.arming.deadman if route.arming is not None else 0.0
    keys = f", or no key is pressed here for {deadman:g} s" if deadman else ""
    way = f"to {route.remote_topic} on the other side" if route.outgoing else f"from there to {route.topic} here"
    what = "messages" if route.calls is None else "calls"
    return (
        f"From now on its {what} cross the link of {route.link}, {way}: {route.link} may move.\n"
        f"It disarms when the link drops, this console ends{keys}."
    )


def _removal(route: RouteSnapshot) -> str:
    if isinstance(route, PatternRow):
        return f"All that it has brought ({route.routes}) stop crossing at once"
    return "It stops crossing at once"


class BridgeOperations:
    """Methods named after their actions, each run as a worker.

    Args:
        console: the app.
        selected: gives the topic under the cursor.
    """

    def __init__(self, console: Console, selected: Callable[[], RouteSnapshot | None]) -> None:
        self._console = console
        self._selected = selected

    async def pause(self) -> None:
        """Pause the topic under the cursor, or resume it."""
        engine, route = self._console.engine, self._selected()
        if engine is not None and route is not None:
            await self._console.command(engine.pause(route.key, route.state is not State.PAUSED))

    async def acknowledge(self) -> None:
        """Acknowledge the fault of the topic under the cursor, or have it count again."""
        engine, route = self._console.engine, self._selected()
        if engine is not None and route is not None:
            await self._console.command(engine.acknowledge(route.key, route.acknowledged is None))

    async def arm(self) -> None:
        """Arm the topic under the cursor, after a question; disarm it at once, whoever armed it."""
        from rsb_console.screens.confirm import ConfirmScreen  # noqa: PLC0415 -- keeps the start short

        engine, route = self._console.engine, self._selected()
        if engine is None or route is None or route.arming is None:
            return
        if route.arming.armed:
            await self._console.command(engine.arming.disarm(route.key))
        elif await self._console.ask(ConfirmScreen(f"Arm {route.topic} of {route.link}?", arming_means(route), "Arm")):
            await self._console.command(engine.arming.arm(route.key))

    async def call(self) -> None:
        """Call what is under the cursor by hand."""
        from rsb_console.screens.call import CallScreen  # noqa: PLC0415 -- keeps the start short

        engine, route = self._console.engine, self._selected()
        if engine is not None and route is not None and route.lanes:
            await self._console.ask(CallScreen(self._console, route))

    async def retry(self) -> None:
        engine = self._console.engine
        if engine is not None:
            is_server = self._console.snapshot().role == "server"
            await self._console.command(engine.retry(), _RETRIED_ON_SERVER if is_server else "trying again")

    async def add_topic(self) -> None:
        from rsb_console.screens.topic import TopicScreen  # noqa: PLC0415 -- keeps the start short

        engine = self._console.engine
        if engine is None:
            return

        def add(draft: Draft) -> Awaitable[object]:
            return asyncio.wrap_future(engine.add_topic(draft.topic, draft.link))

        draft = await self._console.ask(TopicScreen(engine, add))
        if draft is not None:
            self._console.notify(f"{draft.topic.topic}: added", markup=False, timeout=3)
            self._console.pull()

    async def edit_topic(self) -> None:
        from rsb_console.screens.topic import TopicScreen  # noqa: PLC0415 -- keeps the start short

        engine, route = self._console.engine, self._selected()
        if route is None or engine is None:
            return

        async def edit(draft: Draft) -> None:
            if draft.topic != route.spec:
                await asyncio.wrap_future(engine.edit_topic(route.key, draft.topic))

        if await self._console.ask(TopicScreen(engine, edit, route)) is not None:
            self._console.pull()

    async def remove_topic(self) -> None:
        """Remove the topic under the cursor, after a question."""
        from rsb_console.screens.confirm import ConfirmScreen  # noqa: PLC0415 -- keeps the start short

        engine, route = self._console.engine, self._selected()
        if route is None or engine is None:
            return
        message = f"{_removal(route)}, on both sides of the link with {self._console.peer_of(route)}."
        if route.pattern:
            message += f" {route.pattern} leaves it out from then on (except)."
        if await self._console.ask(ConfirmScreen(f"Remove {route.topic}?", message, "Remove")):
            await self._console.command(engine.remove_topic(route.key))

    async def reload(self) -> None:
        """Have the session file read again, after showing what differs."""
        from rsb_console.screens.confirm import ConfirmScreen  # noqa: PLC0415 -- keeps the start short

        engine = self._console.engine
        if engine is None:
            return
        try:
            differs = await asyncio.wrap_future(engine.reload(dry_run=True))
        except EngineError as error:
            self._console.notify(str(error), title="Not reloaded", severity="error", markup=False, timeout=15)
            return
        if not differs.changed and not differs.left:
            self._console.notify("the bridge does what the session file says", timeout=3)
        elif not differs.changed:
            self._console.notify("\n".join(differs.left), title="Not in place", markup=False, timeout=15)
        else:
            lines = [*differs.changed, *differs.left]
            more = [f"… and {len(lines) - _LINES_SHOWN} more"] if len(lines) > _LINES_SHOWN else []
            message = "\n".join(lines[:_LINES_SHOWN] + more)
            agreed = await self._console.ask(ConfirmScreen("Reload the session file?", message, "Reload"))
            path = self._console.path
            if agreed and await self._console.command(engine.reload(), "reloaded") and path is not None:
                self._console.saved_to(engine.session, path)

    async def restart(self) -> None:
        """Close all links on both sides and open them again, after a question; start an engine that has ended."""
        from rsb_console.screens.confirm import ConfirmScreen  # noqa: PLC0415 -- keeps the start short
        from rsb_console.screens.restart import RestartScreen  # noqa: PLC0415 -- keeps the start short

        engine = self._console.engine
        if engine is None:
            return
        if not self._console.snapshot().running and self._console.attached_to:
            self._console.notify("the bridge has ended in its own process: start it there", severity="warning")
            return
        if not self._console.snapshot().running:
            await self._console.start_again()
            return
        message = "All links are closed on both sides and opened again. Nothing crosses for a few seconds."
        if await self._console.ask(ConfirmScreen("Restart the bridge?", message, "Restart")):
            await self._console.ask(RestartScreen(engine))

"""Changes of the whole bridge and its links."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.model.commands import Effect
from rsb_bridge.model.wording import Wording
from rsb_console.actions.action import FooterEntry
from rsb_console.screens.dialog import ConfirmScreen, RestartScreen

if TYPE_CHECKING:
    from rsb_console.screens.main import MainScreen

_LINES_SHOWN = 12
"""Lines of a question about a reload; the others are counted. A round figure."""
_RETRIED_ON_SERVER = "topics that were refused are opened again; clients whose links were shut down may come back"


class ReloadText(Wording):
    """Texts about reading the session file again."""

    AS_IN_FILE = "the bridge already runs as in the session file"
    RELOAD = "Reload the session file?"


async def retry(screen: MainScreen) -> None:
    from rsb_console.screens.links_screen import lets_back  # noqa: PLC0415 -- keeps the start short

    console = screen.console
    engine, now = console.engine, console.snapshot()
    if engine is not None and await lets_back(console, screen.app, now.links):
        done = _RETRIED_ON_SERVER if now.role == "server" else "trying again"
        await console.command(engine.retry(), done)


async def reload(screen: MainScreen) -> None:
    """Have the session file read again, after showing what differs."""
    console, engine = screen.console, screen.console.engine
    if engine is None:
        return
    try:
        differs = await asyncio.wrap_future(engine.reload(dry_run=True, drop_arm=True))
    except EngineError as error:
        console.notify(str(error), title="Not reloaded", severity="error", markup=False, timeout=15)
        return
    if not differs.changed and not differs.left:
        console.notify(ReloadText.AS_IN_FILE(), timeout=3)
    elif not differs.changed:
        console.notify("\n".join(differs.left), title="Not in place", markup=False, timeout=15)
    else:
        lines = [*differs.changed, *differs.left]
        more = [f"… and {len(lines) - _LINES_SHOWN} more"] if len(lines) > _LINES_SHOWN else []
        message = "\n".join(lines[:_LINES_SHOWN] + more)
        effect = Effect.MOVES | Effect.LOSES
        agreed = await console.ask(ConfirmScreen(ReloadText.RELOAD(), message, "Reload", effect))
        reloading = engine.reload(drop_arm=True, seen=differs.digest) if agreed else None
        if reloading is None or not await console.command(reloading):
            return
        if failed := reloading.result().failed:
            console.notify("\n".join(failed), title="Not done", severity="error", markup=False, timeout=15)
            return
        console.notify("reloaded", timeout=3)
        if (path := console.path) is not None:
            console.saved_to(engine.session, path)


async def restart(screen: MainScreen) -> None:
    """Close all links on both sides and open them again, after a question; start an engine that has ended."""
    console, engine = screen.console, screen.console.engine
    if engine is None:
        return
    if not console.snapshot().running and console.attached_to:
        console.notify("the bridge has ended in its own process: start it there", severity="warning")
        return
    if not console.snapshot().running:
        await console.start_again()
        return
    effect = Effect.MOVES | Effect.LOSES  # also of armings; and clients that were shut down may come back
    means = "All links are closed on both sides and opened again. Nothing crosses for a few seconds."
    if await console.ask(ConfirmScreen("Restart the bridge?", means, "Restart", effect)):
        await console.ask(RestartScreen(engine))


def links_in_footer(screen: MainScreen) -> FooterEntry:
    return FooterEntry("links", screen.link_counts)

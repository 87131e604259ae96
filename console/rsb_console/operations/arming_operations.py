"""Arming and disarming."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import State
from rsb_console.actions.action import FooterEntry
from rsb_console.screens.dialog import ArmScreen
from rsb_console.session.changes import present
from rsb_console.widgets.topics import is_armed

if TYPE_CHECKING:
    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.console_api import Console
    from rsb_console.screens.main import MainScreen


def disarms(screen: MainScreen) -> bool:
    """Whether the key that arms would disarm: the topic under the cursor, or else what this console holds."""
    route = screen.topics.route
    return bool(screen.console.deadman.held) if route is None or route.arming is None else is_armed(route)


def arms_or_disarms(screen: MainScreen) -> bool:
    route = screen.topics.route
    return (route is not None and route.arming is not None) or disarms(screen)


def arm_in_footer(screen: MainScreen) -> FooterEntry:
    return FooterEntry("disarm" if disarms(screen) else "arm")


async def arm(screen: MainScreen) -> None:
    """Arm the topic under the cursor, after a question; disarm it at once, even if another operator armed it.

    On a topic that is never armed, disarm what this console holds, if that is one topic.
    """
    console = screen.console
    engine, route = console.engine, screen.topics.route
    if engine is None:
        return
    if route is None or route.arming is None:
        held = [each for each in console.snapshot().routes if each.key in console.deadman.held]
        names = sorted({each.topic for each in held})
        if len(names) == 1:
            await _disarm(console, engine, held[0])
        elif names:
            text = f"go to the topic to disarm: {', '.join(names)}"
            console.notify(text, title="Not done", severity="warning", markup=False)
    elif is_armed(now := present(route, console.snapshot())) or is_armed(route):
        # This key stops a robot: it asks nobody, even if another operator holds the topic.
        await _disarm(console, engine, route)
    elif now.state is State.PAUSED:
        text = f"{route.topic} cannot be armed: it is paused; resume it first"
        console.notify(text, title="Not done", severity="warning", markup=False)
    elif await console.ask(ArmScreen(now)):
        console.deadman.armed_on(screen)
        await console.command(engine.arm(route.key))


async def _disarm(console: Console, engine: EngineApi, route: RouteSnapshot) -> None:
    """Disarm all routes of a name, on all links."""
    armed = [
        each.key
        for each in console.snapshot().routes
        if (each.topic, each.spec.kind) == (route.topic, route.spec.kind) and each.key != route.key
        if each.arming is not None and each.arming.armed
    ]
    # All commands are sent before the first answer: a slow one must not keep the others armed.
    for future in [engine.disarm(key) for key in (route.key, *armed)]:
        await console.command(future)
    if armed:
        console.notify(f"{route.topic}: all its {len(armed) + 1} routes are disarmed", markup=False, timeout=5)

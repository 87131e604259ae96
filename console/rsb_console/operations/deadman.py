"""Keeps armed what this console has armed: as long as it is drawn, and its operator presses keys."""

from __future__ import annotations

from typing import TYPE_CHECKING

from textual.events import Key

if TYPE_CHECKING:
    from textual.events import Event

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.snapshot import Snapshot


class Deadman:
    """Tells the engine, at each refresh, that the console is there, and of keys since the last one."""

    def __init__(self) -> None:
        self._pressed = False

    def saw(self, event: Event) -> None:
        """Note a key, whatever it does."""
        self._pressed |= isinstance(event, Key)

    def keep(self, engine: EngineApi | None, snapshot: Snapshot) -> None:
        """Keep armed what is; the engine knows what this console has armed."""
        pressed, self._pressed = self._pressed, False
        if engine is not None and any(route.arming and route.arming.here for route in snapshot.routes):
            engine.arming.keep(pressed=pressed)

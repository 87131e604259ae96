"""The proof that the operator watches what is armed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from weakref import WeakSet

from textual.events import Key

if TYPE_CHECKING:
    from concurrent.futures import Future

    from textual.events import Event
    from textual.screen import Screen

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.by_hand import Held
    from rsb_bridge.model.snapshot import Snapshot


class Deadman:
    """Tells the engine, at each refresh, that the console is there, and of keys since the last one.

    Only keys on a screen on which a topic was armed count: who reads the help does not watch the robot.

    Attributes:
        held: keys of the routes that this console holds, as the engine answers.
    """

    def __init__(self) -> None:
        self.held: frozenset[str] = frozenset()
        self._pressed = False
        self._screens: WeakSet[Screen[Any]] = WeakSet()

    def armed_on(self, screen: Screen[Any]) -> None:
        """Note that a topic is armed on a screen."""
        self._screens.add(screen)

    def saw(self, event: Event, screen: Screen[Any]) -> None:
        """Note a key press on a screen."""
        self._pressed |= isinstance(event, Key) and screen in self._screens

    def keep(self, engine: EngineApi | None, snapshot: Snapshot) -> None:
        """Keep armed what is, and a question open; the engine knows what this console has armed, or asks for."""
        pressed, self._pressed = self._pressed, False
        armings = [route.arming for route in snapshot.routes if route.arming is not None]
        if engine is not None and any(each.here or each.asked_by for each in armings):
            engine.keep_armed(pressed=pressed).add_done_callback(self._note)
        else:
            self.held = frozenset()

    def _note(self, kept: Future[Held]) -> None:
        """Note what this console holds. Called on any thread."""
        if not kept.cancelled() and kept.exception() is None:
            self.held = frozenset(kept.result().keys)

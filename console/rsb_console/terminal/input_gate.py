"""Keeps keys that came late, or were meant for the screen before, from screens on which a key has an effect."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, ClassVar, TypeGuard

from textual import events
from textual.screen import Screen

from rsb_bridge.model.wording import Wording
from rsb_console.terminal.pulse import FRESH_FOR, heard_before, is_from_terminal

if TYPE_CHECKING:
    from collections.abc import Callable

    from textual.app import App
    from textual.message import Message

    from rsb_console.terminal.pulse import Pulse

SEEN_AFTER = 0.5
"""s from the picture of a question until its keys count: nobody reads and answers it earlier."""
_TOLD_EVERY = 3.0
"""s between two notes about late keys, and for which one stays: a held key would fill the screen with them."""


class LateInput(Wording):
    """Texts about keys that do not count."""

    LIST_MOVED = "the list has moved: look, and press the key again"


class GuardedScreen(Screen[Any]):
    """A screen whose keys count only once the operator may have seen it, if it is guarded.

    Attributes:
        SAFE_KEYS: keys that always count.
        is_guarded: whether its keys have an effect.
        moves: whether that may move a robot: then only young input counts. Any other answer may take its time.
        seen_after: s from its first picture until other keys count.
        opens_itself: whether it opens while the operator does something else: each key restarts that time then.
    """

    SAFE_KEYS: ClassVar[frozenset[str]] = frozenset()
    is_guarded = True
    moves = True
    opens_itself = False
    seen_after = 0.0
    drawn_at: float | None = None


class InputGate:
    """Decides which input a `GuardedScreen` gets.

    Args:
        clock: gives s on the clock of `textual.events.Event.time`.

    Attributes:
        pulse: the terminal's, or None without a terminal: then no input is late.
        is_young: whether the newest input, which the app handles now, is certainly young.
    """

    def __init__(self, app: App[Any], clock: Callable[[], float] = time.monotonic) -> None:
        self.pulse: Pulse | None = None
        self.is_young = True
        self._app = app
        self._clock = clock
        self._told_at = float("-inf")

    @classmethod
    def of(cls, app: App[Any]) -> InputGate:
        """Return the gate of an app."""
        gate: InputGate = app.input_gate  # type: ignore[attr-defined]  # `TerminalApp` is in a layer above
        return gate

    @property
    def is_on(self) -> bool:
        """Whether there is a terminal whose input may be late."""
        return self.pulse is not None

    def is_late(self, event: Message) -> bool:
        """Whether an event from the terminal may be older than `FRESH_FOR`."""
        return self.is_on and self._clock() - heard_before(event) >= FRESH_FOR

    def refuses(self, event: Message, screen: Screen[Any]) -> bool:
        """Whether a screen must not get an event; the operator gets the reason."""
        if self.pulse is None or not _is_pressed(event):
            return False
        # A form that splits a paste makes events of its own: these are as young as the paste.
        if is_from_terminal(event):
            self.is_young = not (self.pulse.relayed or self.is_late(event))
        if not is_guarded(screen):
            return False
        if isinstance(event, events.Key) and event.key in screen.SAFE_KEYS:
            return False
        # Without a note: while a question's keys do not count yet, it shows … in their place.
        if not (screen.moves and self.is_late(event)):
            seen = self._was_seen(screen, heard_before(event))
            if not seen and screen.opens_itself and screen.drawn_at is not None:
                screen.drawn_at = self._clock()  # an operator who types on has not read it
            return not seen
        if self._clock() - self._told_at > _TOLD_EVERY:
            self._told_at = self._clock()
            self._app.notify("keys came late: they are ignored", severity="warning", timeout=_TOLD_EVERY)
        return True

    def was_seen(self, changed_at: float) -> bool:
        """Whether the operator may have seen what changed at a time (s); if not, they get a note."""
        if not self.is_on or self._clock() - changed_at >= SEEN_AFTER:
            return True
        self._app.notify(LateInput.LIST_MOVED(), severity="warning", timeout=_TOLD_EVERY)
        return False

    def takes_keys(self, screen: GuardedScreen) -> bool:
        """Whether a key that is pressed now would count."""
        return self.pulse is None or self._was_seen(screen, self.pulse.heard_now)

    def _was_seen(self, screen: GuardedScreen, heard: float) -> bool:
        """Whether the operator may have read a screen before input that came after an answer."""
        if screen.seen_after == 0.0:
            return True
        drawn_at = screen.drawn_at
        # An answer to a question after the picture proves that the terminal has it.
        return drawn_at is not None and self._clock() - drawn_at >= screen.seen_after and heard >= drawn_at


def is_guarded(screen: Screen[Any]) -> TypeGuard[GuardedScreen]:
    """Whether keys on a screen have an effect."""
    return isinstance(screen, GuardedScreen) and screen.is_guarded


def _is_pressed(event: Message) -> bool:
    # Other events, such as moves of the mouse, do nothing that could come too late.
    return isinstance(event, (events.Key, events.Paste, events.MouseDown, events.MouseUp, events.Click))

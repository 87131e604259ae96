"""Gives keys, pastes and clicks to the app one by one, and keeps late ones from screens on which they have an effect.

Each comes after all that the one before it has set off. Textual hands a key from widget to widget through their message
queues, and runs its binding only once the key has come back to the app. By then the next keys of the same burst have
gone to the widget that had the focus before: they are lost, or overtake one another. A slow line delivers such bursts,
and so does a busy machine.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from typing import TYPE_CHECKING, Any, ClassVar, Final, Protocol, TypeGuard
from weakref import WeakKeyDictionary, WeakSet

from textual import events
from textual.screen import Screen
from textual.worker import Worker, get_current_worker

from rsb_bridge.model.wording import Wording
from rsb_console.library_internals.textual_internals import PALETTE_GROUP, has_messages, holds_message, is_idle
from rsb_console.terminal.pulse import FRESH_FOR, Pulse, heard_before, is_from_terminal

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator

    from textual.app import App
    from textual.geometry import Region
    from textual.message import Message

DIALOG: Final = "dialog"
"""Group of the workers of a screen that may open a dialog."""
PATIENCE = 5.0
"""s that input waits at most for the effects of the input before it. A round figure: without it, a worker that hangs
would hold keys back for ever; with much less, keys overtake a dialog that a busy machine is still opening."""
_LOOK_EVERY = 0.005
"""s between two looks whether the app has finished: at most so much later comes a key of a burst."""
SEEN_AFTER = 0.5
"""s from the picture of a question until its keys count: nobody reads and answers it earlier."""
ANSWERED_WITHIN = 5.0
"""s from that picture in which an answer counts whose age nothing proves. A round figure: an operator who reads for
longer presses one key more."""
_TOLD_EVERY = 3.0
"""s between two notes about late keys, and for which one stays: a held key would fill the screen with them."""


class InputQueue:
    """Holds input back while the app has not finished with the input before it.

    The app has finished when the widgets of its top screen have no message left, and no worker is about to open a
    dialog. A worker that waits for an open dialog's answer holds nothing back: the input is for that dialog.

    Args:
        groups: groups of the workers that may open a dialog, besides `DIALOG`.
    """

    def __init__(self, app: App[Any], groups: Collection[str]) -> None:
        self._app = app
        self._groups = {DIALOG, PALETTE_GROUP, *groups}
        self._waiting: deque[Message] = deque()
        self._next: Message | None = None
        self._task: asyncio.Task[None] | None = None
        self._dialogs: WeakKeyDictionary[Worker[Any], Screen[Any]] = WeakKeyDictionary()
        self._abandoned: WeakSet[Worker[Any]] = WeakSet()
        """Workers that input no longer waits for."""

    @classmethod
    def of(cls, app: App[Any]) -> InputQueue:
        """Return the queue of an app."""
        queue: InputQueue = app.input_queue  # type: ignore[attr-defined]  # `TerminalApp` is in a layer above
        return queue

    def takes(self, event: Message) -> bool:
        """Whether the queue takes an event of the app, which comes to the app again when it is the event's turn."""
        if event.is_forwarded or not isinstance(event, events.InputEvent | events.Paste):
            return False
        if not self._app.screen_stack:
            return True  # what is typed while the app ends is for nobody, and Textual would look for a screen
        if isinstance(event, events.MouseMove):
            return False
        if event is self._next:
            self._next = None
            return False
        # A lone key goes through at once.
        if not self.delivers and not holds_message(self._app) and self._has_settled():
            return False
        self._waiting.append(event)
        self._begin()
        return True

    @property
    def delivers(self) -> bool:
        """Whether input waits, or the app has not finished with the last."""
        return self._task is not None

    def insert(self, inputs: Iterable[Message]) -> None:
        """Handle `inputs` before all waiting input."""
        self._waiting.extendleft(reversed([*inputs]))
        self._begin()

    def _begin(self) -> None:
        if not self.delivers and self._waiting:
            self._task = asyncio.create_task(self._deliver())

    def waits_for(self, dialog: Screen[Any]) -> None:
        """Note that the current worker waits for the answer of `dialog`."""
        self._dialogs[get_current_worker()] = dialog

    async def _deliver(self) -> None:
        try:
            while self._waiting:
                await self._settle()
                self._next = self._waiting.popleft()
                # The app is closing, and takes no messages any more.
                if not self._app.post_message(self._next):
                    return
        finally:
            self._task = None

    async def _settle(self) -> None:
        clock = asyncio.get_running_loop().time
        deadline = clock() + PATIENCE
        while not (is_idle(self._app) and self._has_settled()):
            if clock() > deadline:
                # Else each further input would wait for the same worker again.
                self._abandoned.update(self._opening())
                return
            await asyncio.sleep(_LOOK_EVERY)

    def _has_settled(self) -> bool:
        """Whether the app has finished all work except the message that it handles now."""
        app = self._app
        if has_messages(app):
            return False
        if not app.screen_stack:
            return True
        screen = app.screen
        return (
            is_idle(screen)
            and all(is_idle(widget) for widget in screen.walk_children())
            and next(self._opening(), None) is None
        )

    def _opening(self) -> Iterator[Worker[Any]]:
        """Yield the workers that may open a dialog before they do anything else that concerns input."""
        shown = self._app.screen_stack
        return (
            worker
            for worker in self._app.workers
            if worker.group in self._groups
            and not worker.is_finished
            and worker not in self._abandoned
            and self._dialogs.get(worker) not in shown
        )


class LateInput(Wording):
    """Texts about keys that do not count."""

    LATE = "keys came late: they are ignored"
    MAY_BE_ANOTHER = "the terminal may have changed: keys are ignored until it answers"
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

    def hands_over(self, key: str) -> bool:
        """Whether it shows by itself who asks for the arming of a route, and takes the answer."""
        return False


class Sight(Protocol):
    """What a terminal has of the screen.

    Attributes:
        late: s by which it has an older picture.
    """

    @property
    def late(self) -> float: ...

    def has(self, region: Region) -> bool:
        """Whether it has all of a region, or soon will."""


class InputGate:
    """Decides which input a `GuardedScreen` gets.

    Args:
        clock: gives s on the clock of `textual.events.Event.time`.

    Attributes:
        pulse: the terminal's, or None without a terminal: then no input is late.
        sight: what the operator sees of the screen, or None if that is all.
        is_young: whether the newest input, which the app handles now, is certainly young.
        came_at: s, when that input came to this process.
    """

    def __init__(self, app: App[Any], clock: Callable[[], float] = time.monotonic) -> None:
        self.pulse: Pulse | None = None
        self.sight: Sight | None = None
        self.is_young = True
        self.came_at = float("inf")
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
        """Whether an event from the terminal may be older than `FRESH_FOR`, or is about what is not seen any more.

        A terminal that answers proves both at once: an answer comes behind the picture that it has.
        """
        if not self.is_on:
            return False
        heard = heard_before(event)
        is_proven = heard < float("inf") or not is_from_terminal(event)
        is_blind = not is_proven and self.sight is not None and self.sight.late > SEEN_AFTER
        return is_blind or self._clock() - heard >= FRESH_FOR

    def refuses(self, event: Message, screen: Screen[Any]) -> bool:
        """Whether a screen must not get an event; the operator gets the reason."""
        if not _is_pressed(event):
            return False
        self.came_at = event.time
        if self.pulse is None:
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
            seen = self._was_seen(screen, event.time, heard_before(event))
            if not seen and (screen.opens_itself or self.waits_for_key(screen)):
                screen.drawn_at = self._clock()  # an operator who types on has not read it
            return not seen
        if self._clock() - self._told_at > _TOLD_EVERY:
            self._told_at = self._clock()
            text = LateInput.MAY_BE_ANOTHER() if self.pulse.is_doubted else LateInput.LATE()
            self._app.notify(text, severity="warning", timeout=_TOLD_EVERY)
        return True

    def was_seen(self, changed_at: float) -> bool:
        """Whether the newest input came after the operator may have seen a change (s); if not, they get a note."""
        if not self.is_on or self.came_at - changed_at >= SEEN_AFTER:
            return True
        self._app.notify(LateInput.LIST_MOVED(), severity="warning", timeout=_TOLD_EVERY)
        return False

    def takes_keys(self, screen: GuardedScreen) -> bool:
        """Whether a key that is pressed now would count."""
        return self.pulse is None or self._was_seen(screen, self._clock(), self.pulse.heard_now)

    def has_shown(self, region: Region) -> bool:
        """Whether the terminal has a part of the screen."""
        return self.sight is None or self.sight.has(region)

    def waits_for_key(self, screen: GuardedScreen) -> bool:
        """Whether a question has to be shown again, at any key, before it can be answered.

        Nothing proves that an answer behind a multiplexer is young. But once a question has been open for long, an
        answer may be from long before, too.
        """
        return screen.drawn_at is not None and self._is_open_too_long(screen, screen.drawn_at, self._clock())

    def _is_open_too_long(self, screen: GuardedScreen, drawn_at: float, now: float) -> bool:
        relayed = self.pulse is not None and self.pulse.relayed
        # A question that opens by itself is over soon by itself, too.
        waits = screen.moves and screen.seen_after > 0.0 and not screen.opens_itself
        return relayed and waits and now - drawn_at > ANSWERED_WITHIN

    def _was_seen(self, screen: GuardedScreen, came_at: float, heard: float) -> bool:
        """Whether the operator may have read a screen before input that came at a time (s), after an answer."""
        if screen.seen_after == 0.0:
            return True
        if (drawn_at := screen.drawn_at) is None or self._is_open_too_long(screen, drawn_at, came_at):
            return False
        # An answer to a question after the picture proves that the terminal has it.
        return came_at - drawn_at >= screen.seen_after and heard >= drawn_at


def is_guarded(screen: Screen[Any]) -> TypeGuard[GuardedScreen]:
    """Whether keys on a screen have an effect."""
    return isinstance(screen, GuardedScreen) and screen.is_guarded


def _is_pressed(event: Message) -> bool:
    # Other events, such as moves of the mouse, do nothing that could come too late.
    return isinstance(event, (events.Key, events.Paste, events.MouseDown, events.MouseUp, events.Click))

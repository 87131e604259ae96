"""Gives keys, pastes and clicks to the app one at a time, each after all that the one before it has set off.

Textual hands a key from widget to widget through their message queues, and runs its binding only once the key has come
back to the app. By then the next keys of the same burst have gone to the widget that had the focus before: they are
lost, or overtake one another. A slow line delivers such bursts, and so does a busy machine.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakKeyDictionary, WeakSet

from textual import events
from textual.command import CommandPalette
from textual.worker import Worker, get_current_worker

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from textual.app import App
    from textual.message import Message
    from textual.message_pump import MessagePump
    from textual.screen import Screen

DIALOG: Final = "dialog"
"""Group of the workers of a screen that may open a dialog."""
PATIENCE = 5.0
"""s that input waits at most for the effects of the input before it. A round figure: without it, a worker that hangs
would hold keys back for ever; with much less, keys overtake a dialog that a busy machine is still opening."""
_LOOK_EVERY = 0.005
"""s between two looks whether the app has finished: at most so much later comes a key of a burst."""


class InputQueue:
    """Holds input back while the app has not finished with the input before it.

    The app has finished when the widgets of its top screen have no message left, and no worker is about to open a
    dialog. A worker that waits for an open dialog's answer holds nothing back: the input is for that dialog.

    Args:
        groups: groups of the workers that may open a dialog, besides `DIALOG`.
    """

    def __init__(self, app: App[Any], groups: Collection[str]) -> None:
        self._app = app
        self._groups = {DIALOG, CommandPalette._GATHER_COMMANDS_GROUP, *groups}
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
        # A lone key goes through at once. Textual may hold one more message than its queue shows.
        if not self.delivers and self._app._pending_message is None and self._has_settled():
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
        while not (_is_idle(self._app) and self._has_settled()):
            if clock() > deadline:
                # Else each further input would wait for the same worker again.
                self._abandoned.update(self._opening())
                return
            await asyncio.sleep(_LOOK_EVERY)

    def _has_settled(self) -> bool:
        """Whether the app has finished all work except the message that it handles now."""
        app = self._app
        if not app._message_queue.empty():
            return False
        if not app.screen_stack:
            return True
        screen = app.screen
        return (
            _is_idle(screen)
            and all(_is_idle(widget) for widget in screen.walk_children())
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


def _is_idle(pump: MessagePump) -> bool:
    """Whether a message pump waits for its next message."""
    ready: asyncio.Event = pump._message_queue.ready_event
    return bool(ready._waiters) and not ready.is_set()

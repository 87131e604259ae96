"""What every part of a running engine shares."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.event_limit import LimitedLog

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Sequence

    from rsb_bridge.event_log import EventLog
    from rsb_bridge.ros.api import RosSide, Taken
    from rsb_bridge.session import Session
    from rsb_bridge.snapshot import Level

_BACKLOG = 64
_PATIENCE = 0.1


class Receiver(Protocol):
    """Where a subscription's messages go on the I/O loop."""

    def offer(self, batch: Sequence[Taken]) -> None:
        """Take messages, oldest first."""
        ...


class Handoff:
    """Messages on their way from the ROS thread to the I/O loop: one wake-up a drain, and a bound.

    While the loop is `_BACKLOG` batches behind, the ROS thread waits; DDS keeps each topic's newest messages meanwhile.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._batches: deque[tuple[Receiver, Sequence[Taken]]] = deque()
        self._room = threading.Event()
        self._scheduled = False

    def put(self, receiver: Receiver, batch: Sequence[Taken]) -> None:
        """Called on the ROS thread."""
        self._batches.append((receiver, batch))
        if not self._scheduled:
            self._scheduled = True
            try:
                self._loop.call_soon_threadsafe(self._drain)
            except RuntimeError:  # the loop is closed: the engine has stopped
                self._batches.clear()
                return
        if len(self._batches) > _BACKLOG:
            self._room.clear()
            self._room.wait(_PATIENCE)

    def _drain(self) -> None:
        self._scheduled = False
        while self._batches:
            receiver, batch = self._batches.popleft()
            receiver.offer(batch)
        self._room.set()


@dataclass(slots=True)
class Context:
    """The parts that routes and links work with.

    Attributes:
        session: for its defaults; its topics and clients are the engine's business.
        domain_id: the ROS domain joined.
        ros: the ROS side.
        events: what happened.
        handoff: from the ROS thread to the I/O loop.
        loop: the I/O loop; all engine state belongs to its thread.
        limited: the way to `events` for what a peer may be the cause of.
    """

    session: Session
    domain_id: int
    ros: RosSide
    events: EventLog
    handoff: Handoff
    loop: asyncio.AbstractEventLoop
    limited: LimitedLog = field(init=False)

    def __post_init__(self) -> None:
        self.limited = LimitedLog(self.events)

    def log(
        self, level: Level, source: str, text: str, *, link: str = "", topic: str = "", vital: bool = False
    ) -> None:
        """Add an event; of a link's, those that are within its share (`LimitedLog`)."""
        if link:
            self.limited.add(level, source, text, link=link, topic=topic, vital=vital)
        else:
            self.events.add(level, source, text, topic=topic)

    def call(self, work: Callable[[], None]) -> None:
        """Do something on the I/O thread, from another; nothing happens once the engine has stopped."""
        with contextlib.suppress(RuntimeError):
            self.loop.call_soon_threadsafe(work)

    @staticmethod
    def now() -> float:
        """s, on the clock that all timers use."""
        return time.monotonic()

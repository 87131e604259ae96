"""The ROS thread as the engine sees it: its turns, and the queue from it to the I/O loop.

A process that was stopped goes on as if nothing had happened, and its thread then takes messages that have waited in
DDS meanwhile. So the thread notes the time at each turn while anybody has to know how old messages can be.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from rsb_bridge.model.clock import Clock
from rsb_bridge.ros.turn_pacing import TurnPacing
from rsb_bridge.transport.streams import JoinedWrites

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Hashable, Sequence

LONGEST_WAIT = 0.25
"""Seconds that the thread waits at most while it is watched. A lease ends after 1 s without a turn (`route.lease`)."""
_LATE = 0.5
"""Seconds between two turns from which on the thread, or the whole process, stood still: twice the longest wait."""
_CATCHES_UP = 0.25
"""Seconds after a standstill in which DDS may still bring what it should have brought before.

A round figure: how long DDS takes was not measured. If it takes longer, an armed message counts as younger than it is.
"""
_BACKLOG = 64
"""Batches: 4,096 messages, or 256 MiB of large ones. A round figure."""
_PATIENCE = 0.1
"""Seconds that the ROS thread waits for the loop at most: a loop that hangs must not keep the node from stopping, and
one that closes an endpoint waits for the end of this wait."""
T_contra = TypeVar("T_contra", contravariant=True)
T = TypeVar("T")


class RosTurns:
    """When the ROS thread turned. The thread writes, any thread reads.

    Args:
        wake: has the thread turn at once, or None if messages come without a thread, and so without a wait.
        steady: the clock, in s, or None for the machine's.

    Attributes:
        watched: whether anybody wants to know; else nothing is noted.
        at: s, the last turn.
        since: s; what is taken in this turn came after that.
        count: turns that were noted.
        pacing: when the next turn may be.
        gathering: the identifier of the thread, if it takes from several endpoints, and what it took is handed on at
            `gathered`; or 0.
        hand_on: hands on what was gathered, or None. Set on the thread while it gathers, by the one queue behind it.
    """

    def __init__(self, wake: Callable[[], None] | None = None, steady: Callable[[], float] | None = None) -> None:
        self._wake = wake
        self._steady = steady or Clock().steady
        self._watchers: set[Hashable] = set()
        self._caught_up_at = 0.0
        self.watched = False
        self.count = 0
        self.pacing = TurnPacing()
        self.gathering = 0
        self.hand_on: Callable[[], None] | None = None
        self.at = self.since = float("inf")

    def gathered(self) -> None:
        """Hand on what the thread has gathered."""
        self.gathering = 0
        hand_on, self.hand_on = self.hand_on, None
        if hand_on is not None:
            hand_on()

    def watch(self, watcher: Hashable) -> None:
        """Have the thread note its turns. May be called again."""
        if self._wake is None or watcher in self._watchers:
            return
        self._watchers.add(watcher)
        if not self.watched:
            # Before `watched`: the thread compares with these once it sees that it is watched.
            self.at = self.since = self._steady()
            self.watched = True
            # Its present wait may have no end.
            self._wake()

    def leave(self, watcher: Hashable) -> None:
        """End `watch`."""
        self._watchers.discard(watcher)
        if not self._watchers:
            self.watched = False
            self.at = self.since = float("inf")

    def turned(self) -> None:
        """Note the beginning of a turn. Called on the ROS thread while it is watched, before it takes messages."""
        now = self._steady()
        if now - self.at > _LATE:
            self._caught_up_at = now + _CATCHES_UP
        if now >= self._caught_up_at:
            self.since = self.at
        self.at = now
        self.count += 1


class BatchReceiver(Protocol[T_contra]):
    """The receiver of an endpoint's messages, requests or responses on the I/O loop."""

    def offer(self, batch: Sequence[T_contra]) -> None:
        """Take them, oldest first."""


class RosToLoopQueue:
    """Messages on their way from the ROS thread to the I/O loop: no wake-up while the loop waits, else one a drain.

    The thread with the loop's turn drains it, so messages keep their order on either thread. While the loop is
    `_BACKLOG` batches behind, the ROS thread puts in one each `_PATIENCE` s at most; DDS keeps each topic's newest
    messages meanwhile.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        do_now: Callable[[Callable[[], object]], bool] | None = None,
        turns: RosTurns | None = None,
    ) -> None:
        """Begin.

        Args:
            do_now: does the loop's work on the calling thread or returns False, or None if the loop has none.
            turns: of the ROS thread, or None if there is none.
        """
        self.joined = JoinedWrites()
        self._turns = turns or RosTurns()
        self._loop = loop
        self._do_now = do_now or (lambda _: False)
        self._batches: deque[tuple[BatchReceiver[Any], Sequence[Any], bool]] = deque()
        self._room = threading.Event()
        self._is_full = False  # the ROS thread waits, or is about to
        self._scheduled = False

    def put(self, receiver: BatchReceiver[T], batch: Sequence[T], *, express: bool = False) -> None:
        """Called on the ROS thread, or on that of an internal route's own source.

        Args:
            express: whether they are handed on at once, and leave at once with all that waits.
        """
        self._batches.append((receiver, batch, express))
        turns = self._turns
        # Beyond its bound, each batch waits for room.
        if not express and turns.gathering == threading.get_ident() and len(self._batches) <= _BACKLOG:
            turns.hand_on = self._hand_on
        else:
            self._hand_on()

    def _hand_on(self) -> None:
        if self._do_now(self._drain):
            return
        if not self._scheduled:
            self._schedule()
        if len(self._batches) > _BACKLOG:
            self._room.clear()
            self._is_full = True
            if self._batches:  # else they were drained before the drain could see that this thread waits
                self._room.wait(_PATIENCE)
            self._is_full = False

    def _drain(self) -> None:
        # First: a batch that is put in after the last look at the queue schedules a drain of its own.
        self._scheduled = False
        joined = self.joined
        try:
            while self._batches:
                receiver, batch, express = self._batches.popleft()
                if self._batches:  # more to join
                    joined.is_open = True
                receiver.offer(batch)
                if express:
                    joined.send_all()
        finally:
            if self._is_full:
                self._room.set()
            if self._batches:  # a receiver has failed: the others' go on
                self._schedule()
            joined.send_all()

    def _schedule(self) -> None:
        self._scheduled = True
        try:
            self._loop.call_soon_threadsafe(self._drain)
        except RuntimeError:  # the loop is closed: the engine has stopped
            self._batches.clear()

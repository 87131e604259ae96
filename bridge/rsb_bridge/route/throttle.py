"""Rate limits (``max_rate``): which messages pass."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.history_depth import Sample

_MOST_PUBLISHERS = 4096  # of a latched topic, as in one control message (`wire.fields`)


class Throttle:
    """Leaves out messages, so that a topic keeps to its highest rate, or each of its publishers does.

    Attributes:
        rate: messages a second, or 0 for any number.
    """

    def __init__(self, rate: float) -> None:
        self._due: dict[bytes, int] = {}
        self.limit(rate)

    def limit(self, rate: float) -> None:
        """Keep to another rate from now on."""
        self.rate = rate
        self._interval = int(1e9 / rate) if rate else 0
        self._due.clear()

    @property
    def is_on(self) -> bool:
        """Whether there is a highest rate."""
        return self._interval > 0

    def passes(self, stamp: int, publisher: bytes = b"") -> bool:
        """Whether a message passes that was received at `stamp` (ns)."""
        interval = self._interval
        if not interval:
            return True
        due = self._due.get(publisher, 0)
        late = stamp - due
        # A stamp a little older than the last one is out of order; one much older comes from a clock that was set back.
        if -2 * interval <= late < 0:
            return False
        if len(self._due) >= _MOST_PUBLISHERS:
            # Any node can make publishers: one message too many of each is better than a table without a limit.
            self._due.clear()
        # Due times keep their own beat, so that a 50 Hz topic throttled to 20 Hz gives 20, not 16.7.
        self._due[publisher] = (due if 0 <= late < interval else stamp) + interval
        return True

    def due(self, publisher: bytes) -> int:
        """Return when (ns, as stamps are) the next message of a publisher passes."""
        return self._due.get(publisher, 0)


class LastLater:
    """Has the last message that a throttle leaves out pass after all, if none follows it.

    It may be the one that stops a robot. It passes one beat later, so that a stream is never delayed.

    Args:
        send: takes the message.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, throttle: Throttle, send: Callable[[RawMessage], None]) -> None:
        self._loop = loop
        self._throttle = throttle
        self._send = send
        self._waiting: RawMessage | None = None
        self._passes_at = 0.0
        self._timer: asyncio.TimerHandle | None = None

    def follow(self, left_out: RawMessage | None) -> int:
        """Note the newest message: one that is left out waits from now on, and one that passes leaves none waiting.

        Returns:
            How many messages wait no longer.
        """
        before, self._waiting = self._waiting, left_out
        if left_out is not None:
            self._passes_at = self._loop.time() + 1.0 / self._throttle.rate
            # One timer that looks again when it ends, instead of a new one for each message.
            if self._timer is None:
                self._timer = self._loop.call_at(self._passes_at, self._end_wait)
        return int(before is not None)

    def flush(self) -> None:
        """Send the message that waits, if one does."""
        message, self._waiting = self._waiting, None
        if message is not None:
            # It passes anyway; the call sets when the next one is due.
            self._throttle.passes(message.stamp + int(1e9 / self._throttle.rate))
            self._send(message)

    def _end_wait(self) -> None:
        self._timer = None
        if self._waiting is not None and self._loop.time() < self._passes_at:
            self._timer = self._loop.call_at(self._passes_at, self._end_wait)
        else:
            self.flush()


class LatestLater:
    """A throttle for a latched topic: of the messages that come too fast, the last one passes later.

    Late joiners get the message that was published last, so it must pass, even if no other one follows it.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        throttle: Throttle,
        send: Callable[[Sequence[Sample]], None],
        paused: Callable[[], bool],
    ) -> None:
        """Begin.

        Args:
            paused: whether no message may pass now; `resume` then sends the messages that are due.
        """
        self._loop = loop
        self._throttle = throttle
        self._send = send
        self._paused = paused
        self._waiting: dict[bytes, tuple[int, Sample]] = {}
        self._timers: dict[bytes, asyncio.TimerHandle] = {}

    def admit(self, samples: Sequence[Sample]) -> tuple[list[Sample], int]:
        """Take messages, oldest first. A history is never throttled, because late joiners get it.

        Returns:
            The messages that pass now, and the number of messages that newer ones of their publishers replace.
        """
        admitted: list[Sample] = []
        left_out = 0
        for sample in samples:
            publisher, stamp = sample.header.publisher, sample.message.stamp
            passes = sample.replayed or self._throttle.passes(stamp, publisher)
            # Even if the new one passes: otherwise the older one would follow it, and late joiners would get that.
            if publisher in self._waiting:
                left_out += self._forget(publisher)
            if passes:
                admitted.append(sample)
            elif len(self._waiting) < _MOST_PUBLISHERS:
                due = self._throttle.due(publisher)
                self._waiting[publisher] = due, sample
                self._timers[publisher] = self._loop.call_later((due - stamp) / 1e9, self._pass, publisher)
            else:
                left_out += 1
        return admitted, left_out

    def resume(self) -> None:
        """Send the messages that have become due."""
        for publisher in self._waiting.keys() - self._timers.keys():
            self._pass(publisher)

    def clear(self) -> int:
        """Drop the waiting messages, and return their number."""
        return sum(self._forget(publisher) for publisher in tuple(self._waiting))

    def _forget(self, publisher: bytes) -> int:
        if self._waiting.pop(publisher, None) is None:
            return 0
        timer = self._timers.pop(publisher, None)
        if timer is not None:
            timer.cancel()
        return 1

    def _pass(self, publisher: bytes) -> None:
        self._timers.pop(publisher, None)
        if self._paused():
            return
        due, sample = self._waiting.pop(publisher)
        # This one passes anyway; the call sets when the next one is due.
        self._throttle.passes(due, publisher)
        self._send([sample])

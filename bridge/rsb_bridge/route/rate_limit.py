"""The highest rate of a topic's messages, its origin, and the messages that pass at that rate (``max_rate``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.keep import Keep
from rsb_bridge.model.limits import ROUTES_PER_LINK
from rsb_bridge.model.session import priority_of
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.topic_keys import TOPIC_KEYS

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Sequence

    from rsb_bridge.model.topic_keys import TopicKey
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.history_depth import Sample
    from rsb_bridge.route.lifecycle import PauseState
    from rsb_bridge.wire.messages import Propose

_AT_ONCE = 1.0  # s of the rate that may come at once, after a link has stalled
_FEWEST_AT_ONCE = 2.0  # messages: a bucket that holds less than one never gives any
_TOPICS = 2 * ROUTES_PER_LINK  # that have lately had messages, of routes that are there or were
_CLOCKS_DIFFER = 1.01  # the sender's clock, by which it keeps to the rate, may be faster than this side's
_MOST_PUBLISHERS = 4096  # of a latched topic, as in one control message (`wire.records`)


class AllowedRates:
    """The rates at which one link's peer may publish on topics here, over all routes and openings."""

    def __init__(self) -> None:
        self._buckets: dict[tuple[str, float], TokenBucket] = {}
        self._swept_at = float("-inf")

    def admits(self, topic: str, rate: float, now: float) -> bool:
        """Whether one more message comes at no more than `rate` Hz, at `now` (s)."""
        bucket = self._buckets.get((topic, rate))
        if bucket is None:
            if len(self._buckets) >= _TOPICS:
                self._sweep(now)
            if len(self._buckets) >= _TOPICS:
                return False
            bucket = TokenBucket(_at_once(rate), rate * _CLOCKS_DIFFER, now)
            self._buckets[topic, rate] = bucket
        return bucket.take(1.0, now)

    def _sweep(self, now: float) -> None:
        """Forget the topics that have been quiet for so long that their buckets are full again."""
        # A peer may name new topics at any rate, and a sweep asks all of them.
        if now < self._swept_at + 1.0:
            return
        self._swept_at = now
        self._buckets = {key: each for key, each in self._buckets.items() if each.left(now) < _at_once(key[1])}


class RateLimit:
    """The rate limit of one route: the lowest one. The sender keeps to it; the receiver enforces its own.

    Args:
        max_rate: Hz, of the topic's entry, or 0 for any.
    """

    def __init__(self, max_rate: float, log: Callable[[Level, EventCode, str], None]) -> None:
        self.switched: Callable[[], None] = lambda: None  # called whenever one of the next two has changed
        self.rate = self._max_rate = max_rate  # Hz, or 0 if all messages cross
        self.here = 0.0  # Hz that this side allows, or 0 for any
        self._switched_at = self.rate, self.here
        self._there = self._there_before = self._profile = 0.0
        self._log = log

    @property
    def why(self) -> str:
        """The origin of the limit, for an operator."""
        if self.rate == self._max_rate:
            return "set on purpose (max_rate)"
        if self.rate == self._profile:
            return "the session's profile (max_rate overrides it)"
        return "this side allows no more (allow)" if self.rate == self.here else "the other side allows no more"

    @property
    def own(self) -> float:
        """Hz that this side lets cross, by its rights and its profile, or 0 for any."""
        return _lowest(self.here, self._profile)

    def lowered(self, rate: float | None) -> float | None:
        """Return a rate (Hz) that is usual without the limit, or None if it is unknown, as it is with the limit."""
        return min(rate, self.rate) if rate and self.rate else rate

    def opened(self) -> None:
        """Begin a new opening: the other side will send its limit again."""
        self._there = 0.0
        self._changed()

    def set_max_rate(self, rate: float) -> None:
        self._max_rate = rate
        self._changed()

    def set_profile_rate(self, rate: float) -> bool:
        """Take the rate of the link's profile; return whether it is another one than before."""
        if rate == self._profile:
            return False
        self._profile = rate
        self._changed()
        return True

    def allow_here(self, rate: float) -> bool:
        """Take the rate that this side's rights allow; return whether it is another one than before."""
        if rate == self.here:
            return False
        self.here = rate
        self._changed()
        self._log(Level.INFO, EventCode.ROUTE_AMENDED, f"this side allows {_figure(rate)} (allow)")
        return True

    def allow_there(self, rate: float) -> None:
        self._there = rate
        self._changed()
        # Kept over openings, so that the same limit is logged once.
        if rate != self._there_before:
            self._there_before = rate
            self._log(Level.INFO, EventCode.ROUTE_AMENDED, f"the other side allows {_figure(rate)}")

    def _changed(self) -> None:
        rates = _lowest(self._max_rate, self.here, self._there, self._profile), self.here
        if rates != self._switched_at:
            self._switched_at = rates
            self.rate = rates[0]
            self.switched()


class Throttle:
    """Leaves out messages, so that a topic keeps to its highest rate, or each of its publishers does.

    Attributes:
        rate: messages a second, or 0 for any number.
    """

    def __init__(self, rate: float) -> None:
        self._due: dict[bytes, int] = {}
        self.limit(rate)

    def limit(self, rate: float) -> None:
        self.rate = rate
        self._interval = int(1e9 / rate) if rate else 0
        self._due.clear()

    @property
    def is_on(self) -> bool:
        return self._interval > 0

    def passes(self, stamp: int, publisher: bytes = b"") -> bool:
        """Whether a message passes that was received at `stamp` (ns); if so, the next one is due an interval later."""
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

    def follow(self, due: int) -> None:
        """Take over when (ns) the next message is due from a topic of the same beat: one passes now."""
        if self._interval:
            self._due[b""] = due

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
        message, self._waiting = self._waiting, None
        if message is not None:
            # It passes anyway, and sets when the next one is due.
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
        pausing: PauseState,
    ) -> None:
        """Begin.

        Args:
            pausing: no message passes while it is paused; `resume` then sends those that are due.
        """
        self._loop = loop
        self._throttle = throttle
        self._send = send
        self._pausing = pausing
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
        return sum(self._forget(publisher) for publisher in tuple(self._waiting))

    def _forget(self, publisher: bytes) -> int:
        if self._waiting.pop(publisher, None) is None:
            return 0
        if (timer := self._timers.pop(publisher, None)) is not None:
            timer.cancel()
        return 1

    def _pass(self, publisher: bytes) -> None:
        self._timers.pop(publisher, None)
        if self._pausing.paused:
            return
        due, sample = self._waiting.pop(publisher)
        # It passes anyway, and sets when the next one is due.
        self._throttle.passes(due, publisher)
        self._send([sample])


def _at_once(rate: float) -> float:
    return max(_FEWEST_AT_ONCE, rate * _AT_ONCE)


def _lowest(*rates: float) -> float:
    return min(filter(None, rates), default=0.0)


def _figure(rate: float) -> str:
    return f"at most {rate:g} Hz" if rate else "any rate"


def limits_changed(old: Propose, new: Propose) -> str:
    """Return the differences between the limits of two proposals, for an operator."""
    changed = [
        f"{name} {_limit_text(before, key)} → {_limit_text(after, key)}"
        for name, key in TOPIC_KEYS.items()
        if key.live and name != "priority" and (before := getattr(old, name)) != (after := getattr(new, name))
    ]
    before, after = priority_of(old.priority), priority_of(new.priority)
    return ", ".join(changed + ([f"priority {before} → {after}"] if before != after else []))


def _limit_text(value: float | Keep | bool | str | None, key: TopicKey) -> str:
    if key.value == "choice":
        return "as the profile says" if value is None else "yes" if value else "no"
    if key.value == "switch":
        return "yes" if value else "no"
    if value is None or not (value or key.zero):
        return "none"
    return str(value) if isinstance(value, Keep | str) else f"{value:g} {key.unit}"

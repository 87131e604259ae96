"""Rate limits, and how topics make room for topics of a higher priority while their link is full.

A best-effort topic is thinned: messages are left out evenly before they are packed, so that the others arrive fresh. A
topic with ``priority: low`` is thinned, too, with any QoS. All other reliable or latched topics are held back: messages
wait in the queue, in order, and the queue drops the oldest ones once it is full.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.capacity import rates_text
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.telemetry.meters import Smoothed

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Sequence

    from rsb_bridge.channel.channel import SendingChannel
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.history_depth import Sample
    from rsb_bridge.wire.framing import Message

_MOST_PUBLISHERS = 4096
THINNED = "thinned"
"""Cause in the ledger."""
SLOWEST = 0.1
"""Lowest rate (Hz) to which a topic is thinned, so that it does not seem to have stopped."""
PER_MESSAGE = 60
"""Bytes on the wire in addition to a message's content: header, seal, and a part of the packets' headers."""
_SHOWN = 5.0
"""Seconds for which a topic counts as thinned after a message was left out."""
_LESS = 0.95
"""A topic is thinned if less than this share of its demand crosses; smaller differences do not show."""
_FADES = 0.8
"""The part of the messages so far that still counts a second later, for the size of the average one."""


class Throttle:
    """Leaves out messages, so that a topic keeps to its highest rate, or each of its publishers does.

    Args:
        rate: messages a second, or 0 for any number.
    """

    def __init__(self, rate: float) -> None:
        self._due: dict[bytes, int] = {}
        self.limit(rate)

    def limit(self, rate: float) -> None:
        """Keep to another rate from now on."""
        self._interval = int(1e9 / rate) if rate else 0
        self._due.clear()

    def adjust(self, rate: float) -> None:
        """Change the rate, but keep the beat: no message passes only because of the change."""
        self._interval = int(1e9 / rate) if rate else 0

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
            self._due.clear()
        # Due times keep their own beat, so that a 50 Hz topic throttled to 20 Hz gives 20, not 16.7.
        self._due[publisher] = (due if 0 <= late < interval else stamp) + interval
        return True

    def due(self, publisher: bytes) -> int:
        """Return when (ns, as stamps are) the next message of a publisher passes."""
        return self._due.get(publisher, 0)


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
            loop: the I/O loop.
            throttle: decides.
            send: gets the messages that pass later.
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
        self._throttle.passes(due, publisher)
        self._send([sample])


class Share(NamedTuple):
    """The share of a link that a topic has now.

    Attributes:
        bytes_per_second: of the topic.
        carried: bytes/s that the link carries.
        asked: bytes/s that all topics of the link want to send.
        first: a topic with a higher priority.
    """

    bytes_per_second: float
    carried: float
    asked: float
    first: str


class ThinningShare(NamedTuple):
    """The figures of a topic that is thinned or held back, for an operator.

    Attributes:
        share: of the link.
        rate: Hz that cross.
        wanted: Hz that are published, within the topic's own limit.
        thins: whether messages are left out, instead of waiting.
        since: time (s) when it began.
    """

    share: Share
    rate: float
    wanted: float
    thins: bool
    since: float


class Traffic(NamedTuple):
    """The traffic of one topic since the last look.

    Attributes:
        bytes_per_second: that it wants to send.
        size: bytes of an average message on the wire.
        busy: s for which its channel has been busy, or 0 if it is idle.
    """

    bytes_per_second: float
    size: float
    busy: float


_IDLE = Traffic(0.0, 0.0, 0.0)


class Thinning:
    """The thinning of one sending half.

    Attributes:
        share: of the link, or None without a limit.
        thins: whether messages are left out.
        holds: whether messages wait for the topic's share of the link.
        offered: messages that the topic wanted to send since the last look, within its own rate limit.
        busy_since: time (s) from which on the channel had more to send than it took, or None if it has not.
        changed: called when `thins` may have changed.
    """

    def __init__(self, now: float) -> None:
        self.share: Share | None = None
        self.thins = self.holds = False
        self.offered = 0
        self.busy_since: float | None = None
        self.changed: Callable[[], object] = bool
        self._throttle = Throttle(0.0)
        self._rate = 0.0
        self._messages, self._bytes, self._before = 0.0, 0.0, 0.0  # packed lately, and until the last look
        self._gone = 0  # messages that were sent while the topic is held back, since the last look
        self._size = 0.0
        self._wanted = Smoothed(now)
        self._crossed = Smoothed(now)
        self._next_at = 0.0
        self._thinned_at = self._since = float("-inf")
        self._now = now

    # --- the share of the link

    def take_share(self, share: Share | None, *, low: bool, qos: Qos | None, now: float) -> None:
        """Take a share at `now` (s).

        Args:
            share: of the link, or None if the link carries all topics.
            low: whether the topic has the priority low.
            qos: of the topic.
            now: s.
        """
        if share is None and self.share is None:
            return
        before, self.share = self.share, share
        if share is None:
            self.thins = self.holds = False
            self._rate = self._next_at = 0.0
            self._throttle.adjust(0.0)
            self.changed()
            return
        if before is not None:  # the last message takes as long as it would have with this share
            left = self.wait(now) * max(1.0, before.bytes_per_second)
            self._next_at = now + left / max(1.0, share.bytes_per_second)
        latched = qos is not None and qos.latched
        self.thins = not latched and (low or qos is None or qos.reliability == "best_effort")
        self.holds = not self.thins
        self._rate = max(SLOWEST, share.bytes_per_second / max(1.0, self._size)) if self.thins else 0.0
        self._throttle.adjust(self._rate)
        self.changed()
        if self.holds and share.bytes_per_second < self._wanted.rate * self._size:
            self._mark(now)

    def look(self, now: float) -> Traffic:
        """Return the traffic since the last call. Called once a second."""
        if not self.offered and self._wanted.idle(now) and self._crossed.idle(now):
            return _IDLE
        if self._messages:
            self._size = PER_MESSAGE + self._bytes / self._messages
        self._wanted.add(self.offered, now)
        self._crossed.add(self._gone if self.holds else self._messages - self._before, now)
        self._messages *= _FADES
        self._bytes *= _FADES
        self._before = self._messages
        self.offered = self._gone = 0
        self._now = now
        busy = 0.0 if self.busy_since is None else now - self.busy_since
        return Traffic(self._wanted.rate * self._size, self._size, busy)

    # --- messages

    def keep(self, batch: Sequence[RawMessage], now: float) -> Sequence[RawMessage]:
        """Return the messages of a thinned topic that are sent, at `now` (s), and count the others as offered."""
        passes = self._throttle.passes
        kept = [message for message in batch if passes(message.stamp)]
        if len(kept) < len(batch):
            self.offered += len(batch) - len(kept)
            self._mark(now)
        return kept

    def packed(self, messages: int, size: int) -> None:
        """Count messages that are sent, of `size` bytes together."""
        self._messages += messages
        self._bytes += size

    def _mark(self, now: float) -> None:
        if now - self._thinned_at > _SHOWN:
            self._since = now
        self._thinned_at = now

    # --- being held back

    def wait(self, now: float) -> float:
        """Return the seconds until the next message may be sent at `now` (s)."""
        return max(0.0, self._next_at - now) if self.holds else 0.0

    def over(self, channel: SendingChannel, now: float) -> SendingChannel:
        """Return the channel, or one that takes no more than the share while messages are held back."""
        return _Held(self, channel, now) if self.holds else channel

    def sent(self, size: int, now: float) -> None:
        """Count bytes that a topic sends at `now` (s) although it is held back."""
        assert self.share is not None
        self._gone += 1
        self._next_at = max(self._next_at, now) + size / max(1.0, self.share.bytes_per_second)

    def busy(self, busy: bool, now: float) -> None:
        """Note whether the channel has more to send than it takes at `now` (s)."""
        if not busy:
            self.busy_since = None
        elif self.busy_since is None:
            self.busy_since = now

    # --- for operators

    def limit(self, rate: float) -> float:
        """Return the lower one of the topic's own limit and the rate it is thinned to (Hz), or 0 for no limit."""
        return min(filter(None, (rate, self._rate)), default=0.0)

    def shown(self) -> ThinningShare | None:
        """Return the figures to show, or None if messages cross as fast as they are published."""
        if self.share is None or self._now - self._thinned_at > _SHOWN:
            return None
        if self._crossed.rate >= _LESS * self._wanted.rate:
            return None  # it has just recovered
        return ThinningShare(self.share, self._crossed.rate, self._wanted.rate, self.thins, self._since)


def verdict_of(thinned: ThinningShare) -> Verdict:
    """Return the verdict on a topic that is thinned or held back."""
    link = why(thinned)
    if thinned.thins:
        text = f"thinned to {_hertz(thinned)}: {link}"
    else:
        text = (
            f"held back to {_hertz(thinned)}: {link}; what its queue does not hold is "
            "dropped (priority: low thins it instead)"
        )
    return Verdict(State.SLOW, Cause.THINNED, text, thinned.since)


def why(thinned: ThinningShare) -> str:
    """Return the reason for the thinning, for an operator."""
    share = thinned.share
    return f"the link carries {rates_text(share.carried, share.asked)}, and {share.first} goes first"


def _hertz(thinned: ThinningShare) -> str:
    """``4 of 30 Hz``."""
    rate, wanted = (f"{each:.0f}" if each >= 9.95 else f"{each:.2g}" for each in (thinned.rate, thinned.wanted))
    return f"{rate} of {wanted} Hz"


class _Held:
    """A channel that takes one message at a time, and the next one when the share allows it."""

    batch_bytes = 1

    def __init__(self, thinning: Thinning, channel: SendingChannel, now: float) -> None:
        self._thinning = thinning
        self._channel = channel
        self._time = now
        self.ready = channel.ready
        self.carrier = channel.carrier

    @property
    def congested(self) -> bool:
        return self._channel.congested or self._thinning.wait(self._time) > 0.0

    def send(self, batch: Sequence[Message]) -> None:
        self._thinning.sent(sum([PER_MESSAGE + len(message[0]) for message in batch]), self._time)
        self._channel.send(batch)

    def trouble(self) -> str:
        return self._channel.trouble()

    def close(self, reason: str) -> None:
        self._channel.close(reason)

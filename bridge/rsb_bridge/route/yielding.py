"""What a topic leaves to others of its link with a higher priority, while the link carries less than is asked for.

A best-effort topic is thinned: messages are left out evenly before they are packed, so that those that cross are fresh.
So is one whose entry says ``priority: low``, whatever its QoS: somebody wants it to go first. Any other reliable or
latched topic is held back: its messages wait in its queue, in order, and what that does not hold is dropped as ever.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.capacity import rates_text
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.route.throttle import Throttle
from rsb_bridge.telemetry.meters import Smoothed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.channel import SendingChannel
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.wire.framing import Message

THINNED = "thinned"
"""The ledger's cause."""
SLOWEST = 0.1
"""Hz: a topic is never thinned below that, so that it does not seem to have stopped."""
PER_MESSAGE = 60
"""Bytes that a message takes on the wire beside its content, about: header, seal and its part of the packets'."""
_SHOWN = 5.0
"""s that a topic counts as thinned after the last message that was left out."""
_LESS = 0.95
"""A topic is thinned if less than this share of its demand crosses; smaller differences do not show."""
_FADES = 0.8
"""The part of the messages so far that still counts a second later, for the size of the average one."""


class Share(NamedTuple):
    """What a topic has of its link for now.

    Attributes:
        bytes_per_second: its part.
        carried: what the link carries, in bytes/s.
        asked: what all its topics want together, likewise.
        first: a topic that goes first.
    """

    bytes_per_second: float
    carried: float
    asked: float
    first: str


class Yielded(NamedTuple):
    """What an operator is told of a topic that yields.

    Attributes:
        share: what it has.
        rate: Hz that cross.
        wanted: Hz that are published, within the topic's own limit.
        thins: messages are left out; False: they wait.
        since: s, when it began.
    """

    share: Share
    rate: float
    wanted: float
    thins: bool
    since: float


class Traffic(NamedTuple):
    """What one topic has sent since the last look.

    Attributes:
        bytes_per_second: that it wants to send.
        size: bytes of its messages, on average.
        busy: s for which its channel has not been idle; 0: it is.
    """

    bytes_per_second: float
    size: float
    busy: float


_IDLE = Traffic(0.0, 0.0, 0.0)


class Yielding:
    """One sending half's.

    Attributes:
        share: what it has of its link; None: as much as it likes.
    """

    def __init__(self, now: float) -> None:
        self.share: Share | None = None
        self._thins = True
        self._throttle = Throttle(0.0)
        self._rate = 0.0
        self._offered = 0
        self._messages, self._bytes, self._before = 0.0, 0.0, 0.0  # packed lately, and until the last look
        self._gone = 0  # messages that were sent while the topic is held back, since the last look
        self._size = 0.0
        self._wanted = Smoothed(now)
        self._crossed = Smoothed(now)
        self._busy_since: float | None = None
        self._next_at = 0.0
        self._thinned_at = self._since = float("-inf")
        self._now = now

    # --- what the link says

    def told(self, share: Share | None, *, low: bool, qos: Qos | None, now: float) -> None:
        """Take a share, at `now` (s); None: there is enough for all.

        Args:
            share: of the link.
            low: the topic's entry says that it goes first.
            qos: of the topic.
            now: s.
        """
        if share is None and self.share is None:
            return
        before, self.share = self.share, share
        if share is None:
            self._rate = self._next_at = 0.0
            self._throttle.adjust(0.0)
            return
        if before is not None:  # the last message takes as long as it would have with this share
            left = self.wait(now) * max(1.0, before.bytes_per_second)
            self._next_at = now + left / max(1.0, share.bytes_per_second)
        latched = qos is not None and qos.latched
        self._thins = not latched and (low or qos is None or qos.reliability == "best_effort")
        rate = max(SLOWEST, share.bytes_per_second / max(1.0, self._size)) if self._thins else 0.0
        self._rate = rate
        self._throttle.adjust(rate)
        if not self._thins and share.bytes_per_second < self._wanted.rate * self._size:
            self._mark(now)

    def look(self, now: float) -> Traffic:
        """Once a second: what it wants."""
        if not self._offered and self._wanted.idle(now) and self._crossed.idle(now):
            return _IDLE
        if self._messages:
            self._size = PER_MESSAGE + self._bytes / self._messages
        self._wanted.add(self._offered, now)
        self._crossed.add(self._gone if self.holds else self._messages - self._before, now)
        self._messages *= _FADES
        self._bytes *= _FADES
        self._before = self._messages
        self._offered = self._gone = 0
        self._now = now
        busy = 0.0 if self._busy_since is None else now - self._busy_since
        return Traffic(self._wanted.rate * self._size, self._size, busy)

    # --- messages

    def keep(self, batch: Sequence[RawMessage], now: float) -> Sequence[RawMessage]:
        """Those of some messages of a volatile topic that go, oldest first, at `now` (s)."""
        self._offered += len(batch)
        if not self._rate or not self._thins:
            return batch
        passes = self._throttle.passes
        kept = [message for message in batch if passes(message.stamp)]
        if len(kept) < len(batch):
            self._mark(now)
        return kept

    def latched(self, messages: int) -> None:
        """So many messages of a latched topic go, which never are thinned."""
        self._offered += messages

    def left_out(self, messages: int) -> None:
        """Count so many messages less: the transport does not carry them."""
        self._offered -= messages

    def packed(self, messages: int, size: int) -> None:
        """So many messages go, of so many bytes together."""
        self._messages += messages
        self._bytes += size

    def _mark(self, now: float) -> None:
        if now - self._thinned_at > _SHOWN:
            self._since = now
        self._thinned_at = now

    # --- being held back

    @property
    def holds(self) -> bool:
        """Whether messages have to wait for their part of the link."""
        return self.share is not None and not self._thins

    def wait(self, now: float) -> float:
        """S until the next message may go, at `now` (s); 0: at once."""
        return max(0.0, self._next_at - now) if self.holds else 0.0

    def over(self, channel: SendingChannel, now: float) -> SendingChannel:
        """The channel, which takes no more than the share while messages are held back."""
        return _Held(self, channel, now) if self.holds else channel

    def sent(self, size: int, now: float) -> None:
        """Bytes of a topic that is held back go, at `now` (s)."""
        assert self.share is not None
        self._gone += 1
        self._next_at = max(self._next_at, now) + size / max(1.0, self.share.bytes_per_second)

    def busy(self, busy: bool, now: float) -> None:
        """Note whether the channel has more to send than it takes, at `now` (s)."""
        if not busy:
            self._busy_since = None
        elif self._busy_since is None:
            self._busy_since = now

    # --- what is made of it

    def limit(self, rate: float) -> float:
        """The lower one of the topic's own limit and what it is thinned to, in Hz; 0: none."""
        return min(filter(None, (rate, self._rate)), default=0.0)

    def shown(self) -> Yielded | None:
        """What to tell an operator; None: nothing."""
        if self.share is None or self._now - self._thinned_at > _SHOWN:
            return None
        if self._crossed.rate >= _LESS * self._wanted.rate:
            return None  # it has just recovered
        return Yielded(self.share, self._crossed.rate, self._wanted.rate, self._thins, self._since)


def verdict_of(yielded: Yielded) -> Verdict:
    """What an operator is told."""
    link = why(yielded)
    if yielded.thins:
        text = f"thinned to {_hertz(yielded)}: {link}"
    else:
        text = (
            f"held back to {_hertz(yielded)}: {link}; what its queue does not hold is "
            "dropped (priority: low thins it instead)"
        )
    return Verdict(State.SLOW, Cause.THINNED, text, yielded.since)


def why(yielded: Yielded) -> str:
    """Why it yields."""
    share = yielded.share
    return f"the link carries {rates_text(share.carried, share.asked)}, and {share.first} goes first"


def _hertz(yielded: Yielded) -> str:
    """``4 of 30 Hz``."""
    rate, wanted = (f"{each:.0f}" if each >= 9.95 else f"{each:.2g}" for each in (yielded.rate, yielded.wanted))
    return f"{rate} of {wanted} Hz"


class _Held:
    """A channel that takes one message at a time, and the next one when the share allows it."""

    batch_bytes = 1

    def __init__(self, yielding: Yielding, channel: SendingChannel, now: float) -> None:
        self._yielding = yielding
        self._channel = channel
        self._time = now
        self.ready = channel.ready
        self.carrier = channel.carrier

    @property
    def congested(self) -> bool:
        return self._channel.congested or self._yielding.wait(self._time) > 0.0

    def send(self, batch: Sequence[Message]) -> None:
        self._yielding.sent(sum([PER_MESSAGE + len(message[0]) for message in batch]), self._time)
        self._channel.send(batch)

    def trouble(self) -> str:
        return self._channel.trouble()

    def close(self, reason: str) -> None:
        self._channel.close(reason)

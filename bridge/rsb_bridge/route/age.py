"""Holds a route's messages and requests to `max_age`, to their publishers' lifespan, and commands to `LATEST`.

Each side measures a message's age when it would hand it on: the sender when it gives the message to the channel, the
receiver when it would publish it. Nothing in between matters: queues, holds, pauses, reconnects.

Where the age is not known exactly, `max_age` drops the message: the uncertainty of the other side's clock counts
against it. A lifespan promises less, and drops what is surely older; so does `LATEST`, which holds for what may move a
robot where no session says otherwise.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.clock import shifted
from rsb_bridge.model.demands import default_max_age, smallest_max_age
from rsb_bridge.model.motion import LATEST, SLOWEST
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.ros.ros_interface import RawMessage, Request
from rsb_bridge.telemetry.watches import LATELY, LOSSY_ABOVE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.clock import StampClock
    from rsb_bridge.route.peer import Peer
    from rsb_bridge.wire.framing import Message

EXPIRED = "expired"
"""The cause under which the receiver reports messages that were too old."""
_CALLER = 16  # bytes of `Request.caller` that identify the caller; the others identify the request
_MOST_PUBLISHERS = 1024  # whose clocks are known to be wrong: any node can make some. A forgotten one is measured again
# For the next two nothing was measured. With ten times as much, commands pass that are half a second too old.
_SANE = 50_000_000  # ns by which a right clock may seem to be wrong, and so an age: as much as the smallest `max_age`
_AHEAD = 0.05  # s, beyond the uncertainty, by which a message may seem to come from the future
_DRIFT = 5e-4  # ns a ns by which a publisher's clock may run differently: as much as adjtimex(2) may change it, 500 ppm
_REMEDIES = {
    Cause.LINK_SLOW: "the link is too slow: set max_rate or priority",
    Cause.CLOCK_UNKNOWN: "age unknown: wait 10 s, or raise max_age",
    Cause.PUBLISHER_STAMPS_OLD: "stamps are old: check the publisher's clock",
}


class PublisherClocks:
    """The clocks of one topic's publishers, or of one service's callers. All times are in ns.

    Attributes:
        since: when the subscription began, or None if messages from before it may come.
    """

    def __init__(self) -> None:
        self.since: int | None = None
        self._wrong: dict[bytes, tuple[int, int]] = {}  # the shortest time that a message took, and when that was

    def __len__(self) -> int:
        return len(self._wrong)

    def born(self, source: int, taken: int, publisher: bytes) -> int:
        """Return the time from which a message's age counts; it is not later than `taken`.

        Args:
            source: when it was published, by its publisher's clock, or 0 if that is unknown.
            taken: when it came here.
        """
        if not source:
            return taken
        took = taken - source
        known = self._wrong.get(publisher)
        if known is None:
            # A volatile topic has no message from before the subscription: an earlier stamp shows that its clock lags.
            if took >= -_SANE and (self.since is None or source >= self.since - _SANE):
                return min(source, taken)
            if len(self._wrong) >= _MOST_PUBLISHERS:
                del self._wrong[next(iter(self._wrong))]
            self._wrong[publisher] = took, taken
            return taken
        shortest, at = known
        # A message that took longer than the shortest one was held up by the difference, even if the clock is wrong.
        # Without the drift, each message of a slow clock would count as older than the one before.
        shortest = min(took, shortest + int(_DRIFT * max(0, taken - at)))
        if abs(shortest) <= _SANE:
            del self._wrong[publisher]  # its clock has been set
            return min(source, taken)
        self._wrong[publisher] = shortest, taken
        return source + shortest

    def forget(self) -> None:
        """Forget all measurements, because this side's clock was set.

        From then on, a stamp from before the subscription may come from the old clock, and proves nothing.
        """
        self._wrong.clear()
        self.since = None


class Expired(NamedTuple):
    """Messages that were dropped lately because they were too old."""

    cause: Cause  # of most of them
    lost: int
    of: int  # messages among which these were lost
    limit: float
    since: float


class MessageAge:
    """Age limit of one route half, and the messages that it has dropped."""

    def __init__(self, context: Context, peer: Peer) -> None:
        self.is_on = False  # ages are limited at all
        self.switched: Callable[[], None] = lambda: None  # called whenever `is_on` has changed
        self.max_age = 0.0  # s that holds for the two sides, or 0 for no limit
        # s that the other side's session sets where it has accepted the route, 0 for no limit, or None if it sets none.
        self.accepted: float | None = None
        self.only_newest = False  # of what waits for the link only the newest may pass, as it may move a robot
        self.publishers = PublisherClocks()  # of those whose messages are taken
        self._context = context
        self._peer = peer
        self._lifespan = 0.0  # s, or 0 for none
        self._latest = 0.0  # s, beyond the usual delay of the link, or 0 for any age
        self._limit = 0.0  # s: the smallest one of `max_age` and these two
        self._limit_ns = 0
        self._steps = 0
        self._counts: Counter[Cause] = Counter()
        self._lately: deque[tuple[int, Counter[Cause]]] = deque(maxlen=LATELY + 1)
        self._since: float | None = None

    def settle(
        self, demands: Iterable[float | None], *, armed: bool, lifespan: float = 0.0, moves: bool = False
    ) -> None:
        """Apply the demands of both sides.

        Args:
            demands: limits of both sides: s, 0 for no limit, or None if a session sets none.
            lifespan: s, of its publishers, or 0 for none.
            moves: whether its messages may move a robot, and are not kept.
        """
        stated = smallest_max_age(demands)
        self.max_age = default_max_age(stated, armed=armed) or 0.0
        self.only_newest = moves and stated != 0.0
        self._lifespan, self._latest = lifespan, LATEST if moves and stated is None else 0.0
        self._limit = min(filter(None, (self.max_age, lifespan, self._latest)), default=0.0)
        self._limit_ns = int(self._limit * 1e9)
        was_on, self.is_on = self.is_on, self._limit > 0.0
        if self.is_on != was_on:
            self.switched()

    # --- the side that takes from ROS

    def stamped(self, batch: Sequence[RawMessage]) -> list[RawMessage]:
        """Return messages from ROS, each with the time from which its age counts as its stamp, or 0 if none is sure."""
        clock = self._compared_clock()
        shift, born = clock.shift, self.publishers.born
        if not clock.is_sure:
            if not self.max_age:
                return [each._replace(stamp=shifted(each.stamp, shift)) for each in batch]
            # 0 is older than any limit: the next sieve drops it, also that of a latched topic.
            return [each._replace(stamp=0) for each in batch]
        return [
            RawMessage(payload, born(source and source + shift, stamp + shift, gid), gid, number, lease, source)
            for payload, stamp, gid, number, lease, source in batch
        ]

    def fresh(self, batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        """Return the stamped messages that are young enough as they come from ROS, and count the others."""
        if not self._context.stamps.is_sure:
            if not self.max_age:
                return batch
            self.expired(Cause.CLOCK_UNKNOWN, len(batch))
            return ()
        oldest = self.oldest
        fresh = [each for each in batch if each.stamp >= oldest]
        if len(fresh) < len(batch):
            self.expired(Cause.PUBLISHER_STAMPS_OLD, len(batch) - len(fresh))
        return fresh

    def aged(self, request: Request) -> Request:
        """Return a request with the time from which its age counts as its stamp, or 0 if it is too old."""
        clock, source = self._compared_clock(), request.source
        if not clock.is_sure:  # nor is a stamp from before it was set compared with it
            return request._replace(stamp=0)
        caller = request.caller[:_CALLER]
        stamp = self.publishers.born(source and source + clock.shift, request.stamp + clock.shift, caller)
        return request._replace(stamp=stamp if self.is_young(stamp) else 0)

    @property
    def oldest(self) -> int:
        """The stamp (ns) of the oldest message of this side that may be sent now, if ages are limited."""
        return self._context.stamps.now() - self._limit_ns

    def is_young(self, stamp: int) -> bool:
        """Whether a message of this side with such a stamp may be sent now."""
        return not self.is_on or stamp >= self.oldest

    def young(self, messages: Sequence[Message]) -> Sequence[Message]:
        """Return the messages of this side that may be sent now, and count the others."""
        oldest = self.oldest
        young = [each for each in messages if each[1] >= oldest]
        if len(young) == len(messages):
            return messages
        self.expired(Cause.LINK_SLOW, len(messages) - len(young))
        return young

    def _compared_clock(self) -> StampClock:
        clock = self._context.stamps
        clock.compare()
        if clock.steps != self._steps:
            self._steps = clock.steps
            self.publishers.forget()
        return clock

    # --- the side that gives to ROS

    def why_old(self, stamp: int) -> Cause | None:
        """Return the reason why a message of the other side may not be published now, or None if it may.

        Args:
            stamp: ns, by the other side's clock.
        """
        clock = self._peer.stamps
        offset, uncertainty = clock.offset, clock.uncertainty
        if offset is None or uncertainty is None:
            return Cause.CLOCK_UNKNOWN if self.max_age else None
        age = (self._context.stamps.now() - stamp) / 1e9 + offset
        if self.max_age:
            # From the future: the measured offset of the clocks is wrong, and the message may have any age.
            if age < -uncertainty - _AHEAD:
                return Cause.CLOCK_UNKNOWN
            if age + uncertainty > self.max_age:
                # The remedies differ: an uncertain clock needs a moment, a slow link a lower rate.
                doubtful = age <= self.max_age and uncertainty > self.max_age / 2
                return Cause.CLOCK_UNKNOWN if doubtful else Cause.LINK_SLOW
        # The uncertainty is half of the shortest round trip, which no network that fills up later makes longer.
        if self._latest and age - min(uncertainty, SLOWEST) > self._latest:
            return Cause.LINK_SLOW
        return Cause.LINK_SLOW if self._lifespan and age - uncertainty > self._lifespan else None

    # --- what is made of it

    def expired(self, cause: Cause, messages: int) -> None:
        """Count messages that were dropped because they were too old, or might be."""
        self._counts[cause] += messages

    @property
    def total(self) -> int:
        return self._counts.total()

    def update(self, messages: int, now: float) -> None:
        """Update the figures, once a second, at `now` (s).

        Args:
            messages: number of messages that came to this half so far.
        """
        if not self.is_on and not self._lately:
            return
        self._lately.append((messages, self._counts.copy()))
        # If it is switched off while the topic is late, the counts go on until the lateness has ended.
        if not self.is_on and self._since is None:
            self._lately.clear()
        lost, of, _ = self._recent()
        if lost <= LOSSY_ABOVE * of:
            self._since = None
        elif self._since is None:
            self._since = now

    @property
    def is_calm(self) -> bool:
        """Whether none came or was dropped in the last seconds, which are counted in ticks."""
        return self._since is None and (not self._lately or self._lately[0] == self._lately[-1])

    def _recent(self) -> tuple[int, int, Counter[Cause]]:
        if not self._lately:
            return 0, 0, Counter()
        messages, counts = self._lately[-1]
        before, counts_before = self._lately[0]
        lost = counts - counts_before
        # A message that waited may have come before these seconds: the share must not exceed 100 %.
        return lost.total(), max(messages - before, lost.total()), lost

    def late(self) -> Expired | None:
        """Return the drops of the last seconds, or None if there were few."""
        if self._since is None:
            return None
        lost, of, by_cause = self._recent()
        ((cause, _),) = by_cause.most_common(1)
        return Expired(cause, lost, of, self._limit, self._since)


def expired_verdict(expired: Expired) -> Verdict:
    """Return the verdict on a topic of whose messages many are too old."""
    percent = round(100 * expired.lost / expired.of)
    text = f"{percent} % dropped, age limit {expired.limit:g} s: {_REMEDIES[expired.cause]}"
    return Verdict(State.LATE, expired.cause, text, expired.since)

"""The highest rate of a topic's messages, its origin, and the text of an event about changed limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import ROUTES_PER_LINK
from rsb_bridge.model.session import priority_of
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.topic_keys import TOPIC_KEYS

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.topic_keys import TopicKey
    from rsb_bridge.wire.messages import Propose

_AT_ONCE = 1.0
"""s of the rate that may come at once, after a link has stalled."""
_FEWEST_AT_ONCE = 2.0  # a bucket that holds less than one message never gives any
_TOPICS = 2 * ROUTES_PER_LINK
"""That have lately had messages, of routes that are there or were."""
_CLOCKS_DIFFER = 1.01
"""The sender keeps to the rate by its own clock, which may be faster: none of its messages is left out for that."""


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

    Attributes:
        rate: Hz, or 0 if all messages cross.
        here: Hz that this side allows, or 0 for any.
        switched: called whenever one of them may have changed.
    """

    def __init__(self, max_rate: float, log: Callable[[Level, EventCode, str], None]) -> None:
        self.switched: Callable[[], None] = lambda: None
        self.rate = self._max_rate = max_rate
        self.here = 0.0
        self._there = self._there_before = self._profile = 0.0
        self._log = log

    @property
    def allowed(self) -> float:
        """The lower one of the rates (Hz) that the two sides' rights allow, or 0 for any."""
        return _lowest(self.here, self._there)

    @property
    def why(self) -> str:
        """The origin of the limit, for an operator."""
        if self.rate == self._max_rate:
            return "set on purpose (max_rate)"
        if self.rate == self._profile:
            return "the session's profile (max_rate overrides it)"
        return "this side allows no more (allow)" if self.rate == self.here else "the other side allows no more"

    def lowered(self, rate: float | None) -> float | None:
        """Return a rate (Hz) that is usual without the limit, or None if it is unknown, as it is with the limit."""
        return min(rate, self.rate) if rate and self.rate else rate

    def opened(self) -> None:
        """Begin a new opening: the other side will send its limit again."""
        self._there = 0.0
        self._changed()

    def set_max_rate(self, rate: float) -> None:
        """Take the limit of the topic's entry."""
        if rate != self._max_rate:
            self._max_rate = rate
            self._changed()

    def set_profile_rate(self, rate: float) -> None:
        """Take the limit of the link's profile, or 0 for none."""
        if rate != self._profile:
            self._profile = rate
            self._changed()

    def allow_here(self, rate: float) -> bool:
        """Take the rate that this side's rights allow; return whether it is another one than before."""
        if rate == self.here:
            return False
        self.here = rate
        self._changed()
        self._log(Level.INFO, EventCode.ROUTE_AMENDED, f"this side allows {_figure(rate)} (allow)")
        return True

    def allow_there(self, rate: float) -> None:
        """Take the rate that the other side allows."""
        self._there = rate
        self._changed()
        # Kept over openings, so that the same limit is logged once.
        if rate != self._there_before:
            self._there_before = rate
            self._log(Level.INFO, EventCode.ROUTE_AMENDED, f"the other side allows {_figure(rate)}")

    def _changed(self) -> None:
        self.rate = _lowest(self._max_rate, self.allowed, self._profile)
        self.switched()


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
        if key.live and key.value == "number" and (before := getattr(old, name)) != (after := getattr(new, name))
    ]
    before, after = priority_of(old.priority), priority_of(new.priority)
    return ", ".join(changed + ([f"priority {before} → {after}"] if before != after else []))


def _limit_text(value: float | None, key: TopicKey) -> str:
    return "none" if value is None or not (value or key.zero) else f"{value:g} {key.unit}"

"""The phases of a route's half as a table of events, when it opens again, and whether operators have paused it.

In the last phase messages flow as the channel, the link and the ROS graph allow. Those come and go without an agreement
of the two sides.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import TYPE_CHECKING

from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.reason import NO_REASON, Reason

if TYPE_CHECKING:
    from collections.abc import Callable


class RoutePhase(Enum):
    """Progress of the agreement between the two sides, in this order; `CLOSED` lies outside it."""

    CLOSED = auto()
    """Not open on the present connection; the side that proposed it tries again later."""
    PROPOSED = auto()
    """One side has proposed it; the other has not answered yet."""
    ACCEPTED = auto()
    """Both sides want it; the sender finds out type and QoS."""
    DESCRIBED = auto()
    """The sender has described its messages; the receiver creates a publisher for them."""
    READY = auto()
    """The receiver has the publisher: messages may be sent."""


class RouteEvent(Enum):
    """Event in the life of a route."""

    OPEN = auto()
    """It is proposed, by either side."""
    ACCEPT = auto()
    """The other side accepts it, or this side accepts the other's proposal."""
    DESCRIBE = auto()
    """The sender describes its messages; again whenever the description changes."""
    READY = auto()
    """The receiver has created the publisher; it answers each description."""
    REFUSE = auto()
    """Either side refuses it for a reason."""
    CLOSE = auto()
    """The opening ends for no fault of the route's: the link is lost, or the route is opened again."""


_END = {RouteEvent.REFUSE: RoutePhase.CLOSED, RouteEvent.CLOSE: RoutePhase.CLOSED}

TRANSITIONS: dict[RoutePhase, dict[RouteEvent, RoutePhase]] = {
    RoutePhase.CLOSED: {RouteEvent.OPEN: RoutePhase.PROPOSED, **_END},
    RoutePhase.PROPOSED: {RouteEvent.ACCEPT: RoutePhase.ACCEPTED, **_END},
    RoutePhase.ACCEPTED: {RouteEvent.DESCRIBE: RoutePhase.DESCRIBED, **_END},
    RoutePhase.DESCRIBED: {RouteEvent.DESCRIBE: RoutePhase.DESCRIBED, RouteEvent.READY: RoutePhase.READY, **_END},
    RoutePhase.READY: {RouteEvent.DESCRIBE: RoutePhase.DESCRIBED, RouteEvent.READY: RoutePhase.READY, **_END},
}


class Lifecycle:
    """The phase of one route's half.

    Attributes:
        accepted: whether both sides want the route; with each message, it is asked once more.
        described: whether the sender has described its messages in this opening.
        refusal: reason of the last refusal or end, empty if it opened again since.
    """

    def __init__(self) -> None:
        self.phase = RoutePhase.CLOSED
        self.accepted = self.described = False
        self.refusal = NO_REASON

    def handle(self, event: RouteEvent, reason: Reason = NO_REASON) -> bool:
        """Move to the next phase.

        Returns:
            Whether the event belongs into this phase; if not, nothing changes. A peer can send its messages in any
            order, so this is no error.
        """
        new = TRANSITIONS[self.phase].get(event)
        if new is None:
            return False
        self.phase = new
        self.described = new is RoutePhase.DESCRIBED or new is RoutePhase.READY
        self.accepted = self.described or new is RoutePhase.ACCEPTED
        if event is RouteEvent.REFUSE:
            self.refusal = reason
        elif event is RouteEvent.OPEN:
            self.refusal = NO_REASON
        return True


_FIRST_PAUSE, _LONGEST_PAUSE = 1.0, 10.0
"""Seconds between attempts to open a refused route. Round figures: nothing was measured. An operator who has mended the
cause waits for the next attempt; shorter pauses would cost a link with many refused routes two messages for each."""
_PROPOSED_WITHIN = 3.0
"""Seconds in which the other side proposes its routes on a new connection. A round figure: nothing was measured."""
_REFUSED_WITHIN = 5.0
"""Seconds after which a retried route is unlikely to be refused again. A round figure: nothing was measured."""
_REOPENS_WITHIN = 10.0
"""Seconds after which a data connection that broke and is not open again is a fault. The kernel gives one up after 6 s,
and the pauses before the next attempts are 1 and 2 s."""


class Reopening:
    """The attempts to open one route again.

    Attributes:
        refused: the last refusal, empty once a later opening has succeeded.
        retry_at: time (s) of the next attempt of the side that proposed it.
        closed_at: time (s) when its last opening ended, or 0 before that.
        has_failed: whether an attempt has failed since messages flowed.
    """

    def __init__(self) -> None:
        self.refused = NO_REASON
        self.retry_at = self.closed_at = 0.0
        self.has_failed = False
        self._broke_at: float | None = None  # the data connection, if it has not been open since
        self._backoff = Backoff(_FIRST_PAUSE, _LONGEST_PAUSE)

    def failed(self, now: float, *, broke: bool) -> None:
        """Plan the next attempt after an opening failed at `now` (s), perhaps because its data connection broke."""
        self.has_failed = True
        # Further attempts that time out do not restart the wait: they belong to the same fault.
        if broke and self._broke_at is None:
            self._broke_at = now
        self.retry_at = now + self._backoff.next()

    def observe(self, *, connected: bool, flowing: bool) -> None:
        """Begin again with the shortest pause once messages flow: acceptance is not enough, as a refusal may follow."""
        if connected:
            self._broke_at = None
        if flowing:
            self._backoff.reset()
            self.has_failed = not connected

    def reopens(self, now: float) -> bool:
        """Whether its data connection broke so lately that the next one is due at `now` (s) at the earliest."""
        return self._broke_at is not None and now - self._broke_at < _REOPENS_WITHIN

    def shown_refusal(self, life: Lifecycle, open_for: float) -> Reason:
        """Return the refusal to show to operators: the last one, until a retry succeeds.

        Args:
            open_for: seconds for which the route has been open, or 0 if it is closed.
        """
        if life.phase is RoutePhase.READY or open_for >= _REFUSED_WITHIN:
            self.refused = NO_REASON
        return life.refusal or self.refused

    def awaited_until(self, linked_at: float) -> float:
        """Return the time (s) by which the other side will have proposed the route again if it still wants it."""
        if self.closed_at > linked_at:
            return self.closed_at + _LONGEST_PAUSE + _PROPOSED_WITHIN
        return linked_at + _PROPOSED_WITHIN


_LAST = 2**53
"""The largest number in a control message (`wire.records.Count`): an absurd one of the peer's must not end the link."""


class Revisions:
    """Numbers the changes that one side of a link makes, each above all that it has seen (a Lamport clock)."""

    def __init__(self) -> None:
        self._highest = 0

    def next(self) -> int:
        """Return the number of a new change."""
        self._highest = min(self._highest + 1, _LAST)
        return self._highest

    def saw(self, revision: int) -> None:
        """Note a number from the peer."""
        self._highest = max(self._highest, revision)


class PauseState:
    """The pause state on one side; both sides may change it, and both end up with the same state.

    Each change has a revision above all that its side has seen. A side takes the peer's state if its revision is higher
    than its own. If the operators of both sides act at once, the revisions may be equal; then the client's state
    counts. So both sides end up with the same change, in any order of arrival.

    Attributes:
        unpaused: revision of the last end of a pause in the present opening, or 0.
        who: operator of the last change, in words, or an empty string if unknown.
        changed: called after each change with `paused` as it was before, which may be the same.
    """

    def __init__(self, revisions: Revisions, *, paused: bool, is_client: bool) -> None:
        self.paused = paused
        self.revision = revisions.next()
        self.unpaused = 0
        self.who = ""
        self.changed: Callable[[bool], None] = lambda was: None
        self._revisions = revisions
        self._is_client = is_client

    def change(self, *, paused: bool, who: str = "") -> None:
        """Change the state for an operator of this side; the caller must send it to the peer."""
        was, self.paused, self.who = self.paused, paused, who
        self.revision = self._revisions.next()
        self.changed(was)

    def adopt(self, *, paused: bool, revision: int, who: str = "") -> None:
        """Take the peer's state, even if this side's is later."""
        was = self.paused
        self._revisions.saw(revision)
        if (paused, revision) != (self.paused, self.revision):  # otherwise `who` stays, too
            self.paused, self.revision, self.who = paused, revision, who
        self.changed(was)

    def merge(self, *, paused: bool, revision: int, who: str = "") -> None:
        """Take the peer's state if it is the later one."""
        if revision > self.revision or (revision == self.revision and not self._is_client):
            self.adopt(paused=paused, revision=revision, who=who)


PAUSE_WORDS = "not paused", "paused"
"""The states as values of operators' actions."""

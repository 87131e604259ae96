"""The phases of a route's half as a table of events, and whether operators have paused it.

Whether messages flow beyond the last phase is up to the channel, the link and the ROS graph, which come and go without
either side having to agree on anything.
"""

from __future__ import annotations

from enum import Enum, auto


class Phase(Enum):
    """What the two sides have agreed on so far, in this order; `REFUSED` and `CLOSED` are not on the way."""

    CLOSED = auto()
    """Not open on the present connection."""
    REFUSED = auto()
    """Not open, for a reason that is known; the side that proposed it tries again later."""
    PROPOSED = auto()
    """One side has proposed it; the other has not answered yet."""
    ACCEPTED = auto()
    """Both sides want it; the sender finds out type and QoS."""
    DESCRIBED = auto()
    """The sender has said what it sends; the receiver makes a publisher of it."""
    READY = auto()
    """The receiver has the publisher: messages may be sent."""


class Event(Enum):
    """What happens to a route."""

    OPEN = auto()
    """It is proposed, by either side."""
    ACCEPT = auto()
    """The other side accepts it, or this side accepts the other's proposal."""
    DESCRIBE = auto()
    """The sender says what it sends; again whenever that changes."""
    READY = auto()
    """The receiver has a publisher for what was described; it answers each description."""
    REFUSE = auto()
    """Either side says why it cannot be."""
    CLOSE = auto()
    """The incarnation ends for no fault of the route's: the link is lost, or it is opened again."""


_END = {Event.REFUSE: Phase.REFUSED, Event.CLOSE: Phase.CLOSED}

TRANSITIONS: dict[Phase, dict[Event, Phase]] = {
    Phase.CLOSED: {Event.OPEN: Phase.PROPOSED, **_END},
    Phase.REFUSED: {Event.OPEN: Phase.PROPOSED, Event.REFUSE: Phase.REFUSED, Event.CLOSE: Phase.REFUSED},
    Phase.PROPOSED: {Event.ACCEPT: Phase.ACCEPTED, **_END},
    Phase.ACCEPTED: {Event.DESCRIBE: Phase.DESCRIBED, **_END},
    Phase.DESCRIBED: {Event.DESCRIBE: Phase.DESCRIBED, Event.READY: Phase.READY, **_END},
    Phase.READY: {Event.DESCRIBE: Phase.DESCRIBED, Event.READY: Phase.READY, **_END},
}


class Lifecycle:
    """The phase of one route's half.

    Attributes:
        phase: the present one.
        refusal: why it was refused last, for an operator; empty: it was not, or is open again.
    """

    def __init__(self) -> None:
        self.phase = Phase.CLOSED
        self.refusal = ""

    def take(self, event: Event, reason: str = "") -> bool:
        """Go on to the next phase.

        Args:
            event: what happened.
            reason: with `Event.REFUSE`, why.

        Returns:
            Whether the event belongs into this phase; if not, nothing changes. A peer can send its messages in any
            order, so this is no error.
        """
        new = TRANSITIONS[self.phase].get(event)
        if new is None:
            return False
        self.phase = new
        if event is Event.REFUSE:
            self.refusal = reason
        elif event is Event.OPEN:
            self.refusal = ""
        return True

    @property
    def accepted(self) -> bool:
        """Whether both sides want the route."""
        return self.phase in (Phase.ACCEPTED, Phase.DESCRIBED, Phase.READY)

    @property
    def described(self) -> bool:
        """Whether the sender has said what it sends."""
        return self.phase in (Phase.DESCRIBED, Phase.READY)

    @property
    def ready(self) -> bool:
        """Whether messages may be sent, as far as the two sides have to agree."""
        return self.phase is Phase.READY


_LAST = 2**53


class Revisions:
    """Numbers the changes that one side of a link makes, each above all that it has seen (a Lamport clock)."""

    def __init__(self) -> None:
        self._highest = 0

    def next(self) -> int:
        """The number of a new change."""
        self._highest = min(self._highest + 1, _LAST)
        return self._highest

    def saw(self, revision: int) -> None:
        """Take note of a number that the peer gave."""
        self._highest = max(self._highest, revision)


class PauseState:
    """One side's half of a state that both sides change, and that ends up the same on both.

    Each change has a revision above all that its side has seen. A side takes the peer's state if its revision is higher
    than its own. Where the operators of both sides acted at once, the revisions may be equal; then the client's state
    counts. So both sides end up with the same one of all changes, whatever the order in which they hear of them.

    Attributes:
        paused: the state.
        revision: of the change that led to it.
        who: made that change, in words; empty: it is not known.
    """

    def __init__(self, revisions: Revisions, *, paused: bool, is_client: bool) -> None:
        self.paused = paused
        self.revision = revisions.next()
        self.who = ""
        self._revisions = revisions
        self._is_client = is_client

    def change(self, *, paused: bool, who: str = "") -> None:
        """An operator of this side changes the state; the peer has to be told."""
        self.paused, self.who = paused, who
        self.revision = self._revisions.next()

    def adopt(self, *, paused: bool, revision: int, who: str = "") -> None:
        """Take the peer's state, whatever this side's is."""
        self._revisions.saw(revision)
        if (paused, revision) != (self.paused, self.revision):  # else it only tells what is known here
            self.paused, self.revision, self.who = paused, revision, who

    def merge(self, *, paused: bool, revision: int, who: str = "") -> None:
        """The peer tells its state: take it if it is the later one."""
        if revision > self.revision or (revision == self.revision and not self._is_client):
            self.adopt(paused=paused, revision=revision, who=who)


def pause_word(*, paused: bool) -> str:
    """The state as the value of an operator's action."""
    return "paused" if paused else "not paused"

"""Whether a route is paused, when operators on both sides may say so at the same moment."""

from __future__ import annotations

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

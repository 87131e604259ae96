"""Whether a link is up, since when, and why it is not."""

from __future__ import annotations

from dataclasses import dataclass

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import LinkCause

_NOT_YET = "not connected yet"


@dataclass(slots=True)
class LinkStatus:
    """Whether a link is up, since when, and why not.

    Attributes:
        since: s since the epoch, when it came up or went down.
        cause: why it is down.
        reason: likewise, for an operator.
        attempts: to connect that failed, since it was last up.
        retry_at: s, when the next one is due; None: none is planned.
    """

    since: float
    cause: LinkCause = LinkCause.NOT_YET
    reason: str = _NOT_YET
    attempts: int = 0
    retry_at: float | None = None

    def up(self, wall: float) -> None:
        """It is up, at `wall` (s since the epoch)."""
        self.since, self.cause = wall, LinkCause.NONE
        self.attempts, self.retry_at = 0, None

    def down(self, cause: LinkCause, reason: str) -> None:
        """It is down for this reason now."""
        self.cause, self.reason = cause, reason

    def retry_in(self, now: float) -> float | None:
        """S until the next attempt, at `now` (s)."""
        return None if self.retry_at is None else max(0.0, self.retry_at - now)

    @property
    def state(self) -> State:
        """WAITING until the first attempt has ended, then OK or DOWN."""
        if self.cause is LinkCause.NONE:
            return State.OK
        return State.WAITING if self.cause is LinkCause.NOT_YET else State.DOWN

"""Whether a link is up, and what is wrong with it: one cause, in words for an operator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.link.connecting import unproven_servers
from rsb_bridge.link.extension import Extension
from rsb_bridge.link.refused_clients import DuplicateClients
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import LinkCause, clocks_differ

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.link.fullness import LinkFullness
    from rsb_bridge.link.path_watch import PathWatch
    from rsb_bridge.telemetry.meters import ClockOffset

_NOT_YET = "not connected yet"


@dataclass(slots=True)
class LinkStatus:
    """Whether a link is up, since when, and why not.

    Attributes:
        since: since when it is up or down, in s of the steady clock.
        cause: cause of its being down, or `LinkCause.NONE`.
        reason: the same in words, for an operator.
        attempts: failed attempts to connect since it was last up.
        retry_at: time of the next attempt in s, or None if none is planned.
    """

    since: float
    cause: LinkCause = LinkCause.NOT_YET
    reason: str = _NOT_YET
    attempts: int = 0
    retry_at: float | None = None
    _lasting: tuple[LinkCause, str] | None = None
    """Cause and reason that another one hides for now."""

    def up(self, since: float) -> None:
        """Record that the link is up, in s of the steady clock."""
        self.since, self.cause, self._lasting = since, LinkCause.NONE, None
        self.attempts, self.retry_at = 0, None

    def down(self, cause: LinkCause, reason: str) -> None:
        """Record why the link is down."""
        self.cause, self.reason, self._lasting = cause, reason, None

    def down_for_now(self, cause: LinkCause, reason: str) -> None:
        """Record a reason that says less about the link than the one before, which `recall` shows again."""
        lasting = self._lasting or (self.cause, self.reason)
        self.down(cause, reason)
        self._lasting = lasting

    def recall(self) -> None:
        """Show the lasting reason again."""
        if self._lasting is not None:
            self.down(*self._lasting)

    def retry_in(self, now: float) -> float | None:
        """Return the seconds from `now` to the next attempt, or None if none is planned."""
        return None if self.retry_at is None else max(0.0, self.retry_at - now)

    @property
    def state(self) -> State:
        """WAITING until the first attempt has ended, then OK or DOWN."""
        if self.cause is LinkCause.NONE:
            return State.OK
        return State.WAITING if self.cause is LinkCause.NOT_YET else State.DOWN


class LinkFault(Extension):
    """The fault of one link, up or down.

    Attributes:
        duplicates: refused clients that have the link's name, too.
        unproven: number of servers that were announced when the link was made, and did not prove the key.
    """

    def __init__(
        self,
        context: Context,
        name: str,
        peer_name: str,
        status: LinkStatus,
        path: PathWatch,
        fullness: LinkFullness,
        clock: Callable[[], ClockOffset],
    ) -> None:
        self.duplicates = DuplicateClients(name)
        self.unproven = 0
        self._context = context
        self._peer_name = peer_name
        self._status, self._path, self._fullness, self._clock = status, path, fullness, clock
        self._warned: tuple[LinkCause, float] = (LinkCause.NONE, 0.0)

    def disconnected(self) -> None:
        self.duplicates = DuplicateClients(self.duplicates.name)  # without a link, nobody has the name
        self._warned = LinkCause.NONE, 0.0  # a link that is up again before the next tick is another one

    def tick(self) -> None:
        self.warning_since()  # a warning begins now, even if no console asks for a snapshot

    def _found(self) -> list[tuple[LinkCause, str]]:
        """Return what is wrong with a link that is up, in words for an operator, the worst first."""
        if self._status.cause is not LinkCause.NONE:
            return []
        path, clock = self._path.fault, self._clock()
        found = (
            # Before a second machine of the name, which operators acknowledge for weeks: topics suffer from the path.
            (path.cause, path.text) if path else (LinkCause.NONE, ""),
            (LinkCause.NAME_TAKEN, self.duplicates.warning(self._context.now(), self._context.wall())),
            # A path that loses packets carries less, too: its loss explains that.
            (LinkCause.FULL, "" if path else self._fullness.warning(self._peer_name)),
            (LinkCause.UNPROVEN_SERVERS, unproven_servers(self.unproven) if self.unproven else ""),
            (LinkCause.CLOCKS_DIFFER, clocks_differ(self._peer_name, clock.offset, clock.uncertainty)),
        )
        return [each for each in found if each[1]]

    @property
    def warning(self) -> str:
        """The fault of a link that is up, for an operator, or an empty string."""
        return "; ".join(text for _, text in self._found())

    @property
    def cause(self) -> LinkCause:
        """The cause of the link's fault, up or down."""
        return next((cause for cause, _ in self._found()), self._status.cause)

    def warning_since(self) -> float | None:
        """Return when the present warning began, in s since the epoch, or None without one. Called once a second."""
        cause = next((cause for cause, _ in self._found()), LinkCause.NONE)
        if cause != self._warned[0]:
            self._warned = cause, self._context.clock.steady()
        return self._context.wall_of(self._warned[1]) if cause else None

"""Connections whose peer has not proven a key yet, limited in number, in time and in what they cost.

A server uses it for the streams of its clients, an engine for the consoles of its operators.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from enum import IntEnum, auto
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rsb_bridge.link.refused_clients import Refusals, network
from rsb_bridge.model.budgets import CONNECTION
from rsb_bridge.model.wording import Wording
from rsb_bridge.transport import descriptors

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.link.refused_clients import Recording
    from rsb_bridge.model.budgets import Strangers
    from rsb_bridge.model.codes import EventCode

_HANDSHAKE_WITHIN = 10.0
"""s, as long as a client waits for an answer (`client_link`). On a path with 2 s each way, a handshake takes 4 s, or 8
if the server asks for another cipher suite."""


class Rejected(Wording):
    """Reasons why a connection is closed before it has authenticated."""

    TOO_MANY = "too many unauthenticated connections"
    NO_HANDSHAKE = "no handshake within {seconds:g} s"
    SENT_NOTHING = (
        "it sent nothing for {seconds:g} s: probably a port scan or a health check, as a bridge sends its name"
    )


class ConnectionStage(IntEnum):
    """The progress of a connection. If there are too many, the lowest stage is rejected first."""

    REFUSED = auto()  # the peer does not know yet
    WAITING = auto()  # silent, or in the middle of its first message: half of one proves nothing and costs nothing
    ACCEPTED = auto()  # its first message opens under the key
    OVER = auto()  # it has authenticated or is closed


class Limits(NamedTuple):
    """The number of connections that may wait.

    Attributes:
        of_one_host: of one host, where a host cannot choose its address.
        accepted: in stage `ConnectionStage.ACCEPTED` under one name; more only come if somebody plays first messages
            again.
        when_scarce: in all while file descriptors are scarce, or None for `total`.
    """

    total: int
    of_one_host: int
    accepted: int
    when_scarce: int | None = None


class PendingConnections:
    """All connections that have not authenticated yet."""

    def __init__(self, recording: Recording, strangers: Strangers, limits: Limits) -> None:
        self.refusals = Refusals(recording)
        self.strangers = strangers
        self._limits = limits
        self._present: dict[PendingConnection, None] = {}  # the longest waiting first

    @property
    def present(self) -> tuple[PendingConnection, ...]:
        """The connections, the longest waiting first."""
        return tuple(self._present)

    def add(self, pending: PendingConnection) -> bool:
        """Count a new connection. If there are too many, reject the one of the lowest stage that has waited longest.

        A host that has too many loses one of its own, so that idle connections cannot keep others out.

        Returns:
            False if the strangers' budget is spent and none of it by connections that wait here.
        """
        of_host = [each for each in self._present if each.network == pending.network]
        if self._full(len(of_host), self._limits.of_one_host, pending.host):
            self._reject_lowest(of_host, Rejected.TOO_MANY())
        elif self._full(len(self._present), self._limits.total) or self._uses_reserve():
            self._reject_lowest(self._present, Rejected.TOO_MANY())
        while not self.strangers.take(CONNECTION):
            if not self._present:
                return False
            self._reject_lowest(self._present, Rejected.TOO_MANY())
        self._present[pending] = None
        return True

    def _full(self, count: int, limit: int, host: str = "") -> bool:
        # The first condition only spares the second one, which looks at all open routes.
        return count >= limit and count >= limit + self._expected(host)

    def _expected(self, host: str) -> int:
        """Return how many are expected from a host, or in all if it is empty; they are allowed on top of the limits."""
        return 0

    def _uses_reserve(self) -> bool:
        """Whether idle connections would take file descriptors from the others."""
        limit = self._limits.when_scarce
        return limit is not None and len(self._present) >= limit and descriptors.scarce()  # last, as it opens a socket

    def _reject_lowest(self, among: Iterable[PendingConnection], message: str) -> None:
        min(among, key=lambda each: each.stage).reject(message)

    def accepted(self, pending: PendingConnection) -> None:
        """Reject older connections of a name if too many of its first messages open under its key."""
        same = [each for each in self._present if each.name == pending.name and each.stage is ConnectionStage.ACCEPTED]
        for oldest in same[: -self._limits.accepted]:
            oldest.reject("replaced by newer connections under the same name")

    def remove(self, pending: PendingConnection) -> None:
        """Remove a connection that has authenticated or is gone."""
        self._present.pop(pending, None)

    def close(self) -> None:
        """Reject all."""
        for pending in self.present:
            pending.reject("the bridge stops")


class PendingConnection(ABC):
    """One connection until its peer has authenticated, or it is gone.

    Attributes:
        network: counts as one host with others (`rsb_bridge.link.refused_clients.network`).
        name: given by the peer, and not authenticated.
    """

    rejected_code: ClassVar[EventCode]

    def __init__(self, pending: PendingConnections) -> None:
        self.stage = ConnectionStage.WAITING
        self.host = self.network = self.name = ""
        self._pending = pending
        self._deadline: asyncio.TimerHandle | None = None
        self._refusal: tuple[bytes, str] = (b"", "")
        self._counted = False

    def _arrive(self, host: str) -> bool:
        """Begin to wait for the handshake; return False if there is no room."""
        self.host, self.network = host, network(host)
        self._counted = self._pending.add(self)
        if self._counted:
            self._deadline = asyncio.get_running_loop().call_later(_HANDSHAKE_WITHIN, self._give_up)
        return self._counted

    def _give_up(self) -> None:
        """Reject a peer whose handshake takes too long."""
        why, cause = self._why_overdue()
        self.reject(why(seconds=_HANDSHAKE_WITHIN), cause)

    def _why_overdue(self) -> tuple[Rejected, str]:
        """Return the reason why the handshake is overdue, and the event's cause."""
        return Rejected.NO_HANDSHAKE, ""

    def _accept(self) -> None:
        """Note that the peer's first message opens under its key."""
        self.stage = ConnectionStage.ACCEPTED
        self._pending.accepted(self)

    def reject(self, message: str, cause: str = "") -> None:
        """Refuse the connection and close it, unless it is over."""
        if self.stage is ConnectionStage.OVER:
            return
        if self.stage is not ConnectionStage.REFUSED:  # else it is logged, and has an answer of its own that waits
            self._log(self.rejected_code, message, cause)
            self._refusal = self._busy(message), message
        self._tell()

    def _refuse(self, code: EventCode, message: str, answer: bytes, cause: str = "") -> None:
        """Refuse a peer that failed to authenticate: later if many at its host have failed."""
        refusals = self._pending.refusals
        refusals.failed(self.host)
        self._log(code, message, cause, self.name)
        self._stop_waiting()
        self.stage, self._refusal = ConnectionStage.REFUSED, (answer, message)
        if delay := refusals.delay(self.host):
            self._deadline = asyncio.get_running_loop().call_later(delay, self._tell)
            self._pause_reading()  # nothing that still comes is of use
        else:
            self._tell()

    def _tell(self) -> None:
        """Send the refusal, and close."""
        self._leave()
        self._close_with(*self._refusal)

    def _leave(self) -> None:
        """Be pending no more: the peer has authenticated, or the connection is being closed."""
        self.stage = ConnectionStage.OVER
        self._pending.remove(self)
        self._stop_waiting()
        if self._counted:  # else there was no room for it, or it has left before
            self._counted = False
            self._pending.strangers.give(CONNECTION)

    def _stop_waiting(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    @abstractmethod
    def _log(self, code: EventCode, message: str, cause: str = "", name: str = "") -> None:
        """Record a refusal."""

    @abstractmethod
    def _busy(self, message: str) -> bytes:
        """Return the bytes that refuse a peer which has done nothing wrong."""

    @abstractmethod
    def _close_with(self, answer: bytes, message: str) -> None:
        """Write the answer, then close for the reason given."""

    @abstractmethod
    def _pause_reading(self) -> None:
        """Read nothing more."""

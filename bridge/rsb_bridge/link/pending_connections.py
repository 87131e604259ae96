"""Connections whose peer has not proven a key yet, limited in number, in time and in what they cost.

A server uses it for the streams of its clients, an engine for the consoles of its operators.
"""

from __future__ import annotations

import asyncio
import ipaddress
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from enum import IntEnum, auto
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol

from rsb_bridge.model.budgets import CONNECTION, TokenBucket
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.wording import Wording
from rsb_bridge.transport import descriptors

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.model.budgets import Strangers
    from rsb_bridge.model.codes import EventCode
    from rsb_bridge.telemetry.event_log import EventLog

_HANDSHAKE_WITHIN = 10.0
"""s, as long as a client waits for an answer (`client_end`). On a path with 2 s each way, a handshake takes 4 s, or 8
if the server asks for another cipher suite."""
_FAILURES = 5
_FAILURES_WITHIN = 30.0
_DELAY = 1.0
"""s that a host waits for a refusal after so many failures within so many s: guesses cost time. Round figures: nothing
was measured; ten times more, and a client would give up before it hears why it is refused."""
_HOSTS_REMEMBERED = 1024  # a round figure: beyond it the first ones are forgotten, and refused at once
_LOGGED_AFTER, _LOGGED_AFTER_AT_LAST = 60.0, 3600.0
"""s until the same refusal of the same host is logged again; twice as long each time."""
_LINE_FORGOTTEN_AFTER = 60.0  # s without another one; a client that is refused tries again within 12 s
_OF_ONE_HOST = 8  # different refusals that are logged one by one: a stranger chooses their words, such as its name
_MANY = "many different reasons: further refusals of its host are not logged one by one"
_LINES, _LINES_A_SECOND = 256, 0.5  # lines about all hosts. Round figures


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
    """The number of connections that may wait."""

    total: int
    of_one_host: int  # where a host cannot choose its address
    accepted: int
    """In stage `ConnectionStage.ACCEPTED` under one name; more only come if somebody plays first messages again."""
    when_scarce: int | None = None  # in all while file descriptors are scarce, or None for `total`


@dataclass(slots=True)
class _Logged:
    """A refusal that is in the log already."""

    tried_at: float  # when it last happened
    due: float  # when it may be logged again
    wait: float = _LOGGED_AFTER


class Recording(Protocol):
    """Clock and event log for refusals."""

    @property
    def events(self) -> EventLog: ...

    def now(self) -> float: ...


class Refusals:
    """Refusals by host. The addresses of an IPv6 /64, which one machine can have, count as one host."""

    def __init__(self, context: Recording) -> None:
        self._context = context
        self._failures: dict[str, deque[float]] = {}
        self._logged: dict[tuple[str, str], _Logged] = {}
        self._lines = TokenBucket(_LINES, _LINES_A_SECOND, context.now())

    def failed(self, host: str) -> None:
        """Count a failed authentication of a host."""
        self._failures.setdefault(network(host), deque(maxlen=_FAILURES)).append(self._context.now())
        if len(self._failures) > _HOSTS_REMEMBERED:
            self._failures.pop(next(iter(self._failures)))

    def delay(self, host: str) -> float:
        """Return the seconds until a host receives its refusal: failures cost time, but lock nobody out."""
        return _DELAY if len(self._failures.get(network(host), ())) >= _FAILURES else 0.0

    def log(self, host: str, who: str, code: EventCode, message: str, link: str = "", cause: str = "") -> None:
        """Log a rejection: repetitions for a host ever more rarely, and few different messages of one host.

        The quota of the link stays as it is: anybody can use its name.
        """
        host = network(host)
        is_one_of_many = (host, "") in self._logged or (
            (host, message) not in self._logged and sum(one == host for one, _ in self._logged) >= _OF_ONE_HOST
        )
        if self.is_new(host, "" if is_one_of_many else message):
            text = f"rejected {who}: {_MANY if is_one_of_many else message}"
            self._context.events.add(Level.WARNING, code, text, link=link, cause=cause)

    def is_new(self, host: str, message: str) -> bool:
        """Whether to log a message about a host, or about none, now."""
        now, logged = self._context.now(), self._logged.get((host, message))
        if logged is None:
            if len(self._logged) >= _LINES or not self._lines.take(1, now):
                return False
            self._logged[host, message] = _Logged(now, now + _LOGGED_AFTER)
            return True
        logged.tried_at = now
        if now < logged.due:
            return False
        logged.wait = min(2 * logged.wait, _LOGGED_AFTER_AT_LAST)
        logged.due = now + logged.wait
        return True

    def tick(self) -> None:
        """Forget old failures and log entries."""
        now = self._context.now()
        for host, times in tuple(self._failures.items()):
            while times and now - times[0] > _FAILURES_WITHIN:
                times.popleft()
            if not times:
                del self._failures[host]
        self._logged = {key: each for key, each in self._logged.items() if now - each.tried_at < _LINE_FORGOTTEN_AFTER}


def network(host: str) -> str:
    """Return the network that counts as one host: the /64 of an IPv6 address, and any other address itself."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    # Neighbours share the link-local /64, and all of IPv4 that of the mapped addresses.
    if address.version == 4 or address.ipv4_mapped or address.is_link_local:
        return host
    return str(ipaddress.IPv6Network((int(address), 64), strict=False))


class PendingConnections:
    """All connections that have not authenticated yet."""

    def __init__(self, recording: Recording, strangers: Strangers, limits: Limits) -> None:
        self.refusals = Refusals(recording)
        self.strangers = strangers
        self.limits = limits
        self._present: dict[PendingConnection, None] = {}  # the longest waiting first

    @property
    def present(self) -> tuple[PendingConnection, ...]:
        return tuple(self._present)

    def add(self, pending: PendingConnection) -> bool:
        """Count a new connection. If there are too many, reject the one of the lowest stage that has waited longest.

        A host that has too many loses one of its own, so that idle connections cannot keep others out.

        Returns:
            False if the strangers' budget is spent and none of it by connections that wait here.
        """
        of_host = [each for each in self._present if each.network == pending.network]
        if self._full(len(of_host), self.limits.of_one_host, pending.host):
            self.reject_lowest(Rejected.TOO_MANY(), of_host)
        elif self._full(len(self._present), self.limits.total) or self._uses_reserve():
            self.reject_lowest(Rejected.TOO_MANY())
        while not self.strangers.take(CONNECTION):
            if not self._present:
                return False
            self.reject_lowest(Rejected.TOO_MANY())
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
        limit = self.limits.when_scarce
        return limit is not None and len(self._present) >= limit and descriptors.scarce()  # last, as it opens a socket

    def reject_lowest(self, message: str, among: Iterable[PendingConnection] = ()) -> None:
        """Reject the connection of the lowest stage, of these or of all."""
        min(among or self._present, key=lambda each: each.stage).reject(message)

    def remove(self, pending: PendingConnection) -> None:
        """Remove a connection that has authenticated or is gone, unless there was no room for it."""
        if pending in self._present:
            del self._present[pending]
            self.strangers.give(CONNECTION)

    def close(self) -> None:
        for pending in self.present:
            pending.reject("the bridge stops")


class PendingConnection(ABC):
    """One connection until its peer has authenticated, or it is gone.

    Attributes:
        who: the peer with its address, for the log.
        network: counts as one host with others (`network`).
        name: given by the peer, and not authenticated.
    """

    rejected_code: ClassVar[EventCode]

    def __init__(self, pending: PendingConnections) -> None:
        self.stage = ConnectionStage.WAITING
        self.who = self.host = self.network = self.name = ""
        self._pending = pending
        self._deadline: asyncio.TimerHandle | None = None
        self._refusal: tuple[bytes, str] = (b"", "")

    def _arrive(self, host: str, who: str) -> bool:
        """Begin to wait for the handshake; return False if there is no room."""
        self.who, self.host, self.network = who, host, network(host)
        if not self._pending.add(self):
            return False
        self._deadline = asyncio.get_running_loop().call_later(_HANDSHAKE_WITHIN, self._give_up)
        return True

    def _give_up(self) -> None:
        """Reject a peer whose handshake takes too long."""
        why, cause = self._why_overdue()
        self.reject(why(seconds=_HANDSHAKE_WITHIN), cause)

    def _why_overdue(self) -> tuple[Rejected, str]:
        """Return the reason why the handshake is overdue, and the event's cause."""
        return Rejected.NO_HANDSHAKE, ""

    def _accept(self) -> None:
        """Note that the peer's first message opens under its key; reject the oldest of its name beyond the limit."""
        self.stage = ConnectionStage.ACCEPTED
        same = [each for each in self._pending.present if (each.name, each.stage) == (self.name, self.stage)]
        for oldest in same[: -self._pending.limits.accepted]:
            oldest.reject("replaced by newer connections under the same name")

    def reject(self, message: str, cause: str = "") -> None:
        """Refuse the connection and close it, unless it is over."""
        if self.stage is ConnectionStage.OVER:
            return
        if self.stage is not ConnectionStage.REFUSED:  # else it is logged, and has an answer of its own that waits
            self._log(self.rejected_code, message, cause)
            self._refusal = self._busy(message), message
        self._tell()

    def _refuse(self, code: EventCode, message: str, answer: bytes, cause: str = "", link: str = "") -> None:
        """Refuse a peer that failed to authenticate: later if many at its host have failed."""
        refusals = self._pending.refusals
        refusals.failed(self.host)
        self._log(code, message, cause, link)
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

    def _stop_waiting(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _log(self, code: EventCode, message: str, cause: str = "", link: str = "") -> None:
        self._pending.refusals.log(self.host, self.who, code, message, link, cause)

    @abstractmethod
    def _busy(self, message: str) -> bytes:
        """Return the bytes that refuse a peer which has done nothing wrong."""

    @abstractmethod
    def _close_with(self, answer: bytes, message: str) -> None:
        """Write the answer, then close for the reason given."""

    @abstractmethod
    def _pause_reading(self) -> None: ...

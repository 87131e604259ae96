"""What the server has refused lately: which hosts are answered late, and which refusals are logged already."""

from __future__ import annotations

import ipaddress
from collections import deque
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.token_bucket import TokenBucket

if TYPE_CHECKING:
    from rsb_bridge.model.codes import EventCode
    from rsb_bridge.telemetry.event_log import EventLog
    from rsb_bridge.transport.streams import Stream

_FAILURES = 5
_FAILURES_WITHIN = 30.0
_DELAY = 1.0
_HOSTS_REMEMBERED = 1024
_LOGGED_AFTER, _LOGGED_AFTER_AT_LAST = 60.0, 3600.0
"""s until the same refusal of the same host is logged again; twice as long each time."""
_FORGOTTEN_AFTER = 60.0
"""s without another one; a client that is refused tries again within 12 s."""
_OF_ONE_HOST = 8
"""Different refusals that are logged one by one; whoever tries chooses the words: its name, its key's fingerprint."""
_MANY = "many different reasons; further ones of its host are not logged one by one"
_LINES, _LINES_A_SECOND = 256, 0.5
"""Of all hosts."""


class _Logged:
    """A refusal that is in the log already.

    Attributes:
        tried_at: s, when it last happened.
    """

    def __init__(self, now: float) -> None:
        self.tried_at = now
        self._wait = _LOGGED_AFTER
        self._due = now + self._wait

    def due_again(self, now: float) -> bool:
        """It happens again, at `now` (s): whether to log it."""
        self.tried_at = now
        if now < self._due:
            return False
        self._wait = min(2 * self._wait, _LOGGED_AFTER_AT_LAST)
        self._due = now + self._wait
        return True


class Recording(Protocol):
    """What refusals are counted on, and recorded in."""

    @property
    def events(self) -> EventLog:
        """The engine's."""
        ...

    def now(self) -> float:
        """Seconds on a clock that nobody sets."""
        ...


class Refusals:
    """Refusals by host. The addresses of an IPv6 /64, which one machine can have, count as one host."""

    def __init__(self, context: Recording) -> None:
        self._context = context
        self._failures: dict[str, deque[float]] = {}
        self._logged: dict[tuple[str, str], _Logged] = {}
        self._lines = TokenBucket(_LINES, _LINES_A_SECOND, context.now())

    def failed(self, host: str) -> None:
        """Somebody at a host failed to authenticate."""
        self._failures.setdefault(network(host), deque(maxlen=_FAILURES)).append(self._context.now())
        if len(self._failures) > _HOSTS_REMEMBERED:
            self._failures.pop(next(iter(self._failures)))

    def delay(self, host: str) -> float:
        """How late (s) a host is told that it is refused: failures cost time, but lock nobody out."""
        return _DELAY if len(self._failures.get(network(host), ())) >= _FAILURES else 0.0

    def log(self, stream: Stream, code: EventCode, message: str, name: str = "", cause: str = "") -> None:
        """Log that a client was rejected, as `log_of` does.

        The quota of the link of that name stays as it is: anybody can use the name.
        """
        self.log_of(stream.host, f"a client at {stream.peer}", code, message, name, cause)

    def log_of(self, host: str, who: str, code: EventCode, message: str, name: str = "", cause: str = "") -> None:
        """Log that somebody was rejected: ever more rarely for each host and message, and few messages of a host."""
        host = network(host)
        if (host, _MANY) in self._logged or self._has_many(host, message):
            message = _MANY
        if self.is_new(host, message):
            self._context.events.add(Level.WARNING, code, f"rejected {who}: {message}", link=name, cause=cause)

    def _has_many(self, host: str, message: str) -> bool:
        return (host, message) not in self._logged and sum(1 for one, _ in self._logged if one == host) >= _OF_ONE_HOST

    def is_new(self, host: str, message: str) -> bool:
        """Whether to log a message about a host, or about none, now."""
        now, logged = self._context.now(), self._logged.get((host, message))
        if logged is not None:
            return logged.due_again(now)
        if len(self._logged) >= _LINES or not self._lines.take(1, now):
            return False
        self._logged[host, message] = _Logged(now)
        return True

    def tick(self) -> None:
        """Once a second: forget old failures, and which were logged."""
        now = self._context.now()
        for host, times in tuple(self._failures.items()):
            while times and now - times[0] > _FAILURES_WITHIN:
                times.popleft()
            if not times:
                del self._failures[host]
        self._logged = {key: each for key, each in self._logged.items() if now - each.tried_at < _FORGOTTEN_AFTER}


def network(host: str) -> str:
    """What counts as one host: an IPv6 address's /64; any other address, Bluetooth's included, itself."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if address.version == 4 or address.ipv4_mapped or address.is_link_local:
        return host
    return str(ipaddress.IPv6Network((int(address), 64), strict=False))

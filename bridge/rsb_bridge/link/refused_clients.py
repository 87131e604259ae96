"""Clients that a server refuses, such as a second one of the same name: answers, log entries and snapshots."""

from __future__ import annotations

import ipaddress
import shlex
from collections import deque
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import Level, RefusedClient
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.verdict import LinkCause, about
from rsb_bridge.model.wording import Wording
from rsb_bridge.wire.events import RefusalCode
from rsb_bridge.wire.messages import Duplicate

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.model.codes import EventCode
    from rsb_bridge.telemetry.event_log import EventLog
    from rsb_bridge.transport.streams import Stream

CAUSES: dict[RefusalCode | None, LinkCause] = {
    RefusalCode.WRONG_KEY: LinkCause.WRONG_KEY,
    RefusalCode.WRONG_VERSION: LinkCause.WRONG_VERSION,
    RefusalCode.UNKNOWN_NAME: LinkCause.UNKNOWN_NAME,
    RefusalCode.NAME_TAKEN: LinkCause.NAME_TAKEN,
    RefusalCode.SHUT_DOWN: LinkCause.SHUT_DOWN,
}
"""Why the link is down; with any other code, `LinkCause.REFUSED`."""
ASKED_EVERY = 30.0
"""s between the questions of a client whether it may come back; jitter comes on top."""
_FAILURES = 5
_FAILURES_WITHIN = 30.0
_DELAY = 1.0
_HOSTS_REMEMBERED = 1024
_LOGGED_AFTER, _LOGGED_AFTER_AT_LAST = 60.0, 3600.0
"""s until the same refusal of the same host is logged again; twice as long each time."""
_LINE_FORGOTTEN_AFTER = 60.0
"""s without another one; a client that is refused tries again within 12 s."""
_OF_ONE_HOST = 8
"""Different refusals that are logged one by one; whoever tries chooses the words: its name, its key's fingerprint."""
_MANY = "many different reasons; further ones of its host are not logged one by one"
_LINES, _LINES_A_SECOND = 256, 0.5
"""Lines about all hosts."""
MOST = 16
MOST_OF_ONE_HOST = 4
"""Robots behind one router share an address; a program that makes up names must not fill the table."""
FORGOTTEN_AFTER = 30.0
"""s without an attempt; a refused client tries again within 12 s."""


def with_remedy(code: RefusalCode, message: str, *, name: str, has_key: bool) -> str:
    """The server's message, and what the client's operator does about it.

    Args:
        code: the server's.
        message: the server's.
        name: the client's.
        has_key: whether the client has a key.
    """
    match code:
        case RefusalCode.WRONG_KEY if has_key:
            return f"{message}: copy one side's key file to the other"
        case RefusalCode.NAME_TAKEN:
            return f"{message}: {REMEDY}"
        case RefusalCode.SHUT_DOWN:
            return told_by_server(message)
        case RefusalCode.UNKNOWN_NAME:
            add = f"rsb-console client add {shlex.quote(name)}"
            return f"{message}: run {add} on the server, or correct name in this side's session"
        case RefusalCode.ENCRYPTION_REQUIRED:
            return f"{message}: set use_encryption and key_file"
        case _:
            return message


class SameName(Wording):
    """Several clients that have one name."""

    SECOND = "a second client at {address} calls itself {name!r} too, and is refused"
    SEVERAL = "a second client at {address} and {others} call themselves {name!r} too, and are refused"
    REMEDY_FOR_SEVERAL = "stop all but one, or give each a name and a key of its own"
    NO_MORE = "no second client calls itself {name!r} any more"
    TAKEN = "{name!r} is linked already, since {since:%Y-%m-%d %H:%M} UTC, at {address}"


@dataclass(frozen=True, slots=True)
class ShutDown:
    """Who has shut a link down.

    Attributes:
        by: in words: ``anna on pts/3``.
        since: s since the epoch.
    """

    by: str
    since: float

    def refusal(self) -> str:
        """What its client is told; it stays the same as long as the link is shut down."""
        since = datetime.fromtimestamp(self.since, UTC)
        return sanitize_text(f"shut down by {self.by}, since {since:%Y-%m-%d %H:%M} UTC")

    def reason(self, name: str) -> str:
        """What the server's operator is told of the link of that name."""
        return f"{self.refusal()}; `rsb-console retry --link {name}` lets it in again"


def told_by_server(refusal: str) -> str:
    """What the client's operator is told."""
    asks = f"this side asks again every {ASKED_EVERY:g} s"
    return f"the server says: {refusal}; {asks}, until an operator there lets it in again"


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
        self._logged = {key: each for key, each in self._logged.items() if now - each.tried_at < _LINE_FORGOTTEN_AFTER}


def network(host: str) -> str:
    """What counts as one host: an IPv6 address's /64; any other address, Bluetooth's included, itself."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if address.version == 4 or address.ipv4_mapped or address.is_link_local:
        return host
    return str(ipaddress.IPv6Network((int(address), 64), strict=False))


@dataclass(slots=True)
class _Entry:
    shown: RefusedClient
    tried_at: float


class RefusedClients:
    """The refused clients that no link shows and that still try, each until 30 s after its last attempt.

    Their name is unknown, or linked, and their key wrong.

    A new client displaces no other: a flood of made-up names cannot hide a robot that is listed.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._entries: dict[tuple[str, str], _Entry] = {}

    def record_attempt(self, stream: Stream, name: str, cause: LinkCause, reason: str) -> None:
        """Record an attempt, unless the table or the host's share of it is full.

        Args:
            stream: of the client.
            name: that the client gave, or empty.
            cause: of the refusal.
            reason: the same in words, with the remedy.
        """
        host = network(stream.host)
        entry = self._entries.get((host, name))
        if entry is None:
            of_host = sum(1 for each, _ in self._entries if each == host)
            if len(self._entries) >= MOST or of_host >= MOST_OF_ONE_HOST:
                return
            shown = RefusedClient(name, stream.host, cause, reason, self._context.wall(), 1)
        else:
            old = entry.shown
            since = old.since if old.cause == cause else self._context.wall()
            shown = RefusedClient(name, stream.host, cause, reason, since, old.attempts + 1)
        self._entries[host, name] = _Entry(shown, self._context.now())

    def forget(self, name: str) -> None:
        """Drop the entries of a name when its client is linked or added."""
        for key in [key for key in self._entries if key[1] == name]:
            del self._entries[key]

    def tick(self) -> None:
        """Forget clients without a recent attempt; called once a second."""
        oldest = self._context.now() - FORGOTTEN_AFTER
        for key in [key for key, entry in self._entries.items() if entry.tried_at < oldest]:
            del self._entries[key]

    def shown(self) -> tuple[RefusedClient, ...]:
        """Return the refused clients, the longest refused first."""
        return tuple(entry.shown for entry in self._entries.values())


NAME_TRIED_EVERY = 3.0
"""s between the attempts of a client that is refused because of its name."""
_REMEMBERED = 2 * NAME_TRIED_EVERY
"""s after its last attempt."""
DUPLICATES_KEPT = 4
"""Second clients of one name; each may call its host anything."""
REMEDY = "stop one of the two, or give each a name and a key of its own"


@dataclass(slots=True)
class DuplicateClients:
    """Further clients of the name of one that is linked, as long as they try.

    Attributes:
        name: of all.
    """

    name: str
    _since: float = 0.0  # s since the epoch: since then there has always been one
    _tried: dict[tuple[str, str], float] = field(default_factory=dict)  # last attempt, by address and host; newest last
    _others: int = 0  # that the server tells of

    def tried(self, address: str, host: str, now: float, wall: float) -> None:
        """The server has refused one at `now` (s), which is `wall` (s since the epoch). A few are kept."""
        self._tried = self._fresh(now)
        if not self._tried:
            self._since = wall
        if (address, host) not in self._tried and len(self._tried) >= DUPLICATES_KEPT:
            del self._tried[min(self._tried, key=self._tried.__getitem__)]
        self._tried[address, host] = now

    def told(self, news: Duplicate, wall: float) -> None:
        """The server has said which there are; so it is until it says something else."""
        if not self._tried:
            self._since = wall
        self._tried = {(news.address, news.host): float("inf")} if news.address else {}
        self._others = news.others

    def news(self, now: float) -> Duplicate:
        """The one that came last, and how many others there are; what the server tells the client that has the name."""
        fresh = self._fresh(now)
        if not fresh:
            return Duplicate()
        address, host = list(fresh)[-1]
        others = self._others + len(fresh) - 1
        return Duplicate(sanitize_text(address, TEXT_LENGTH), sanitize_text(host, TEXT_LENGTH), others)

    def text(self, now: float) -> str:
        """What the linked client's log says; empty: there is none."""
        what, remedy = self._words(now)
        return f"{what}: {remedy}" if what else ""

    def over(self) -> str:
        """What the log says when there is none any more."""
        return SameName.NO_MORE(name=self.name)

    def warning(self, now: float, wall: float) -> str:
        """What both sides' screens say at `now` (s), which is `wall` (s since the epoch); empty: there is none."""
        what, remedy = self._words(now)
        return f"{what}, for {about(wall - self._since)} now: {remedy}" if what else ""

    def _words(self, now: float) -> tuple[str, str]:
        """What there is, and what to do about it."""
        news = self.news(now)
        if not news.address:
            return "", ""
        at = _at(news.address, news.host)
        if not news.others:
            return SameName.SECOND(address=at, name=self.name), REMEDY
        others = "1 other" if news.others == 1 else f"{news.others} others"
        what = SameName.SEVERAL(address=at, others=others, name=self.name)
        return what, SameName.REMEDY_FOR_SEVERAL()

    def _fresh(self, now: float) -> dict[tuple[str, str], float]:
        return {client: at for client, at in self._tried.items() if now - at <= _REMEMBERED}


def name_taken(name: str, address: str, host: str, since: float) -> str:
    """Who has the name, since when (s since the epoch); it stays the same as long as that one is linked."""
    linked = datetime.fromtimestamp(since, UTC)
    return SameName.TAKEN(name=name, since=linked, address=_at(address, host))


def _at(address: str, host: str) -> str:
    return f"{address} (host {sanitize_text(host)})" if host else address

"""Clients that a server refuses, such as a second one of the same name: answers, log entries and snapshots."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from rsb_bridge.link.pending_connections import network
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import RefusedClient
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.verdict import LinkCause, about
from rsb_bridge.model.wording import Wording
from rsb_bridge.wire.events import RefusalCode
from rsb_bridge.wire.messages import Duplicate

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.transport.streams import Stream

CAUSES: dict[RefusalCode | None, LinkCause] = {
    RefusalCode.WRONG_KEY: LinkCause.WRONG_KEY,
    RefusalCode.WRONG_VERSION: LinkCause.WRONG_VERSION,
    RefusalCode.UNKNOWN_NAME: LinkCause.UNKNOWN_NAME,
    RefusalCode.NAME_TAKEN: LinkCause.NAME_TAKEN,
    RefusalCode.SHUT_DOWN: LinkCause.SHUT_DOWN,
}
"""Why the link is down; with any other code, `LinkCause.REFUSED`."""
ASKED_EVERY = 30.0  # s between the attempts of a client whose link is shut down, before jitter (PROTOCOL.md, 3)
MOST = 16  # entries: they are on the first screen
MOST_OF_ONE_HOST = 4  # robots behind one router share an address; a program that makes up names must not fill the table
FORGOTTEN_AFTER = 30.0  # s without an attempt; a refused client tries again within 12 s


class SameName(Wording):
    """Several clients that have one name."""

    SECOND = "a second client at {address} calls itself {name!r} too, and is refused"
    TAKEN = "{name!r} is linked already, since {since:%Y-%m-%d %H:%M} UTC, at {address}"


@dataclass(frozen=True, slots=True)
class LinkShutdown:
    """A link's shutdown by an operator."""

    by: str  # such as ``anna on pts/3``
    since: float  # s since the epoch

    def refusal(self) -> str:
        """Return the refusal for the client, which does not change until the end of the shutdown."""
        since = datetime.fromtimestamp(self.since, UTC)
        return sanitize_text(f"shut down by {self.by}, since {since:%Y-%m-%d %H:%M} UTC")

    def reason(self, bridge: str, name: str) -> str:
        """Return the reason for the operator of the server `bridge`."""
        command = f"rsb-console retry {shlex.quote(bridge)} --link {shlex.quote(name)}"
        return f"{self.refusal()}; press r or run `{command}` to accept it again"


def server_refusal(refusal: str) -> str:
    """Return the server's refusal for the client's operator."""
    asks = f"this side asks again every {ASKED_EVERY:g} s"
    return f"the server says: {refusal}; {asks}, until an operator there accepts it again"


class RefusedClients:
    """The refused clients that no link shows and that still try, each until 30 s after its last attempt.

    Their name is unknown, or linked, and their key wrong. A new client displaces no other: a flood of made-up names
    cannot hide a robot that is listed.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._entries: dict[tuple[str, str], tuple[RefusedClient, float]] = {}  # with the time of the last attempt

    def record_attempt(self, stream: Stream, name: str, cause: LinkCause, reason: str) -> None:
        """Record an attempt, unless the table or the host's share of it is full. The client may have given no name."""
        host, wall, attempts = network(stream.host), self._context.wall(), 1
        since = wall
        if (host, name) in self._entries:
            old, _ = self._entries[host, name]
            since, attempts = old.since if old.cause == cause else wall, old.attempts + 1
        elif len(self._entries) >= MOST or sum(each == host for each, _ in self._entries) >= MOST_OF_ONE_HOST:
            return
        shown = RefusedClient(name, stream.host, cause, reason, since, attempts)
        self._entries[host, name] = shown, self._context.now()

    def forget(self, name: str) -> None:
        """Drop the entries of a name when its client is linked or added."""
        for key in [key for key in self._entries if key[1] == name]:
            del self._entries[key]

    def tick(self) -> None:
        """Forget clients without a recent attempt."""
        oldest = self._context.now() - FORGOTTEN_AFTER
        for key in [key for key, (_, tried_at) in self._entries.items() if tried_at < oldest]:
            del self._entries[key]

    def shown(self) -> tuple[RefusedClient, ...]:
        """Return the refused clients, the longest refused first."""
        return tuple(shown for shown, _ in self._entries.values())


NAME_TRIED_EVERY = 3.0
"""s between the attempts of a client that is refused because of its name. A round figure: the warning about it ends two
of them after its last attempt."""
_REMEMBERED = 2 * NAME_TRIED_EVERY  # s after its last attempt
DUPLICATES_KEPT = 4  # second clients of one name; each may call its host anything
REMEDY = "stop one of the two, or give each a name and a key of its own"


@dataclass(slots=True)
class DuplicateClients:
    """Clients that try to use the name of a linked client."""

    name: str
    _since: float = 0.0  # s since the epoch: there has been at least one since then
    _tried: dict[tuple[str, str], float] = field(default_factory=dict)  # last attempts by address and host, newest last
    _others: int = 0  # number in the server's message

    def tried(self, address: str, host: str, now: float, wall: float) -> None:
        """Record one that the server has refused at `now` (s), or `wall` (s since the epoch). A few are kept."""
        self._tried = self._fresh(now)
        if not self._tried:
            self._since = wall
        if (address, host) not in self._tried and len(self._tried) >= DUPLICATES_KEPT:
            del self._tried[min(self._tried, key=self._tried.__getitem__)]
        self._tried[address, host] = now

    def take_news(self, news: Duplicate, wall: float) -> None:
        """Take the server's message about them, which is valid until the next one."""
        if not self._tried:
            self._since = wall
        self._tried = {(news.address, news.host): float("inf")} if news.address else {}
        self._others = news.others

    def news(self, now: float) -> Duplicate:
        """Return the newest one and the number of others, as the server tells the linked client."""
        fresh = self._fresh(now)
        if not fresh:
            return Duplicate()
        address, host = list(fresh)[-1]
        others = self._others + len(fresh) - 1
        return Duplicate(sanitize_text(address, TEXT_LENGTH), sanitize_text(host, TEXT_LENGTH), others)

    def text(self, now: float, wall: float | None = None) -> str:
        """Return the text for an operator, or an empty string without duplicates.

        Args:
            now: the time.
            wall: the time in s since the epoch, for a text that says how long it has been so.
        """
        news = self.news(now)
        if not news.address:
            return ""
        at = _at(news.address, news.host)
        if news.others:
            others = "1 other" if news.others == 1 else f"{news.others} others"
            what = f"a second client at {at} and {others} call themselves {self.name!r} too, and are refused"
            remedy = "stop all but one, or give each a name and a key of its own"
        else:
            what, remedy = SameName.SECOND(address=at, name=self.name), REMEDY
        lasting = "" if wall is None else f", for {about(wall - self._since)} now"
        return f"{what}{lasting}: {remedy}"

    def ended_text(self) -> str:
        return f"no second client calls itself {self.name!r} any more"

    def _fresh(self, now: float) -> dict[tuple[str, str], float]:
        tried = self._tried
        return {client: at for client, at in tried.items() if now - at <= _REMEMBERED} if tried else tried


def name_taken(name: str, address: str, host: str, since: float) -> str:
    """Return the text on the client that has a name since a time (s since the epoch); constant during its link."""
    linked = datetime.fromtimestamp(since, UTC)
    return SameName.TAKEN(name=name, since=linked, address=_at(address, host))


def _at(address: str, host: str) -> str:
    return f"{address} (host {sanitize_text(host)})" if host else address

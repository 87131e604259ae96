"""Several clients of one name: the first keeps the link, and both sides are told of the others."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime

from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.verdict import about
from rsb_bridge.wire.messages import Duplicate

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
        return f"no second client calls itself {self.name!r} any more"

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
            return f"a second client at {at} calls itself {self.name!r} too, and is refused", REMEDY
        others = "1 other" if news.others == 1 else f"{news.others} others"
        what = f"a second client at {at} and {others} call themselves {self.name!r} too, and are refused"
        return what, "stop all but one, or give each a name and a key of its own"

    def _fresh(self, now: float) -> dict[tuple[str, str], float]:
        return {client: at for client, at in self._tried.items() if now - at <= _REMEMBERED}


def name_taken(name: str, address: str, host: str, since: float) -> str:
    """Who has the name, since when (s since the epoch); it stays the same as long as that one is linked."""
    linked = datetime.fromtimestamp(since, UTC)
    return f"{name!r} is linked already, since {linked:%Y-%m-%d %H:%M} UTC, at {_at(address, host)}"


def _at(address: str, host: str) -> str:
    return f"{address} (host {sanitize_text(host)})" if host else address

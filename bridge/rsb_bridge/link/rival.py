"""Two clients of one name: the first keeps the link, and the second is named on both sides."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.verdict import about

_REMEMBERED = 30.0
"""s after its last attempt; a client that is refused tries again within 12 s."""
REMEDY = "stop one of the two, or give each a name and a key of its own"


@dataclass(slots=True)
class Rival:
    """A second client of the name of one that is linked.

    Attributes:
        name: of both.
        host: what its machine calls itself; or empty.
        since: s since the epoch, of its first attempt.
    """

    name: str
    host: str
    since: float
    _address: str = ""
    _tried_at: float = float("-inf")

    def tried(self, address: str, now: float) -> None:
        """It was refused, at `now` (s)."""
        self._address, self._tried_at = address, now

    def warning(self, now: float, wall: float) -> str:
        """What the server's operator is told at `now` (s), which is `wall` (s since the epoch); empty: it is gone."""
        if now - self._tried_at > _REMEMBERED:
            return ""
        return (
            f"a second client, from {_at(self._address, self.host)}, calls itself {self.name!r} too, and is refused, "
            f"for {about(wall - self.since)} now: {REMEDY}"
        )


def name_taken(name: str, address: str, host: str, since: float) -> str:
    """Who has the name, since when (s since the epoch); it stays the same as long as that one is linked."""
    linked = datetime.fromtimestamp(since, UTC)
    return f"{name!r} is linked already, since {linked:%Y-%m-%d %H:%M} UTC, from {_at(address, host)}"


def _at(address: str, host: str) -> str:
    return f"{address} (host {sanitize_text(host)})" if host else address

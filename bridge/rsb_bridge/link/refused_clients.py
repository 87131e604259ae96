"""Refused clients that no link of the server shows: with an unknown name, or a wrong key for a linked name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.link.refusals import network
from rsb_bridge.model.snapshot import RefusedClient

if TYPE_CHECKING:
    from rsb_bridge.model.verdict import LinkCause
    from rsb_bridge.transport.streams import Stream

MOST = 16
MOST_OF_ONE_HOST = 4
"""Robots behind one router share an address; a program that makes up names must not fill the table."""
FORGOTTEN_AFTER = 30.0
"""s without an attempt; a refused client tries again within 12 s."""


class Clocks(Protocol):
    """The two clocks of a context."""

    def now(self) -> float:
        """Return seconds on a clock that nobody sets."""
        ...

    def wall(self) -> float:
        """Return seconds since the epoch."""
        ...


@dataclass(slots=True)
class _Entry:
    shown: RefusedClient
    tried_at: float


class RefusedClients:
    """The refused clients that still try, each until 30 s after its last attempt.

    A new client displaces no other: a flood of made-up names cannot hide a robot that is listed.
    """

    def __init__(self, clocks: Clocks) -> None:
        self._clocks = clocks
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
            shown = RefusedClient(name, stream.host, cause, reason, self._clocks.wall(), 1)
        else:
            old = entry.shown
            since = old.since if old.cause == cause else self._clocks.wall()
            shown = RefusedClient(name, stream.host, cause, reason, since, old.attempts + 1)
        self._entries[host, name] = _Entry(shown, self._clocks.now())

    def forget(self, name: str) -> None:
        """Drop the entries of a name when its client is linked or added."""
        for key in [key for key in self._entries if key[1] == name]:
            del self._entries[key]

    def tick(self) -> None:
        """Forget clients without a recent attempt; called once a second."""
        oldest = self._clocks.now() - FORGOTTEN_AFTER
        for key in [key for key, entry in self._entries.items() if entry.tried_at < oldest]:
            del self._entries[key]

    def shown(self) -> tuple[RefusedClient, ...]:
        """Return the refused clients, the longest refused first."""
        return tuple(entry.shown for entry in self._entries.values())

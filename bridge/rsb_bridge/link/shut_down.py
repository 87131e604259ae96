"""A link that an operator has shut down on the server: what both sides say of it, and how the client asks again."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from rsb_bridge.model.text import sanitize_text

ASKED_EVERY = 30.0
"""s between the questions of a client whether it may come back; jitter comes on top."""


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

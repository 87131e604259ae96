"""The reason for the end of a connection, or of an opening of a route: a code to decide by, and words for people."""

from __future__ import annotations

from enum import StrEnum
from typing import Final, NamedTuple


class EndCode(StrEnum):
    """The cause of the end. Both sides decide by it; it crosses the link in a `Close`."""

    DECIDED = "decided"
    """One of the sides ended or refused it; the words say why."""
    REMOVED = "removed"
    """It ends for good: no session lists it any more."""
    EDITED = "edited"
    """Its proposer proposes it again, changed."""
    LISTED_DIFFERENTLY = "listed_differently"
    """Both sessions list it, with values that differ."""
    LEFT = "left"
    """The other end closed the connection."""
    TIMED_OUT = "timed_out"
    """The kernel tried for long to get something through (ETIMEDOUT)."""
    BROKE = "broke"
    """The connection failed in another way."""


_BROKE = frozenset({EndCode.LEFT, EndCode.TIMED_OUT, EndCode.BROKE})


class Reason(NamedTuple):
    """A reason with its code. One without words is none, and false."""

    text: str  # for an operator
    code: EndCode = EndCode.DECIDED

    def __bool__(self) -> bool:
        return bool(self.text)

    def __str__(self) -> str:
        return f"data connection: {self.text}" if self.broke else self.text

    @property
    def broke(self) -> bool:
        """Whether a connection ended that nobody wanted to end."""
        return self.code in _BROKE

    @property
    def timed_out(self) -> bool:
        """Whether the kernel gave the connection up."""
        return self.code is EndCode.TIMED_OUT


NO_REASON: Final = Reason("")

"""How much a topic matters beside the others of its link: the words of session files, and their ranks on the wire."""

from __future__ import annotations

from typing import Final, Literal

Priority = Literal["low", "normal", "high"]

RANKS: Final[dict[Priority, int]] = {"low": -1, "normal": 0, "high": 1}
"""As a proposal has them, the higher one first, as with DDS's transport priority."""
LOWEST, HIGHEST = -100, 100
"""Ranks that a newer peer may use; each counts as the word that is nearest."""
FEATURE = "priority"
"""What a side that keeps to priorities names among its features."""
_WEIGHTS: Final[dict[Priority, int]] = {"low": 1, "normal": 4, "high": 16}


def priority_of(rank: int) -> Priority:
    """The word for a rank."""
    return "low" if rank < 0 else "high" if rank > 0 else "normal"


def weight_of(rank: int) -> int:
    """The share of a stream that a route has beside others that want more than there is, relative to theirs."""
    return _WEIGHTS[priority_of(rank)]

"""What a command answers for one side of a link, and the side in words."""

from __future__ import annotations

from typing import Protocol

from rsb_bridge.model.names import other_side
from rsb_bridge.model.wording import Wording


class SideText(Wording):
    PROBLEM = "{side}: {problem}"


class SideAnswer(Protocol):
    """The answer of one side.

    Attributes:
        link: the link to it, or empty for this side.
        problem: why nothing is known of it, or empty.
    """

    @property
    def link(self) -> str: ...
    @property
    def problem(self) -> str: ...


def side_of(role: str, link: str) -> str:
    """Return a side in words: this one if the link is empty."""
    return other_side(role, link) if link else "this side"

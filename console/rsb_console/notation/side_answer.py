"""The answer of a command for one side of a link, and the side in words."""

from __future__ import annotations

from typing import Protocol

from rsb_bridge.model.names import other_side
from rsb_bridge.model.wording import Wording


class SideText(Wording):
    PROBLEM = "{side}: {problem}"
    OLD = "as of {age} ago: no answer since"
    NO_RIGHT = "no right"
    """In a list, in place of what may be asked for. `lacks` says the rest."""
    LACKS = "{side} does not let this side {act}: add {entry} in the session file there"

    @classmethod
    def of(cls, side: str, problem: str) -> str:
        """Return a side's problem with its name, unless it begins with that: ``the server does not let robot1 …``."""
        return problem if problem.startswith(f"{side} ") else cls.PROBLEM(side=side, problem=problem)


class SideAnswer(Protocol):
    """The answer of one side.

    Attributes:
        link: the link to it, or empty for this side.
        problem: the reason why there is no answer, or empty.
    """

    @property
    def link(self) -> str: ...
    @property
    def problem(self) -> str: ...


def side_of(role: str, link: str) -> str:
    """Return a side in words: this one if the link is empty."""
    return other_side(role, link) if link else "this side"

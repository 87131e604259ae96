"""The end of an arming, for the robot: a message on a topic, or the cancel of an action's goals (`on_end`)."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

ZERO: Final = "zero"
NONE: Final = "none"
"""Nothing is published; the robot goes on with its last command."""
CANCEL: Final = "cancel"
"""The goals of the link's callers are cancelled."""
LONGEST: Final = 200
"""Characters of a message, written as JSON."""


def text_of(on_end: str | dict[str, Any] | None) -> str:
    """Return what a line of a session wants as one text, empty if it says nothing; a message as JSON."""
    return json.dumps(on_end) if isinstance(on_end, dict) else on_end or ""


def is_message(text: str) -> bool:
    """Whether it is a message, and not a word."""
    return text.startswith("{")


def suits(kind: str, text: str) -> bool:
    """Whether something of a kind can end so. The fields of a message are not looked at."""
    if kind == "action":
        return text in (CANCEL, NONE)
    return kind == "topic" and (text in (ZERO, NONE) or is_message(text))


def more_careful(texts: Iterable[str]) -> str:
    """Return which of several lines holds, the first one's of equals: ``none`` loses against any message."""
    given = [each for each in texts if each]
    return next((each for each in given if each != NONE), NONE if given else "")

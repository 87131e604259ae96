"""Text from outside, made fit for terminals, logs and messages."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from rsb_bridge.model.limits import REASON_LENGTH

if TYPE_CHECKING:
    from collections.abc import Sequence

UNPRINTABLE = "\\x00-\\x1f\\x7f-\\x9f\\u2028-\\u202e\\u2066-\\u2069"
"""Control characters, and the marks that turn the direction of text; for a regular expression's brackets."""

_unprintable = re.compile(f"[{UNPRINTABLE}]")


def sanitize_text(text: str, limit: int = REASON_LENGTH) -> str:
    """Replace each unprintable character by U+FFFD, and cut what is longer than `limit` characters."""
    return _unprintable.sub("\N{REPLACEMENT CHARACTER}", text[:limit])


def join_first(parts: Sequence[str], most: int) -> str:
    """The first `most` parts with commas between them, and how many more there are."""
    more = len(parts) - most
    return ", ".join(parts[:most]) + (f" and {more} more" if more > 0 else "")

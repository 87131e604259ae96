"""Patterns of names: ``*`` matches characters of one segment, ``**`` matches segments."""

from __future__ import annotations

import re
from typing import Final

from rsb_bridge.model.names import is_topic_name

ROUTES_PER_PATTERN: Final = 100  # routes that one pattern makes on one link. A round figure
ROUTES_BY_PATTERNS: Final = 250
"""Routes that all patterns of one side make on one link: a client takes 256 of a server's
(`rsb_bridge.model.limits.ROUTES_PROPOSED_BY_SERVER`)."""
PATTERNS_PER_LINK: Final = 64  # patterns of one side, on one link; of the protocol (PROTOCOL.md, 3: Follow)
EXCEPTIONS_PER_PATTERN: Final = 256
"""Names and patterns that one pattern leaves out. A round figure: each name that it matches is compared with them."""
NAMES_FOLLOWED: Final = 1000
"""Names that one side of a link tells the other because they match its patterns; of the protocol (3: Followed)."""
GONE_AFTER: Final = 300.0
"""s for which a route stays whose topic nobody publishes any more. A round figure: bench/README has the memory that
such routes take."""

_WILDCARD = re.compile(r"\*+")


def is_pattern(name: str) -> bool:
    return "*" in name


def is_hidden(name: str) -> bool:
    """Whether ROS hides a name from lists: a segment of it begins with an underscore."""
    return "/_" in name


def is_valid(text: str) -> bool:
    """Whether some name can match: a name's form, with ``**`` for whole segments only."""
    segments = text.split("/")
    whole = all("**" not in segment or segment == "**" for segment in segments)
    return whole and is_topic_name(_WILDCARD.sub("x", text))


class Pattern:
    """A valid pattern, or a name, which matches itself.

    ``*`` matches any characters of one segment, and at least one if it is the whole segment. ``**`` matches any number
    of segments, at the end at least one: ``/camera/**`` is all below ``/camera``, without ``/camera`` itself. If a name
    matches in several ways, the first wildcards take the least.

    The time to match a name does not grow with the number of ways, since names may come from strangers.

    Args:
        text: the pattern as it is written.

    Attributes:
        text: the pattern as it is written.
        wildcards: the wildcards in it, in order.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.wildcards: tuple[str, ...] = tuple(_WILDCARD.findall(text))
        self._fixed = _WILDCARD.split(text)
        self._expression = re.compile(_expression(text.split("/")[1:]))

    def __repr__(self) -> str:
        return f"Pattern({self.text!r})"

    def match(self, name: str) -> tuple[str, ...] | None:
        """Return the parts of a name that the wildcards match, or None. Parts of ``**`` may have slashes."""
        found = self._expression.fullmatch(name)
        return None if found is None else tuple(part.lstrip("/") for part in found.groups())

    def fill(self, parts: tuple[str, ...]) -> str:
        """Put parts of a name in place of the wildcards: the inverse of `match`."""
        pieces = [self._fixed[0]]
        for part, fixed in zip(parts, self._fixed[1:], strict=True):
            if part:
                pieces.append(part)
            elif fixed.startswith("/") and pieces[-1].endswith("/"):  # ** matches no segment
                pieces[-1] = pieces[-1][:-1]
            pieces.append(fixed)
        return "".join(pieces)


def _expression(segments: list[str]) -> str:
    """Return a regular expression with a group for each wildcard.

    Everything up to the next ``**`` is found at the first place where it matches, and no other is tried: what follows
    can take up all the rest. That is what keeps the time in bounds, as in `fnmatch.translate`.
    """
    runs: list[list[str]] = [[]]
    for segment in segments:
        if segment == "**":
            runs.append([])
        else:
            runs[-1].append(segment)
    first, *others = ("".join(map(_segment, run)) for run in runs)
    parts = [first]
    for at, run in enumerate(others):
        is_last = at == len(others) - 1
        if not is_last:
            parts.append(f"(?>((?:/[^/]+)*?){run})")
        elif run:
            parts.append(f"((?:/[^/]+)*){run}")
        else:
            parts.append("((?:/[^/]+)+)")
    return "".join(parts)


def _segment(text: str) -> str:
    """Return the expression for one segment, with the slash before it; after it, the segment ends."""
    if text == "*":
        return "/([^/]+)(?![^/])"
    first, *fixed = map(re.escape, text.split("*"))
    if not fixed:
        return f"/{first}(?![^/])"
    between = "".join(f"(?>([^/]*?){each})" for each in fixed[:-1])
    return f"/{first}{between}([^/]*){fixed[-1]}(?![^/])"

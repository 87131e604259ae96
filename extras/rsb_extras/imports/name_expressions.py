"""Regular expressions over ROS names, as other bridges have them, written as this bridge's patterns."""

from __future__ import annotations

import re
from itertools import product

_MOST = 32  # patterns that one expression may become. A round figure: ``(a|b)(c|d)(e|f)`` has eight
_ANY, _SEGMENT = "\0", "\1"  # in place of the characters that they match: no name has either
_TOKEN = re.compile(
    r"(?P<any>\.[*+]\??)|(?P<segment>\[\^/\][*+])|\\(?P<escaped>[./_\-~])|(?P<open>\((?:\?:)?)|(?P<plain>[A-Za-z0-9_/~\-])"
)


def patterns(expression: str) -> list[str] | None:
    """Return patterns (`rsb_bridge.model.patterns`) that match the same full names, or None if it cannot be written so.

    ``.*`` and ``[^/]*``, groups and alternatives are understood. ``/**/`` also matches no segment at all, so the
    pattern of ``/a/.*/b`` matches ``/a/b``, too.
    """
    branches = _branches(expression)
    if branches is None:
        return None
    found = dict.fromkeys(pattern for branch in branches for pattern in _as_patterns(branch))
    return list(found) if len(found) <= _MOST else None


def globs(expression: str) -> list[str] | None:
    """Do as `patterns`, for the patterns of rights (`rsb_bridge.model.session.Grant`), whose ``*`` crosses slashes."""
    branches = _branches(expression)
    if branches is None:
        return None
    return list(dict.fromkeys(re.sub(f"[{_ANY}{_SEGMENT}]+", "*", branch) for branch in branches))


def _branches(expression: str) -> list[str] | None:
    """Return the names that an expression matches, with `_ANY` and `_SEGMENT` in them."""
    text = expression.removeprefix("^").removesuffix("$")
    branches, end = _alternatives(text, 0)
    return branches if text and branches and end == len(text) else None


def _alternatives(text: str, at: int) -> tuple[list[str], int]:
    """Return the branches from a place on, and the place where they end. An unknown expression has no branches."""
    done: list[str] = []
    now = [""]
    while at < len(text) and text[at] != ")":
        if text[at] == "|":
            done, now, at = done + now, [""], at + 1
            continue
        token = _TOKEN.match(text, at)
        if token is None:
            return [], at
        at = token.end()
        if token["open"]:
            inner, at = _alternatives(text, at)
            if not inner or text[at : at + 1] != ")":
                return [], at
            at += 1
        else:
            inner = [_ANY if token["any"] else _SEGMENT if token["segment"] else token["escaped"] or token["plain"]]
        if text[at : at + 1] in ("*", "+", "?", "{") or len(now) * len(inner) > _MOST:
            return [], at
        now = ["".join(each) for each in product(now, inner)]
    return done + now, at


def _as_patterns(branch: str) -> list[str]:
    """Write a name with wildcards as patterns: ``.*`` within a segment may end there, or go on into other segments."""
    choices: list[list[str]] = []
    for segment in branch.removeprefix("/").split("/"):  # ``.*`` at the very beginning has the first slash in it
        pieces = re.split(f"({_ANY})", segment.replace(_SEGMENT, "*"))
        for at, piece in enumerate(pieces):
            if piece != _ANY:
                choices.append([piece])
            elif not any(pieces[:at]):  # begins the segment
                choices.append(["**" if not any(pieces[at + 1 :]) else "**/*"])
            else:
                choices.append(["*", "*/**" if not any(pieces[at + 1 :]) else "*/**/*"])
        choices.append(["/"])
    return [re.sub(r"(/\*\*)+(?=/|$)", "/**", "/" + "".join(each)[:-1]) for each in product(*choices)]

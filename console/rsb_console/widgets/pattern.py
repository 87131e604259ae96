"""The filter language: terms that must match, and terms with ``!`` that must not."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

COLUMNS = ("state", "kind", "topic", "robot", "group", "via", "type", "why")
_TERM = re.compile(rf"(?P<not>!*)(?:(?P<column>{'|'.join(COLUMNS)}):)?(?P<text>.*)", re.IGNORECASE)


class PatternError(ValueError):
    """Not a regular expression; the message says where."""


class _Term(NamedTuple):
    """One term of a filter.

    Attributes:
        column: to search, or an empty string for all columns.
        regex: to search for.
        excludes: whether it must not match.
    """

    column: str
    regex: re.Pattern[str]
    excludes: bool


@dataclass(frozen=True)
class Pattern:
    """A filter: ``state:down robot1 !scan``. All terms must match; one with ``!`` must not.

    Each term is a regular expression without spaces. It searches one column if it begins with that column's name, and
    otherwise all. A term without text, such as a single ``!``, is ignored.

    Attributes:
        text: as typed, without the slash.
    """

    text: str
    _terms: tuple[_Term, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_terms", tuple(filter(None, map(_term, self.text.split()))))

    @classmethod
    def or_plain(cls, text: str) -> Pattern:
        """Read `text` as a filter, or as plain words if it is not a valid one."""
        try:
            return cls(text)
        except PatternError:
            return cls(" ".join(map(re.escape, text.split())))

    def __bool__(self) -> bool:
        return bool(self._terms)

    def matches(self, columns: Mapping[str, str], hidden: Collection[str] = ()) -> bool:
        """Whether to show a line.

        Args:
            columns: texts by the column's name; ``""`` is for what has no column of its own.
            hidden: columns that only their name finds.
        """
        anywhere = [text for name, text in columns.items() if name not in hidden]
        return all(
            any(map(term.regex.search, [columns.get(term.column, "")] if term.column else anywhere))
            is not term.excludes
            for term in self._terms
        )


def _term(typed: str) -> _Term | None:
    parts = _TERM.fullmatch(typed)
    if parts is None or not parts["text"]:
        return None
    try:
        regex = re.compile(parts["text"], re.IGNORECASE)
    except re.error as error:
        raise PatternError(f"not a regular expression: {error}") from None
    return _Term((parts["column"] or "").lower(), regex, bool(parts["not"]))

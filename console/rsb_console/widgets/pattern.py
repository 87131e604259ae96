"""What an operator typed after ``/``: text to look for everywhere, or in one column."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

COLUMNS = ("state", "kind", "topic", "robot", "group", "via", "type", "why")
_COLUMN = re.compile(rf"(?<!\S)({'|'.join(COLUMNS)}):(\S*)\s*", re.IGNORECASE)


class PatternError(ValueError):
    """Not a regular expression; the message says where."""


@dataclass(frozen=True)
class Pattern:
    """A filter: ``state:down robot:robot1 scan``. All of its parts must match; a leading ``!`` inverts it.

    A part with a column's name is a regular expression for that column; the rest is one for any of them.

    Attributes:
        text: as typed, without the slash.
    """

    text: str
    inverted: bool = field(init=False)
    _parts: tuple[tuple[str, re.Pattern[str]], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        inverted = self.text.startswith("!")
        text = self.text[inverted:]
        parts = [(name.lower(), value) for name, value in _COLUMN.findall(text) if value]
        rest = _COLUMN.sub("", text)
        try:
            compiled = [(name, re.compile(value, re.IGNORECASE)) for name, value in parts]
            if rest.strip():
                compiled.append(("", re.compile(rest.rstrip() if parts else rest, re.IGNORECASE)))
        except re.error as error:
            raise PatternError(f"not a regular expression: {error}") from None
        object.__setattr__(self, "inverted", inverted)
        object.__setattr__(self, "_parts", tuple(compiled))

    def matches(self, columns: Mapping[str, str], hidden: Collection[str] = ()) -> bool:
        """Whether to show a line.

        Args:
            columns: texts by the column's name; ``""`` is for what has no column of its own.
            hidden: columns that only their name finds.
        """
        anywhere = [text for name, text in columns.items() if name not in hidden]
        found = all(
            any(map(regex.search, anywhere)) if not name else regex.search(columns.get(name, "")) is not None
            for name, regex in self._parts
        )
        return found is not self.inverted

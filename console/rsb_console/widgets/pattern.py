"""What an operator typed after ``/``: a regular expression, inverted by a leading ``!``."""

from __future__ import annotations

import re
from dataclasses import dataclass, field


class PatternError(ValueError):
    """Not a regular expression; the message says where."""


@dataclass(frozen=True)
class Pattern:
    """A filter.

    Attributes:
        text: as typed, without the slash.
    """

    text: str
    inverted: bool = field(init=False)
    _regex: re.Pattern[str] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        inverted = self.text.startswith("!")
        try:
            regex = re.compile(self.text[inverted:], re.IGNORECASE)
        except re.error as error:
            raise PatternError(f"not a regular expression: {error}") from None
        object.__setattr__(self, "inverted", inverted)
        object.__setattr__(self, "_regex", regex)

    def matches(self, text: str) -> bool:
        """Whether `text` is to be shown."""
        return (self._regex.search(text) is None) is self.inverted

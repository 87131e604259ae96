"""Tables of the texts that operators read: each has a code, so that rewording it is one edit."""

from __future__ import annotations

from enum import Enum


class Wording(Enum):
    """A table of texts. A member's name is its code; its value is a template in the syntax of `str.format`.

    Each concept has one table, in the module that uses it. Programs and tests may rely on a code and its parameters;
    the text is for people and may change. A short text that one place uses, and no test, is written there.

    Example:
        >>> class Broken(Wording):
        ...     TOO_LONG = "a frame of {length} bytes; the limit is {limit}"
        >>> Broken.TOO_LONG(length=9, limit=8)
        'a frame of 9 bytes; the limit is 8'
    """

    def __call__(self, **parameters: object) -> str:
        """Fill the template.

        Raises:
            KeyError: a parameter is missing.
        """
        template: str = self.value
        return template.format(**parameters)

"""The terminal's background: asked for once (OSC 11), as a theme of the terminal's own colours has to suit it.

The answer comes among the keys, at any time or never, so nobody waits for it.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

QUESTION: Final = "\x1b]11;?\x07"
_ANSWER: Final = re.compile(r"\]11;rgba?:([\da-f]+)/([\da-f]+)/([\da-f]+)(?:/[\da-f]+)?(?:\x07|\x1b\\)", re.IGNORECASE)
_BEGINNING: Final = "]11;rgb"
_LONGEST: Final = 40  # characters of an answer; a longer text is none
_TERMINALS: Final = ("xterm", "rxvt", "screen", "tmux", "konsole", "gnome", "vte", "putty")
"""The beginnings of TERM of terminals that swallow such a question even if they have no answer."""
_WEIGHTS: Final = (0.299, 0.587, 0.114)
"""Of red, green and blue in the brightness (ITU-R BT.601)."""


def can_be_asked(environ: Mapping[str, str]) -> bool:
    return environ.get("TERM", "").startswith(_TERMINALS)


def is_light(answer: str) -> bool | None:
    """Whether a whole answer, without its Escape, names a light colour, or None if it is no such answer."""
    found = _ANSWER.fullmatch(answer)
    if found is None:
        return None
    shares = [int(digits, 16) / float(16 ** len(digits) - 1) for digits in found.groups()]
    brightness = sum(weight * share for weight, share in zip(_WEIGHTS, shares, strict=True))
    return brightness > 0.5


def may_become_answer(text: str) -> bool:
    """Whether a text may be the beginning of an answer, without its Escape."""
    return len(text) < _LONGEST and (_BEGINNING.startswith(text) or text.startswith(_BEGINNING))

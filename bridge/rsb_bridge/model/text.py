"""Text from outside, made fit for terminals, logs and messages; and standard output for text of our own only."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import unicodedata
from typing import TYPE_CHECKING

from rsb_bridge.model.limits import REASON_LENGTH

if TYPE_CHECKING:
    from collections.abc import Sequence

UNPRINTABLE = (
    "\\x00-\\x1f\\x7f-\\x9f\\u2028\\u2029\\ufff9-\\ufffb"
    "\\u00ad\\u034f\\u061c\\u115f\\u1160\\u17b4\\u17b5\\u180b-\\u180f\\u200b-\\u200f\\u202a-\\u202e\\u2060-\\u206f"
    "\\u3164\\ufe00-\\ufe0f\\ufeff\\uffa0\\ufff0-\\ufff8\\U0001bca0-\\U0001bca3\\U0001d173-\\U0001d17a\\U000e0000-\\U000e0fff"
)
"""What text from elsewhere must not have, for a regular expression's brackets.

Control characters, ends of lines, and what Unicode calls default ignorable (DerivedCoreProperties.txt): marks that turn
the direction of text, and characters that take no place on a screen, of which Python calls some printable.
"""

_unprintable = re.compile(f"[{UNPRINTABLE}\\ud800-\\udfff]")
_not_in_lines = re.compile(f"(?![\\n\\t]|\\r\\n)[{UNPRINTABLE}\\ud800-\\udfff]")
_escaped = re.compile(f'[{UNPRINTABLE}\\\\"]')


def sanitize_text(text: str, limit: int = REASON_LENGTH) -> str:
    """Replace each unprintable character by U+FFFD, and cut what is longer than `limit` characters."""
    return _unprintable.sub("\N{REPLACEMENT CHARACTER}", text[:limit])


def single_cells(text: str) -> str:
    """Replace each character that takes no cell of a terminal, or two, by U+FFFD."""
    if text.isascii():
        return text
    others = {ord(each): "\N{REPLACEMENT CHARACTER}" for each in set(text) if not _takes_one_cell(each)}
    return text.translate(others) if others else text


def _takes_one_cell(character: str) -> bool:
    if unicodedata.east_asian_width(character) in "WF" or unicodedata.category(character) in ("Mn", "Me", "Cf"):
        return False
    return not "\u1160" <= character <= "\u11ff"  # vowels and final consonants that join a Hangul syllable


def is_clean(text: str) -> bool:
    """Whether a text has no unprintable characters."""
    return _unprintable.search(text) is None


def one_line(text: str) -> str:
    """Replace each unprintable character, ends of lines too, by an escape sequence of Python's."""
    return _unprintable.sub(_escape_match, text)


def several_lines(text: str) -> str:
    """Do as `one_line`, but keep ends of lines and tabs. A carriage return stays only right before an end of line."""
    return _not_in_lines.sub(_escape_match, text)


def escape_json(text: str) -> str:
    """Replace each unprintable character in the strings of a JSON text by JSON's own escape sequence."""
    return _not_in_lines.sub(_json_escape, text)


def _escape_match(match: re.Match[str]) -> str:
    return match[0].encode("unicode_escape").decode()


def _json_escape(match: re.Match[str]) -> str:
    code = ord(match[0])
    if code < 0x10000:
        return f"\\u{code:04x}"
    code -= 0x10000
    return f"\\u{0xD800 + (code >> 10):04x}\\u{0xDC00 + (code & 0x3FF):04x}"


def encodable(text: str) -> str:
    """Make a path's text valid UTF-8; invalid bytes become escape sequences."""
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode()


def escape_text(text: str) -> str:
    """Write text in such a way that every character of it is seen, and none does anything to a terminal.

    What is not printable, has no width or turns the direction of text stands as an escape sequence of Python's, as do
    quotation marks and backslashes, so that what is shown between quotation marks is clear.
    """
    if text.isprintable() and not _escaped.search(text):
        return text
    return "".join(
        character if character.isprintable() and not _escaped.match(character) else _escape(character)
        for character in text
    )


def _escape(character: str) -> str:
    return f"\\{character}" if character in '"\\' else character.encode("unicode_escape").decode()


def plural(count: int, noun: str) -> str:
    """Return the noun in the form for a count: ``topic`` for 1, otherwise ``topics``."""
    return noun if count == 1 else f"{noun}s"


def join_first(parts: Sequence[str], most: int) -> str:
    """Join parts: ``a and b``, ``a, b and c``; beyond `most` parts, shorten: ``a, b, c and 2 more``."""
    shown = [*parts[:most]]
    if (more := len(parts) - most) > 0:
        shown.append(f"{more} more")
    return " and ".join(filter(None, (", ".join(shown[:-1]), *shown[-1:])))


def keep_output_clean() -> None:
    """Keep standard output for the program's own lines; libraries such as Fast DDS write to standard error then."""
    with contextlib.suppress(OSError):  # one of the two is closed
        sys.stdout.flush()
        own = os.dup(1)
        os.dup2(2, 1)
        sys.stdout = os.fdopen(own, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)

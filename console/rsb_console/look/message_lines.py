"""A decoded message as lines of YAML, short enough to be read; and one that nobody can decode as hex."""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.cdr.decoder import Items
from rsb_bridge.model.text import escape_text
from rsb_console.look import formats

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.cdr.decoder import Message, Value

Line: TypeAlias = tuple[tuple[str, str], ...]
"""As in `rsb_console.widgets.lines`: pieces of text, each with the name of its look."""

INDENT = "  "
_ITEM = "- "
_NARROWEST = 20  # cells for a value, however deep it stands
_BYTES_IN_LINE = 16


def message_lines(message: Message, width: int, *, arrays: bool = True) -> Iterator[Line]:
    """A message as YAML. Text in it is escaped: it may come from anywhere.

    Args:
        message: decoded.
        width: cells at which arrays and strings are wrapped.
        arrays: show the elements of arrays; False: only their type and length.
    """
    for name, value in message.items():
        yield from _field(f"{escape_text(name)}: ", "", value, width, arrays=arrays)


def _field(label: str, before: str, value: Value, width: int, *, arrays: bool) -> Iterator[Line]:
    """A value behind its label; its further lines stand under it."""
    indent = " " * len(before)
    if isinstance(value, dict):
        yield ((before, ""), (label.rstrip(), "key"), ("" if value else " {}", ""))
        for name, inner in value.items():
            yield from _field(f"{escape_text(name)}: ", indent + INDENT, inner, width, arrays=arrays)
    elif isinstance(value, Items):
        yield from _items(label, before, value, width, arrays=arrays)
    else:
        room = max(_NARROWEST, width - len(before) - len(label))
        first, *more = _chunks(scalar(value), room)
        yield ((before, ""), (label, "key"), (first, ""))
        yield from (((indent + " " * len(label) + each, ""),) for each in more)


def _items(label: str, before: str, items: Items, width: int, *, arrays: bool) -> Iterator[Line]:
    indent = " " * len(before)
    element = escape_text(items.element)
    if not arrays:
        yield ((before, ""), (label, "key"), (f"'<{element}[{items.total}]>'", "dim"))
        return
    shortened = len(items.shown) < items.total
    note = f"  # {formats.thousands(len(items.shown))} of {formats.thousands(items.total)} {element}"
    nested = [each for each in items.shown if isinstance(each, dict)]
    if nested:
        yield ((before, ""), (label.rstrip(), "key"), (note if shortened else "", "dim"))
        for each in nested:
            yield from _element(each, indent, width, arrays=arrays)
        return
    words = [scalar(each) for each in items.shown] + ["…"] * shortened
    room = max(_NARROWEST, width - len(before) - len(label) - 2)
    beside = not shortened or sum(map(len, words)) + 2 * len(words) + len(note) <= room
    if beside:
        start: Line = ((before, ""), (label, "key"), ("[", ""))
    else:  # the note stands above: behind the elements there would be no room for it
        yield ((before, ""), (label.rstrip(), "key"), (note, "dim"))
        start = ((f"{indent}{INDENT}[", ""),)
        room = max(_NARROWEST, width - len(indent) - len(INDENT) - 2)
    margin = " " * sum(len(text) for text, _ in start)
    rows = list(_rows(words, room))
    for number, row in enumerate(rows):
        last = number == len(rows) - 1
        end = (("]", ""), (note if shortened and beside else "", "dim")) if last else ()
        yield (*(start if number == 0 else ((margin, ""),)), (row, ""), *end)


def _element(message: Message, indent: str, width: int, *, arrays: bool) -> Iterator[Line]:
    """A message in an array: its first field stands behind a dash."""
    before = indent + _ITEM
    for name, value in message.items():
        yield from _field(f"{escape_text(name)}: ", before, value, width, arrays=arrays)
        before = indent + INDENT
    if not message:
        yield ((f"{before}{{}}", ""),)


def _rows(words: Sequence[str], room: int) -> Iterator[str]:
    """Words with commas between them, in rows of at most `room` characters, or of one word."""
    row = ""
    for number, word in enumerate(words):
        piece = word if number == len(words) - 1 else f"{word}, "
        if row and len(row) + len(piece) > room:
            yield row
            row = ""
        row += piece
    yield row


def _chunks(text: str, room: int) -> list[str]:
    return [text[at : at + room] for at in range(0, len(text), room)] or [""]


def scalar(value: Value) -> str:
    """One value, as YAML has it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return number_text(value)
    return f'"{escape_text(value)}"' if isinstance(value, str) else str(value)


def number_text(value: float) -> str:
    """A floating-point number with as few digits as tell it from its neighbours; of a 32-bit one, among those."""
    if math.isnan(value):
        return ".nan"
    if math.isinf(value):
        return ".inf" if value > 0 else "-.inf"
    if abs(value) < 1e38 and _as_32_bits(value) == value:
        for digits in (6, 7, 8):
            text = f"{value:.{digits}g}"
            if _as_32_bits(float(text)) == value:
                return text if any(mark in text for mark in ".e") else f"{text}.0"
    return repr(value)


def _as_32_bits(value: float) -> float:
    narrow: float = struct.unpack("f", struct.pack("f", value))[0]
    return narrow


def hex_lines(payload: bytes, most: int) -> Iterator[Line]:
    """The first `most` bytes, sixteen a line, with what of them is ASCII."""
    for at in range(0, min(most, len(payload)), _BYTES_IN_LINE):
        row = payload[at : at + _BYTES_IN_LINE]
        characters = "".join(chr(byte) if 0x20 <= byte < 0x7F else "." for byte in row)
        digits = f"{row[:8].hex(' ')}  {row[8:].hex(' ')}"
        yield ((f"{at:08x}  ", "dim"), (f"{digits:<{3 * _BYTES_IN_LINE}}  ", ""), (characters, "dim"))
    if len(payload) > most:
        yield ((f"… {formats.thousands(len(payload) - most)} bytes more", "dim"),)


def plain(line: Line) -> str:
    """A line's text."""
    return "".join(text for text, _ in line).rstrip()

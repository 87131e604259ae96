"""A message for an operator: as lines of YAML if its type is available, otherwise as hex."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.cdr.decoder import HEADER_LENGTH, Decoded, Items, decode
from rsb_bridge.cdr.description import DescriptionError, read_description
from rsb_bridge.model.text import escape_text
from rsb_bridge.model.wording import Wording
from rsb_console.notation import formats

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rsb_bridge.cdr.decoder import Message, Value
    from rsb_bridge.model.snapshot import PeekedMessage

_SURE = 1e-3
"""s by which a stamp may be ahead of the clock for other reasons than clocks that differ."""
_NO_LATENCY = 60.0
"""s beyond which a stamp's age is no latency: it is an old message, or the clocks differ. A round figure."""
_GUESSED_WITHIN = 86_400.0
"""s from now within which eight bytes of an unknown type are taken for a stamp."""
_LONGEST_FRAME_ID = 256  # bytes. A round figure: the longer it may be, the sooner noise looks like a stamp
_ASK_AGAIN_AFTER = 10.0  # s. A round figure: a type that becomes known meanwhile shows so much later
Line: TypeAlias = tuple[tuple[str, str], ...]
"""As in `rsb_console.widgets.lines`: pieces of text, each with the name of its look."""
INDENT = "  "
_ITEM = "- "
_NARROWEST = 20  # cells for a value, however deep it stands
_BYTES_IN_LINE = 16


class StampText(Wording):
    """Explanations of a message's stamp, and of how old it is."""

    KEPT = "the message was kept for late joiners"
    NOT_SET = "the stamp is not set"
    AHEAD = "clocks differ: the stamp is {span} ahead"
    OLD = "the stamp is {age} old: an old message, simulated time, or clocks differ"
    CLOCKS_OF_PUBLISHER = "from the publisher's clock to this machine's"
    CLOCKS_OF_PEER = "from the other side's clock to this machine's, corrected for their difference"
    GUESSED = "header.stamp (by the look of it)"
    AGE = "{stamp} {span} before ({clocks})"


class ArrivalText(Wording):
    """Descriptions of when and how a message came."""

    FROM_ROS = "{size}, taken from ROS{took} at {moment}"
    OVER_LINK = "{size}, came over the link{took} at {moment}"


@dataclass(frozen=True, slots=True)
class StampAge:
    """The age of a message's ``header.stamp`` at its arrival.

    Attributes:
        stamp: ns since the epoch.
        latency: s, or None if the clocks differ or the age is not a latency.
        why_none: reason why `latency` is None.
        clocks: the two clocks that the latency compares.
        guessed: whether the stamp is a guess: the type is unavailable, and the bytes look like a stamp.
    """

    stamp: int
    latency: float | None
    why_none: str
    clocks: str
    guessed: bool = False


@dataclass(frozen=True, slots=True)
class ReadMessage:
    """A message and its decoded content.

    Attributes:
        decoded: its content, or None if the type is unavailable.
        problem: reason why it was not read to its end, or an empty string.
        age: age of its stamp, or None without a stamp.
    """

    peeked: PeekedMessage
    decoded: Decoded | None
    problem: str
    age: StampAge | None


class KnownTypes:
    """A cache of type descriptions; a missing one is remembered for some seconds."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._known: dict[str, tuple[str | None, str]] = {}
        self._ask_at: dict[str, float] = {}

    def get(self, type_hash: str) -> tuple[str | None, str] | None:
        """Return a type's description or the reason for its lack, or None if it has to be requested."""
        if self._now() >= self._ask_at.get(type_hash, math.inf):
            return None
        return self._known.get(type_hash)

    def put(self, type_hash: str, description: str | None, why: str) -> tuple[str | None, str]:
        self._ask_at[type_hash] = math.inf if description is not None else self._now() + _ASK_AGAIN_AFTER
        self._known[type_hash] = description, why
        return description, why


def read_message(
    peeked: PeekedMessage, description: str | None, why: str = "", *, items: int = 128, steps: int = 50_000
) -> ReadMessage:
    """Read a message.

    Args:
        description: the text of its type's description, or None if unavailable.
        why: reason why `description` is None.
        items: elements of an array that are kept.
        steps: values that are read at most.
    """
    decoded = None
    if description is not None:
        try:
            decoded = decode(read_description(description, peeked.type_hash), peeked.payload, items=items, steps=steps)
        except DescriptionError as error:
            why = str(error)
    if decoded is None:
        guess = _guessed_stamp(peeked)
        return ReadMessage(peeked, None, why, None if guess is None else _age(peeked, guess, guessed=True))
    problem = decoded.problem
    if problem and peeked.size > len(peeked.payload):
        shown = formats.thousands(len(peeked.payload))
        problem = f"only the first {shown} of {formats.thousands(peeked.size)} bytes are shown"
    stamp = _stamp(decoded.message)
    return ReadMessage(peeked, decoded, problem, None if stamp is None else _age(peeked, stamp))


def _stamp(message: Message) -> int | None:
    """Return the stamp of a message's header, or its own, in ns."""
    header: Value = message.get("header", message)
    stamp = header.get("stamp") if isinstance(header, dict) else None
    if not isinstance(stamp, dict):
        return None
    seconds, nanoseconds = stamp.get("sec"), stamp.get("nanosec")
    if not isinstance(seconds, int) or not isinstance(nanoseconds, int):
        return None
    return seconds * 10**9 + nanoseconds


def _guessed_stamp(peeked: PeekedMessage) -> int | None:
    """Guess the stamp of a message of an unknown type, if it begins with a time of today and a frame."""
    # These are the headers of plain CDR; other encodings may have the fields elsewhere.
    order = {b"\x00\x00": ">", b"\x00\x01": "<"}.get(peeked.payload[:2])
    if order is None or len(peeked.payload) < HEADER_LENGTH + 12:
        return None
    seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", peeked.payload, HEADER_LENGTH)
    frame_id = peeked.payload[HEADER_LENGTH + 12 :][:length]
    looks_right = (
        abs(seconds - peeked.time) < _GUESSED_WITHIN
        and nanoseconds < 10**9
        and 1 <= length <= _LONGEST_FRAME_ID
        and len(frame_id) == length
        and frame_id.endswith(b"\x00")
        and frame_id[:-1].isascii()
    )
    return seconds * 10**9 + nanoseconds if looks_right else None


def _age(peeked: PeekedMessage, stamp: int, *, guessed: bool = False) -> StampAge:
    if peeked.is_kept:
        return StampAge(stamp, None, StampText.KEPT(), "", guessed)
    clocks = StampText.CLOCKS_OF_PUBLISHER()
    latency = peeked.time - stamp / 1e9
    if (offset := peeked.clock_offset) is not None:  # the other side's, where the publisher most likely is
        latency += offset
        clocks = StampText.CLOCKS_OF_PEER()
    unsure = _SURE + (peeked.clock_uncertainty or 0.0)
    if stamp <= 0:
        return StampAge(stamp, None, StampText.NOT_SET(), "", guessed)
    if latency < -unsure:
        why = StampText.AHEAD(span=formats.span(-latency))
        return StampAge(stamp, None, why, "", guessed)
    if latency > _NO_LATENCY:
        why = StampText.OLD(age=formats.age(latency))
        return StampAge(stamp, None, why, "", guessed)
    return StampAge(stamp, max(latency, 0.0), "", clocks, guessed)


def age_text(age: StampAge) -> str:
    """Return the age of a stamp in words."""
    name = StampText.GUESSED() if age.guessed else "header.stamp"
    if age.latency is None:
        return f"{name}: {age.why_none}"
    return StampText.AGE(stamp=name, span=formats.span(age.latency), clocks=age.clocks)


def how_it_came(peeked: PeekedMessage) -> str:
    """Return when and how a message came, in words."""
    size = f"{formats.thousands(peeked.size)} B"
    if peeked.is_kept:
        return f"{size}, kept for late joiners"
    moment = f"{formats.time_of_day(peeked.time)}.{int(peeked.time % 1 * 1000):03d}"
    took = "" if peeked.latency is None else f" in {formats.latency(peeked.latency, peeked.clock_uncertainty)}"
    way = ArrivalText.FROM_ROS if peeked.outgoing else ArrivalText.OVER_LINK
    return way(size=size, took=took, moment=moment)


def message_lines(message: Message, width: int, *, arrays: bool = True) -> Iterator[Line]:
    """Format a message as YAML. Its text is escaped, as it is not trusted.

    Args:
        width: cells at which arrays and strings are wrapped.
        arrays: show the elements of arrays rather than only their type and length.
    """
    for name, value in message.items():
        yield from _field(f"{escape_text(name)}: ", "", value, width, arrays=arrays)


def _field(label: str, before: str, value: Value, width: int, *, arrays: bool) -> Iterator[Line]:
    """Yield a value after its label, with further lines below."""
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
    """Yield a message in an array: its first field follows a dash."""
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
    """Format one value as YAML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return number_text(value)
    return f'"{escape_text(value)}"' if isinstance(value, str) else str(value)


def number_text(value: float) -> str:
    """Format a floating-point number with the fewest digits that identify it, among 32-bit ones if it is one."""
    if math.isnan(value):
        return ".nan"
    if math.isinf(value):
        return ".inf" if value > 0 else "-.inf"
    # `struct` refuses what 32 bits cannot hold, from 3.4e38 on.
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
    """Yield the first `most` bytes, sixteen a line, with their ASCII characters."""
    for at in range(0, min(most, len(payload)), _BYTES_IN_LINE):
        row = payload[at : at + _BYTES_IN_LINE]
        characters = "".join(chr(byte) if 0x20 <= byte < 0x7F else "." for byte in row)
        digits = f"{row[:8].hex(' ')}  {row[8:].hex(' ')}"
        yield ((f"{at:08x}  ", "dim"), (f"{digits:<{3 * _BYTES_IN_LINE}}  ", ""), (characters, "dim"))
    if len(payload) > most:
        yield ((f"… {formats.thousands(len(payload) - most)} bytes more", "dim"),)


def plain(line: Line) -> str:
    return "".join(text for text, _ in line).rstrip()

"""Makes new inputs of old ones. A document is edited as a document, so that its readers get past its form."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from random import Random
from typing import Any

import msgspec

_LENGTH_BYTES = 4
_NUMBERS = (
    0, 1, -1, 2, 15, 16, 127, 128, 255, 256, 1023, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**53, 2**53 + 1,
    2**63 - 1, -(2**63), 2**64 - 1, 0.0, -0.0, 1e-9, 0.5, 1e9, 1e300, 5e-324, math.nan, math.inf, -math.inf,
)  # fmt: skip
_TEXTS = (
    "", "/", "/scan", "robot1", "a" * 300, "\x1b[2J", "a\nb", "\u202e", "\u200b", "=1+1", "ü", "\U0001f916", "\0",
    "{lasting}", "..", "~", "none", "tcp", "rsb_a_1/scan", "RIHS01_" + "0" * 64, "00:11:22:33:44:55",
)  # fmt: skip
_OTHERS: tuple[Any, ...] = (None, True, False, [], {}, b"", bytes(8), bytes(16), bytes(40), [[]], {"": None}, [0] * 100)


def edit_bytes(data: bytes, random: Random) -> bytes:
    """Some bytes of any input are removed, repeated, replaced or put in."""
    edited = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 4))):
        at = random.randint(0, len(edited))
        stop = min(len(edited), at + random.choice((1, 1, 2, 4, 8, 40)))
        match random.randrange(5):
            case 0:
                del edited[at:stop]
            case 1:
                edited[at:at] = edited[at:stop]
            case 2:
                edited[at:stop] = random.randbytes(stop - at)
            case 3:
                size = random.choice((1, 2, 4, 8))
                number = random.choice([each for each in _NUMBERS if isinstance(each, int) and each >= 0])
                edited[at : at + size] = (number & (256**size - 1)).to_bytes(size, random.choice(("big", "little")))
            case _:
                edited[at:at] = random.choice(_TEXTS).encode()
    return bytes(edited)


def edit_text(data: bytes, random: Random) -> bytes:
    """Lines of a text are removed, repeated, moved, indented, or edited as bytes."""
    lines = data.split(b"\n")
    at, other = random.randrange(len(lines)), random.randrange(len(lines))
    match random.randrange(6):
        case 0:
            del lines[at]
        case 1:
            lines.insert(other, lines[at])
        case 2:
            lines[at], lines[other] = lines[other], lines[at]
        case 3:
            lines[at] = b"  " * random.randint(0, 3) + lines[at].lstrip()
        case 4:
            key, colon, _ = lines[at].partition(b":")
            lines[at] = key + colon + b" " + str(random.choice((*_NUMBERS, *_TEXTS, *_OTHERS))).encode()
        case _:
            lines[at] = edit_bytes(lines[at], random)
    return b"\n".join(lines)


def edit_msgpack(data: bytes, random: Random) -> bytes:
    return _edit_document(data, random, msgspec.msgpack.decode, msgspec.msgpack.encode)


def edit_json(data: bytes, random: Random) -> bytes:
    return _edit_document(data, random, json.loads, lambda value: json.dumps(value, default=str).encode())


def edit_json_lines(data: bytes, random: Random) -> bytes:
    """Edit one line of several, like `edit_json`."""
    lines = data.split(b"\n")
    at = random.randrange(len(lines))
    lines[at] = edit_json(lines[at], random)
    return b"\n".join(lines)


def edit_frames(data: bytes, random: Random) -> bytes:
    """Edit one of several documents, each preceded by its length, like `edit_msgpack`."""
    frames = split_frames(data)
    if not frames:
        return edit_bytes(data, random)
    at = random.randrange(len(frames))
    match random.randrange(6):
        case 0:
            del frames[at]
        case 1:
            frames.insert(random.randint(0, len(frames)), frames[at])
        case _:
            frames[at] = edit_msgpack(frames[at], random)
    return b"".join(len(frame).to_bytes(_LENGTH_BYTES, "big") + frame for frame in frames)


def behind(prefix: int, edit: Callable[[bytes, Random], bytes]) -> Callable[[bytes, Random], bytes]:
    """Return an editor of the bytes behind a prefix of so many bytes; now and then the prefix changes, too."""

    def edit_behind(data: bytes, random: Random) -> bytes:
        head = data[:prefix].ljust(prefix, b"\0")
        head = random.randbytes(prefix) if random.randrange(10) == 0 else head
        return head + edit(data[prefix:], random)

    return edit_behind


def split_frames(data: bytes) -> list[bytes]:
    """Frames of four bytes of length and a content; what is incomplete is left out."""
    frames = []
    while len(data) >= _LENGTH_BYTES:
        end = _LENGTH_BYTES + int.from_bytes(data[:_LENGTH_BYTES], "big")
        if end > len(data):
            break
        frames.append(data[_LENGTH_BYTES:end])
        data = data[end:]
    return frames


def _edit_document(
    data: bytes, random: Random, decode: Callable[[bytes], Any], encode: Callable[[Any], bytes]
) -> bytes:
    if random.randrange(8) == 0:
        return edit_bytes(data, random)
    try:
        edited = _edit_value(decode(data), random)
        return encode(edited)
    except (ValueError, TypeError, OverflowError, RecursionError):
        return edit_bytes(data, random)


def _edit_value(value: Any, random: Random) -> Any:
    """Go down into the document at random, and change something there."""
    if isinstance(value, dict) and value and random.randrange(8):
        key = random.choice(list(value))
        match random.randrange(12):
            case 0:
                return {other: each for other, each in value.items() if other != key}
            case 1:
                return {**value, random.choice(_TEXTS): value[key]}
            case _:
                return {**value, key: _edit_value(value[key], random)}
    if isinstance(value, list) and value and random.randrange(8):
        at = random.randrange(len(value))
        match random.randrange(10):
            case 0:
                return value[:at] + value[at + 1 :]
            case 1:
                return value + [value[at]] * random.choice((1, 3, 40))
            case _:
                return [*value[:at], _edit_value(value[at], random), *value[at + 1 :]]
    if isinstance(value, bytes) and random.randrange(3):
        return edit_bytes(value, random)
    if isinstance(value, str) and random.randrange(3) == 0:
        return edit_bytes(value.encode(errors="replace"), random).decode(errors="replace")
    if random.randrange(40) == 0:
        return _nested(random.choice((10, 100, 900)))
    return random.choice((*_NUMBERS, *_TEXTS, *_OTHERS))


def _nested(levels: int) -> Any:
    value: Any = 0
    for _ in range(levels):
        value = [value]
    return value

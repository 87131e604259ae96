"""What a message that somebody looks at says: decoded where its type is known, with the age of its stamp."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.cdr.decoder import HEADER_LENGTH, Decoded, decode
from rsb_bridge.cdr.description import DescriptionError, read_description
from rsb_console.look import formats

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.cdr.decoder import Message, Value
    from rsb_bridge.model.snapshot import PeekedMessage

_SURE = 1e-3
"""s by which a stamp may be ahead of the clock for other reasons than clocks that differ."""
_NO_LATENCY = 60.0
"""s beyond which a stamp's age is no latency: it is an old message, or the clocks differ."""
_GUESSED_WITHIN = 86_400.0
"""s from now within which eight bytes of an unknown type are taken for a stamp."""
_LONGEST_FRAME_ID = 256
_ASK_AGAIN_AFTER = 10.0  # s


@dataclass(frozen=True, slots=True)
class StampAge:
    """How old a message's ``header.stamp`` was when the message came.

    Attributes:
        stamp: ns since the epoch.
        latency: s; None: the clocks differ, or it is no latency.
        why_none: why there is no latency.
        clocks: whose clocks the latency is between.
        guessed: the type is not known, and the bytes look like a stamp.
    """

    stamp: int
    latency: float | None
    why_none: str
    clocks: str
    guessed: bool = False


@dataclass(frozen=True, slots=True)
class ReadMessage:
    """A message, as far as it could be read.

    Attributes:
        peeked: the message.
        decoded: None: its type is not known.
        problem: why it was not read to its end; empty: it was.
        age: of its stamp; None: it has none.
    """

    peeked: PeekedMessage
    decoded: Decoded | None
    problem: str
    age: StampAge | None


class KnownTypes:
    """The descriptions that a looker has; for some seconds also that there is none.

    Args:
        now: a clock, in s.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._known: dict[str, tuple[str | None, str]] = {}
        self._ask_at: dict[str, float] = {}

    def get(self, type_hash: str) -> tuple[str | None, str] | None:
        """A type's description, or why there is none; None: somebody has to be asked."""
        if self._now() >= self._ask_at.get(type_hash, math.inf):
            return None
        return self._known.get(type_hash)

    def put(self, type_hash: str, description: str | None, why: str) -> tuple[str | None, str]:
        """Keep what the engine says."""
        self._ask_at[type_hash] = math.inf if description is not None else self._now() + _ASK_AGAIN_AFTER
        self._known[type_hash] = description, why
        return description, why


def read_message(peeked: PeekedMessage, description: str | None, why: str = "", **limits: int) -> ReadMessage:
    """Read a message.

    Args:
        peeked: the message.
        description: the text of its type's description; None: it is not known.
        why: why it is not.
        limits: as of `rsb_bridge.cdr.decoder.decode`.
    """
    decoded = None
    if description is not None:
        try:
            decoded = decode(read_description(description, peeked.type_hash), peeked.payload, **limits)
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
    """The stamp of a message's header, or its own, in ns."""
    header: Value = message.get("header", message)
    stamp = header.get("stamp") if isinstance(header, dict) else None
    if not isinstance(stamp, dict):
        return None
    seconds, nanoseconds = stamp.get("sec"), stamp.get("nanosec")
    if not isinstance(seconds, int) or not isinstance(nanoseconds, int):
        return None
    return seconds * 10**9 + nanoseconds


def _guessed_stamp(peeked: PeekedMessage) -> int | None:
    """The stamp that a message of an unknown type begins with, if it looks like one: a time of today, and a frame."""
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
        return StampAge(stamp, None, "the message was kept for late joiners", "", guessed)
    clocks = "the stamp's publisher's clock to this machine's"
    latency = peeked.time - stamp / 1e9
    if (offset := peeked.clock_offset) is not None:  # the other side's, where the publisher most likely is
        latency += offset
        clocks = "the other side's clock to this machine's, their difference allowed for"
    unsure = _SURE + (peeked.clock_uncertainty or 0.0)
    if stamp <= 0:
        return StampAge(stamp, None, "the stamp is not set", "", guessed)
    if latency < -unsure:
        why = f"clocks differ: the stamp is {formats.span(-latency)} ahead"
        return StampAge(stamp, None, why, "", guessed)
    if latency > _NO_LATENCY:
        why = f"the stamp is {formats.age(latency)} old: an old message, simulated time, or clocks differ"
        return StampAge(stamp, None, why, "", guessed)
    return StampAge(stamp, max(latency, 0.0), "", clocks, guessed)


def age_text(age: StampAge) -> str:
    """The age of a stamp in words."""
    name = "header.stamp (by the look of it)" if age.guessed else "header.stamp"
    if age.latency is None:
        return f"{name}: {age.why_none}"
    return f"{name} {formats.span(age.latency)} before ({age.clocks})"


def how_it_came(peeked: PeekedMessage) -> str:
    """When and how a message came, in words."""
    size = f"{formats.thousands(peeked.size)} B"
    if peeked.is_kept:
        return f"{size}, kept for late joiners"
    moment = f"{formats.time_of_day(peeked.time)}.{int(peeked.time % 1 * 1000):03d}"
    way = "taken from ROS" if peeked.outgoing else "came over the link"
    took = "" if peeked.latency is None else f" in {formats.latency(peeked.latency, peeked.clock_uncertainty)}"
    return f"{size}, {way}{took} at {moment}"

"""Topics of every kind, and messages that can be counted and checked."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

_CDR_HEADER = b"\x00\x01\x00\x00"
_WORDS_BEGIN = 8
"""std_msgs/String in CDR: 4 bytes of encapsulation, 4 of length, the words, a NUL, padding."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A topic that every client has."""

    topic: str
    direction: Literal["transmit", "receive"]
    protocol: Literal["tcp", "udp"]
    rate: float
    size: int = 300
    latched: bool = False
    best_effort: bool = False

    @property
    def keeps_all(self) -> bool:
        """Whether DDS delivers every message: a latched publisher of depth 1 replaces what is not acknowledged yet."""
        return not self.latched and not self.best_effort

    @property
    def spec(self) -> dict[str, Any]:
        return {"topic": self.topic, "direction": self.direction, "protocol": self.protocol}


KINDS = (
    Kind("/scan", "transmit", "udp", 20.0, 2_000, best_effort=True),
    Kind("/odom", "transmit", "tcp", 20.0),
    Kind("/map", "transmit", "tcp", 2.0, 20_000, latched=True),
    Kind("/image", "transmit", "tcp", 2.0, 500_000),
    Kind("/cmd", "receive", "udp", 10.0),
    Kind("/goal", "receive", "tcp", 10.0),
)


class Message(NamedTuple):
    """A message as it came.

    Attributes:
        life: of the talker; a restarted one begins another.
        number: counts up from 1 in that life.
        sent: when it was published, s since the epoch.
    """

    life: int
    number: int
    sent: float
    whole: bool


def encode(life: int, number: int, sent_ns: int, filler: bytes) -> bytes:
    head = b"%d %d %d " % (life, number, sent_ns)
    words = b"%s%d %s" % (head, zlib.crc32(filler, zlib.crc32(head)), filler)
    return _CDR_HEADER + struct.pack("<I", len(words) + 1) + words + b"\0"


def decode(payload: bytes) -> Message:
    try:
        life, number, sent_ns, checksum, filler = payload[_WORDS_BEGIN:].rstrip(b"\0").split(b" ", 4)
        head = b"%s %s %s " % (life, number, sent_ns)
        whole = zlib.crc32(filler, zlib.crc32(head)) == int(checksum)
        return Message(int(life), int(number), int(sent_ns) / 1e9, whole)
    except ValueError:
        return Message(0, 0, 0.0, whole=False)

"""The node that a parameter event is about, an rcl_interfaces/msg/ParameterEvent, serialized."""

from __future__ import annotations

import struct

from rsb_bridge.cdr.decoder import HEADER_LENGTH
from rsb_bridge.model.wording import Wording

LONGEST = 256 << 10
"""Bytes of an event that gets another name: some 2,000 parameters that changed at once. Each takes 10 µs."""

_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # CDR_BE, CDR_LE
_NO_OPTIONS = b"\x00\x00"  # the encapsulation header's: the number of padding bytes at the end
_STAMP = 8
_LISTS = 3  # of parameters: new, changed, deleted
_ARRAYS = (1, 1, 8, 8)  # of a ParameterValue: bytes, bools, integers, doubles; bytes of an element


class InvalidEvent(Wording):
    """The reasons why a message is not a parameter event."""

    TOO_LONG = "it has {length:,} bytes, and at most {limit:,} are looked through"


class ParameterEventError(ValueError):
    """A message is no parameter event; the text says how it shows."""


def node_of(payload: bytes) -> str:
    """Return the full name of the node whose parameters an event is about.

    Args:
        payload: the message with its encapsulation header.

    Raises:
        ParameterEventError: it is none.
    """
    reader = _Reader(payload)
    reader.take(_STAMP, 4)
    name = reader.string()
    if name[-1:] != b"\0":
        raise ParameterEventError("the node's name has no end")
    return name[:-1].decode("utf-8", "replace")


def with_node(payload: bytes, node: str) -> bytes:
    """Return the same event of a node of another name.

    Args:
        payload: the message with its encapsulation header.
        node: the full name to put into it.

    Raises:
        ParameterEventError: it is none, or longer than `LONGEST`.
    """
    if len(payload) > LONGEST:
        raise ParameterEventError(InvalidEvent.TOO_LONG(length=len(payload), limit=LONGEST))
    name = node.encode() + b"\0"
    reader = _Reader(payload)
    stamp = reader.take(_STAMP, 4)
    reader.string()
    copy = _Copy(reader, bytearray(payload[:2] + _NO_OPTIONS + stamp))
    copy.out += struct.pack(f"{reader.order}I", len(name)) + name
    for _ in range(_LISTS):
        for _ in range(copy.length()):
            copy.string()  # the parameter's name
            copy.take(2, 1)  # its type, the bool
            copy.take(8, 8)  # the integer
            copy.take(8, 8)  # the double
            copy.string()
            for size in _ARRAYS:
                if count := copy.length():  # an empty array has no padding before its elements
                    copy.take(count * size, size)
            for _ in range(copy.length()):
                copy.string()
    return bytes(copy.out)


class _Reader:
    """Reads from the beginning on; no step passes over fewer bytes than its own, so that reading ends."""

    def __init__(self, payload: bytes) -> None:
        order = _BYTE_ORDERS.get(payload[:2])
        if order is None or len(payload) < HEADER_LENGTH:
            raise ParameterEventError("it does not begin as XCDR1")
        self.order = order
        self.payload = payload
        self.at = HEADER_LENGTH

    def take(self, size: int, alignment: int) -> bytes:
        start = self.at + (HEADER_LENGTH - self.at) % alignment
        if size > len(self.payload) - start:
            raise ParameterEventError(f"it ends after {len(self.payload):,} bytes, before its content does")
        self.at = start + size
        return self.payload[start : self.at]

    def length(self) -> int:
        (length,) = struct.unpack(f"{self.order}I", self.take(4, 4))
        return int(length)

    def string(self) -> bytes:
        return self.take(self.length(), 1)


class _Copy:
    """Writes what it reads, aligned where it comes to stand."""

    def __init__(self, reader: _Reader, out: bytearray) -> None:
        self._reader = reader
        self.out = out

    def take(self, size: int, alignment: int) -> None:
        content = self._reader.take(size, alignment)
        self.out += bytes((HEADER_LENGTH - len(self.out)) % alignment) + content

    def length(self) -> int:
        length = self._reader.length()
        self.out += bytes((HEADER_LENGTH - len(self.out)) % 4) + struct.pack(f"{self._reader.order}I", length)
        return length

    def string(self) -> None:
        self.take(self.length(), 1)

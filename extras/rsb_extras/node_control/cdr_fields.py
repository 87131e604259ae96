"""Writes and reads the fields of a few serialized messages (CDR), whose types need not be installed here for that."""

from __future__ import annotations

import struct

_LITTLE = b"\x00\x01\x00\x00"
_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
_HEADER = 4
LONGEST_TEXT = 4096
"""Characters of a text that are read; what a node says is longer than that by mistake only."""


class MalformedAnswerError(ValueError):
    """A message is not of its type."""


class FieldWriter:
    """A message to which fields are added in their order."""

    def __init__(self) -> None:
        self._content = bytearray()

    def number(self, code: str, value: float) -> FieldWriter:
        """Add a number by its code of `struct`: ``B ? i I q d``."""
        size = struct.calcsize(code)
        self._content += bytes(-len(self._content) % size) + struct.pack(f"<{code}", value)
        return self

    def text(self, value: str) -> FieldWriter:
        content = value.encode() + b"\0"
        self.number("I", len(content))
        self._content += content
        return self

    @property
    def message(self) -> bytes:
        """The message; one without fields has the byte that ROS puts into structures without members."""
        return _LITTLE + bytes(self._content or b"\0")


class FieldReader:
    """A message of another program, of which fields are taken in their order.

    Raises:
        MalformedAnswerError: here and in each method, the message is cut off or something else.
    """

    def __init__(self, message: bytes) -> None:
        order = _ORDERS.get(message[:2])
        if order is None:
            raise MalformedAnswerError("it is no CDR")
        self._order = order
        self._message = message
        self._at = _HEADER

    def number(self, code: str) -> float:
        """Take a number by its code of `struct`."""
        size = struct.calcsize(code)
        self._at += -(self._at - _HEADER) % size
        (value,) = struct.unpack_from(self._order + code, self._take(size))
        number: float = value
        return number

    def count(self, smallest: int, most: int) -> int:
        """Take the number of elements that follow.

        Args:
            smallest: bytes of an element at least.
            most: elements.
        """
        count = int(self.number("I"))
        if count > most or count * smallest > len(self._message) - self._at:
            raise MalformedAnswerError(f"it says to have {count} elements")
        return count

    def text(self, longest: int | None = LONGEST_TEXT) -> str:
        content = self.octets()[:-1]
        return content[:longest].decode("utf-8", "replace")

    def octets(self) -> bytes:
        """Take a sequence of bytes."""
        return self._take(self.count(1, len(self._message)))

    def numbers(self, code: str, most: int) -> list[float]:
        """Take a sequence of numbers by their code of `struct`."""
        size = struct.calcsize(code)
        count = self.count(size, most)
        if count:
            self._at += -(self._at - _HEADER) % size
        return list(struct.unpack(f"{self._order}{count}{code}", self._take(count * size)))

    def _take(self, size: int) -> bytes:
        taken = self._message[self._at : self._at + size]
        if len(taken) < size:
            raise MalformedAnswerError("it is cut off")
        self._at += size
        return taken

"""Reads serialized messages (XCDR1, OMG DDS-XTYPES 1.3 section 7.4.3) by the descriptions of their types.

Neither the bytes nor the description is trusted: for any input, reading ends after a bounded number of steps. If a part
is unreadable, `Decoded` has the parts before it, and the problem.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias, Union

from rsb_bridge.cdr.description import BOUNDED_STRINGS, KINDS, NESTED, STRINGS, WIDE_CHARACTER, WIDE_STRINGS
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from rsb_bridge.cdr.description import FieldType, TypeDescription

HEADER_LENGTH = 4
"""Bytes of the encapsulation header (DDSI-RTPS 2.5 section 10.2); alignment counts from behind it."""
DEPTH = 64
"""Messages within messages."""

_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # CDR_BE, CDR_LE
_CONTAINERS = _PLAIN, _ARRAY, _BOUNDED, _ = range(4)
_PRIMITIVES = {
    2: ("b", "int8"),
    3: ("B", "uint8"),
    4: ("h", "int16"),
    5: ("H", "uint16"),
    6: ("i", "int32"),
    7: ("I", "uint32"),
    8: ("q", "int64"),
    9: ("Q", "uint64"),
    10: ("f", "float32"),
    11: ("d", "float64"),
    13: ("B", "char"),
    15: ("?", "bool"),
    16: ("B", "byte"),
}
"""By type id: code of `struct`, and name."""


@dataclass(frozen=True, slots=True)
class Items:
    """An array or a sequence.

    Attributes:
        element: the name of its elements' type.
        raw: the bytes of all elements, if they are primitive and were asked for raw.
        code: code of `struct` for one element of `raw`, with the byte order.
    """

    element: str
    total: int
    shown: list[Value] = field(default_factory=list)
    raw: memoryview | None = None
    code: str = ""


Value: TypeAlias = Union[bool, int, float, str, Items, "Message"]
Message: TypeAlias = dict[str, Value]
"""A message's values by its fields' names."""


@dataclass(frozen=True, slots=True)
class Decoded:
    """A message as far as it was read.

    Attributes:
        message: its values, up to the problem.
        problem: the reason why reading ended early, or an empty string.
    """

    message: Message
    problem: str = ""


class Unreadable(Wording):
    """The reason why the next part of a message cannot be read."""

    NOT_XCDR1 = "it does not begin with an XCDR1 header: {beginning}"
    NO_BYTES = "it is empty: not even an XCDR1 header"
    TOO_DEEP = "its type has more than {limit} levels"
    TYPE_MISSING = "its description lacks {type}"
    FIELD = "{field}: {problem}"
    TYPE_UNKNOWN = "a value of type {type} is not decoded"
    SEQUENCE_TOO_LONG = "{length:,} elements in a sequence of at most {limit:,}"
    STRING_TOO_LONG = "a string of {length:,} characters in a field of at most {limit:,}"
    STRING_WITHOUT_END = "a string without its end"
    CHARACTER_TOO_WIDE = "a wide string has characters beyond 16 bits"
    ENDS_EARLY = "{expected:,} bytes are expected; only {left:,} are left"
    TOO_MANY_VALUES = "it has more values than can be shown"


class _UnreadableError(Exception):
    """The next part of a message cannot be read."""


def decode(
    description: TypeDescription, payload: bytes, *, items: int = 128, steps: int = 50_000, raw: bool = False
) -> Decoded:
    """Read a message.

    Args:
        payload: the message with its encapsulation header, or the beginning of it.
        items: elements of an array that are kept.
        steps: values that are read at most.
        raw: give arrays of primitive elements as bytes (`Items.raw`): they count as one value each.
    """
    message: Message = {}
    try:
        reader = _Reader(payload, description, items, steps, raw=raw)
        reader.read_message(description.type_description.type_name, message, DEPTH)
    except _UnreadableError as error:
        return Decoded(message, str(error))
    return Decoded(message)


class _Reader:
    """Reads from the beginning to the end. What fails in it is an _UnreadableError."""

    def __init__(self, payload: bytes, description: TypeDescription, items: int, steps: int, *, raw: bool) -> None:
        order = _BYTE_ORDERS.get(payload[:2])
        if order is None or len(payload) < HEADER_LENGTH:
            text = Unreadable.NOT_XCDR1 if payload else Unreadable.NO_BYTES
            raise _UnreadableError(text(beginning=payload[:HEADER_LENGTH].hex(" ")))
        self._order = order
        self._payload = payload
        self._at = HEADER_LENGTH
        self._items = items
        self._steps = steps
        self._raw = raw
        types = (description.type_description, *description.referenced_type_descriptions)
        self._fields = {each.type_name: each.fields for each in types}

    def read_message(self, type_name: str, message: Message, depth: int) -> None:
        """Read the fields of a message into `message`, one by one."""
        if depth == 0:
            raise _UnreadableError(Unreadable.TOO_DEEP(limit=DEPTH))
        fields = self._fields.get(type_name)
        if fields is None:
            raise _UnreadableError(Unreadable.TYPE_MISSING(type=type_name))
        for each in fields:
            try:
                self._read_field(each.name, each.type, message, depth)
            except _UnreadableError as error:
                text = Unreadable.FIELD(field=each.name, problem=error) if depth == DEPTH else str(error)
                raise _UnreadableError(text) from None

    def _read_field(self, name: str, kind: FieldType, message: Message, depth: int) -> None:
        container, base = divmod(kind.type_id - 1, KINDS)
        base += 1
        if container not in _CONTAINERS:
            raise _UnreadableError(Unreadable.TYPE_UNKNOWN(type=kind.type_id))
        if container == _PLAIN:
            if base == NESTED:
                inner: Message = {}
                # Before its fields are read, so that they stay if a later one is unreadable.
                message[name] = inner
                # A message without fields has no bytes either.
                self._step()
                self.read_message(kind.nested_type_name, inner, depth - 1)
            else:
                message[name] = self._value(base, kind)
            return
        total = kind.capacity if container == _ARRAY else self._length()
        if container == _BOUNDED and total > kind.capacity:
            raise _UnreadableError(Unreadable.SEQUENCE_TOO_LONG(length=total, limit=kind.capacity))
        if base in _PRIMITIVES:
            if self._raw:
                message[name] = self._raw_primitives(base, total)
                return
            items = message[name] = Items(_PRIMITIVES[base][1], total)
            self._primitives(base, items)
            return
        self._step()  # an array of none has no bytes, and there may be very many
        strings = "wstring" if base in WIDE_STRINGS else "string"
        items = message[name] = Items(kind.nested_type_name if base == NESTED else strings, total)
        # Elements beyond the limit are read, too, because the next field begins behind the last one.
        for number in range(total):
            if base == NESTED:
                element: Message = {}
                if number < self._items:
                    items.shown.append(element)
                self._step()
                self.read_message(kind.nested_type_name, element, depth - 1)
            else:
                value = self._value(base, kind)
                if number < self._items:
                    items.shown.append(value)

    def _value(self, base: int, kind: FieldType) -> Value:
        self._step()
        if base in _PRIMITIVES:
            code, _ = _PRIMITIVES[base]
            size = struct.calcsize(f"={code}")
            start = self._take(size, size)
            value: bool | int | float = struct.unpack_from(self._order + code, self._payload, start)[0]
            return value
        if base in STRINGS or base in WIDE_STRINGS:
            return self._string(kind.string_capacity if base in BOUNDED_STRINGS else None, wide=base in WIDE_STRINGS)
        raise _UnreadableError(Unreadable.TYPE_UNKNOWN(type=kind.type_id))

    def _primitives(self, base: int, items: Items) -> None:
        """Read the elements of an array up to the first that is missing."""
        code, _ = _PRIMITIVES[base]
        size = struct.calcsize(f"={code}")
        self._step()
        # Without elements, there is no padding before them.
        if items.total == 0:
            return
        start = self._aligned(size)
        kept = min(items.total, self._items, self._steps, (len(self._payload) - start) // size)
        if kept > 0:
            self._steps -= kept
            items.shown.extend(struct.unpack_from(f"{self._order}{kept}{code}", self._payload, start))
        self._take(size, items.total * size)

    def _raw_primitives(self, base: int, total: int) -> Items:
        code, name = _PRIMITIVES[base]
        size = struct.calcsize(f"={code}")
        self._step()
        start = self._take(size, total * size) if total else self._at
        return Items(name, total, raw=memoryview(self._payload)[start : self._at], code=self._order + code)

    def _string(self, capacity: int | None, *, wide: bool) -> str:
        length = self._length()
        size = length * WIDE_CHARACTER if wide else length
        content = self._payload[(start := self._take(1, size)) : start + size]
        if wide:
            units = struct.unpack(f"{self._order}{length}I", content)
            if any(unit > 0xFFFF for unit in units):
                raise _UnreadableError(Unreadable.CHARACTER_TOO_WIDE())
            text = struct.pack(f"<{length}H", *units).decode("utf-16-le", "replace")
        else:
            # Fast CDR reads strings of length 0, too.
            if content[-1:] not in (b"", b"\x00"):
                raise _UnreadableError(Unreadable.STRING_WITHOUT_END())
            length = max(0, length - 1)
            text = content[:-1].decode("utf-8", "replace")
        if capacity is not None and length > capacity:
            raise _UnreadableError(Unreadable.STRING_TOO_LONG(length=length, limit=capacity))
        return text

    def _length(self) -> int:
        start = self._take(4, 4)
        length: int = struct.unpack_from(f"{self._order}I", self._payload, start)[0]
        return length

    def _take(self, alignment: int, size: int) -> int:
        """Pass over `size` bytes behind the padding; where they begin."""
        start = self._aligned(alignment)
        left = len(self._payload) - start
        if size > left:
            raise _UnreadableError(Unreadable.ENDS_EARLY(expected=size, left=max(0, left)))
        self._at = start + size
        return start

    def _aligned(self, alignment: int) -> int:
        return self._at + (HEADER_LENGTH - self._at) % alignment

    def _step(self) -> None:
        if self._steps <= 0:
            raise _UnreadableError(Unreadable.TOO_MANY_VALUES())
        self._steps -= 1

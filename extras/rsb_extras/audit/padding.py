"""Padding inside serialized messages (XCDR1), by the descriptions of their types.

Alignment leaves bytes between fields that belong to none of them. Serializers may leave there what was in memory
before, so that equal messages differ in them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.cdr.decoder import DEPTH, HEADER_LENGTH
from rsb_bridge.cdr.description import KINDS, NESTED, PRIMITIVE_SIZES, STRINGS, WIDE_CHARACTER, WIDE_STRINGS

if TYPE_CHECKING:
    from rsb_bridge.cdr.description import FieldType, TypeDescription

_Hole: TypeAlias = tuple[int, int]
"""Where padding begins, and its bytes."""
_Shape: TypeAlias = tuple[int, tuple[_Hole, ...]]
"""Bytes of something of fixed size, with the padding before it, and its holes."""
_Shapes: TypeAlias = tuple[_Shape, ...]
"""By where it begins modulo 8."""
_PARTS_INLINED = 16  # of a message up to which another one has them as its own, as in the checker
_HOLES = 16  # of a fixed shape; types with more are walked part by part. A round figure
_END_PADDING, _EMPTY_PADDING = 3, 8
"""Bytes behind the last field: some middlewares pad to a multiple of 4, and rclpy reserves bytes to align the elements
of empty sequences, which it does not use."""
_PLAIN, _ARRAY, *_SEQUENCES = range(4)
_LENGTHS = struct.Struct(">I"), struct.Struct("<I")


class PaddingError(ValueError):
    """Padding cannot be told: a message does not fit its type, has too many parts, or its type is no ROS type."""


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """Fields of fixed size."""

    shapes: _Shapes


@dataclass(frozen=True, slots=True, eq=False)
class _Text:
    """A string, in characters of so many bytes."""

    unit: int


@dataclass(frozen=True, slots=True, eq=False)
class _Elements:
    """Messages or values, one behind the other; `count` is None if a length stands before them."""

    element: _Body
    count: int | None


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """A message or an element.

    Attributes:
        fixed: its shapes, or None if its size is not fixed.
        calm: by where one begins modulo 8, whether neither it nor those behind it have padding.
    """

    parts: tuple[_Run | _Text | _Elements, ...]
    fixed: _Shapes | None
    calm: tuple[bool, ...]


_NOTHING: _Shapes = ((0, ()),) * 8


def _primitive(size: int) -> _Shapes:
    return tuple((-at % size + size, ((0, -at % size),) if at % size else ()) for at in range(8))


def _then(first: _Shapes, second: _Shapes) -> _Shapes:
    found = []
    for at, (size, holes) in enumerate(first):
        more, others = second[(at + size) % 8]
        found.append((size + more, holes + tuple((size + begin, length) for begin, length in others)))
    return tuple(found)


class Padding:
    """Takes padding out of messages of one type."""

    def __init__(self, description: TypeDescription) -> None:
        """Compile it.

        Raises:
            PaddingError: the type has something that no ROS type has.
        """
        types = (description.type_description, *description.referenced_type_descriptions)
        self._fields = {each.type_name: each.fields for each in types}
        self._bodies: dict[str, _Body] = {}
        self._body = self._message(description.type_description.type_name, DEPTH)

    def cleared(self, content: bytes | memoryview, most: int) -> tuple[bytes | None, int]:
        """Return a message with zeros as padding, without what fills it up at its end, and its number of parts.

        Args:
            content: with its encapsulation header.
            most: parts at most, each of which takes some 0.5 µs.

        Returns:
            None in place of the message if only its padding to a multiple of 4 may be missing.

        Raises:
            PaddingError: it does not fit its type, or has more parts.
        """
        if len(content) < HEADER_LENGTH or content[0] or content[1] > 1:
            raise PaddingError
        walk = _Walk(content, most)
        try:
            end = HEADER_LENGTH + walk.through(self._body, 0)
        except struct.error:
            raise PaddingError from None
        # More than padding at the end belongs to a field that the description lacks.
        behind = len(content) - end
        if not 0 <= behind <= _END_PADDING + walk.empty * _EMPTY_PADDING:
            raise PaddingError
        if not walk.filled and behind <= -end % 4 and not any(content[end:]):
            return None, most - walk.left
        cleared = bytearray(content[:end])
        for begin, length in walk.filled:
            cleared[begin : begin + length] = bytes(length)
        return bytes(cleared), most - walk.left

    # --- compiling

    def _message(self, type_name: str, depth: int) -> _Body:
        if (known := self._bodies.get(type_name)) is not None:
            return known
        if depth == 0 or (fields := self._fields.get(type_name)) is None:
            raise PaddingError
        building = _Parts()
        for each in fields:
            self._add(building, each.type, depth)
        if not fields:
            building.fix(_primitive(1))  # DDS has no empty type: rosidl adds a byte
        body = self._bodies[type_name] = building.body()
        return body

    def _add(self, building: _Parts, kind: FieldType, depth: int) -> None:
        container, base = divmod(kind.type_id - 1, KINDS)
        element = self._element(kind, base + 1, depth)
        if container == _PLAIN:
            building.add(element, 1)
        elif container == _ARRAY:
            building.add(element, kind.capacity)
        elif container in _SEQUENCES:
            building.part(_Elements(element, None))
        else:
            raise PaddingError

    def _element(self, kind: FieldType, base: int, depth: int) -> _Body:
        if base == NESTED:
            return self._message(kind.nested_type_name, depth - 1)
        building = _Parts()
        if base in STRINGS or base in WIDE_STRINGS:
            building.part(_Text(WIDE_CHARACTER if base in WIDE_STRINGS else 1))
        elif base in PRIMITIVE_SIZES:
            building.fix(_primitive(PRIMITIVE_SIZES[base]))
        else:
            raise PaddingError
        return building.body()


class _Parts:
    """A body that is being made, field by field."""

    def __init__(self) -> None:
        self._parts: list[_Run | _Text | _Elements] = []
        self._run = _NOTHING

    def body(self) -> _Body:
        fixed = None if self._parts else self._run
        self._end_run()
        return _Body(tuple(self._parts), fixed, _calm(fixed) if fixed else (False,) * 8)

    def fix(self, shapes: _Shapes) -> None:
        self._run = _then(self._run, shapes)

    def part(self, part: _Text | _Elements) -> None:
        self._end_run()
        self._parts.append(part)

    def add(self, element: _Body, count: int) -> None:
        """Add so many elements, as fields of fixed size if they have few holes, or one with its parts if it has few."""
        shapes = _several(element, count)
        if shapes is not None and max(len(holes) for _, holes in (*shapes, *self._run)) <= _HOLES:
            self.fix(shapes)
        elif count == 1 and len(element.parts) <= _PARTS_INLINED:
            for part in element.parts:
                if isinstance(part, _Run):
                    self.fix(part.shapes)
                else:
                    self.part(part)
        else:
            self.part(_Elements(element, count))

    def _end_run(self) -> None:
        if self._run is not _NOTHING:
            self._parts.append(_Run(self._run))
            self._run = _NOTHING


def _calm(shapes: _Shapes) -> tuple[bool, ...]:
    found = []
    for begin in range(8):
        at, places = begin, set[int]()
        while at not in places and not shapes[at][1]:
            places.add(at)
            at = (at + shapes[at][0]) % 8
        found.append(at in places)
    return tuple(found)


def _several(element: _Body, count: int) -> _Shapes | None:
    """Return the shapes of some elements, or None if they have none or many holes."""
    if element.fixed is None:
        return None
    found = []
    for begin in range(8):
        size, holes, left = 0, list[_Hole](), count
        while left:
            at = (begin + size) % 8
            more, others = element.fixed[at]
            if element.calm[at]:
                size += more * left
                break
            holes += [(size + start, length) for start, length in others]
            if len(holes) > _HOLES:
                return None
            size += more
            left -= 1
        found.append((size, tuple(holes)))
    return tuple(found)


# --- walking


class _Walk:
    """A way through a message. Places count from behind the encapsulation header.

    Attributes:
        filled: padding that is not zero, from the beginning of the message.
        empty: sequences without elements.
        left: parts that may still be walked through.
    """

    def __init__(self, content: bytes | memoryview, most: int) -> None:
        self.filled: list[_Hole] = []
        self.empty = 0
        self.left = most
        self._content = content
        self._read = _LENGTHS[content[1]].unpack_from

    def through(self, body: _Body, at: int) -> int:
        """Return the place behind a body; it may lie beyond the end.

        Raises:
            PaddingError: it has too many parts.
            struct.error: a length lies beyond the end.
        """
        self.left -= len(body.parts)
        if self.left < 0:
            raise PaddingError
        for part in body.parts:
            if isinstance(part, _Run):
                size, holes = part.shapes[at & 7]
                for begin, length in holes:
                    self._look(HEADER_LENGTH + at + begin, length)
                at += size
            elif isinstance(part, _Text):
                at, length = self._length(at)
                at += length * part.unit
            elif part.count is not None:
                at = self._elements(part.element, part.count, at)
            else:
                at, length = self._length(at)
                self.empty += not length
                at = self._elements(part.element, length, at)
        return at

    def _elements(self, element: _Body, count: int, at: int) -> int:
        for left in range(count, 0, -1):
            if element.calm[at & 7] and element.fixed is not None:
                return at + left * element.fixed[at & 7][0]
            at = self.through(element, at)
        return at

    def _length(self, at: int) -> tuple[int, int]:
        if padding := -at & 3:
            self._look(HEADER_LENGTH + at, padding)
            at += padding
        return at + 4, self._read(self._content, HEADER_LENGTH + at)[0]

    def _look(self, begin: int, length: int) -> None:
        if any(self._content[begin : begin + length]):
            self.filled.append((begin, length))

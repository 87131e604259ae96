"""Rewrites the names of frames and the stamps in serialized messages (XCDR1), by the descriptions of their types.

A type is compiled once into steps, each a length and what precedes it. A message is walked from length to length, and
copied in pieces between what changes. A longer name moves all that follows: from there on, padding is made anew field
by field, until both messages are aligned alike again, which the next field of eight bytes brings about.
"""

from __future__ import annotations

import struct
import sys
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from rsb_bridge.cdr.checker import STEPS
from rsb_bridge.cdr.decoder import DEPTH, HEADER_LENGTH
from rsb_bridge.cdr.description import (
    BOUNDED_STRINGS,
    KINDS,
    NESTED,
    PRIMITIVE_SIZES,
    STRINGS,
    WIDE_CHARACTER,
    WIDE_STRINGS,
)
from rsb_bridge.feature_api import TransformError, Wording, sanitize_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.cdr.description import FieldType, TypeDescription

HEADER, TIME = "std_msgs/msg/Header", "builtin_interfaces/msg/Time"
FRAME, FRAME_END = "frame_id", "_frame_id"
"""A string field of this name, or whose name ends so, is a frame: `Header.frame_id`, `Odometry.child_frame_id`."""

_PLAIN, _ARRAY, _BOUNDED, _UNBOUNDED = range(4)
_FIXED, _TEXT, _FRAME, _STAMP, _ELEMENTS, _SEQUENCE, _REPEATED = range(7)
_INLINED = 16
"""Steps of a nested message up to which the outer one has them as its own, as in `rsb_bridge.cdr.checker`."""
_NAMES, _NAME_LENGTH = 1024, 128
"""Frames whose new names are kept, and bytes of the longest of them. Round figures: a robot has some hundred, and a
peer that makes names up fills half a megabyte for a topic."""
_NATIVE: Final = int(sys.byteorder == "little")
_SECOND = 10**9  # ns
_LAST_SECOND = 2**31 - 1


class Unchanged(Wording):
    """The reason why a message, or a type's messages, cannot be changed, and the remedy."""

    NOT_XCDR1 = (
        "frames and stamps are found in XCDR1 only, and a message begins with {beginning}: "
        "switch frame_prefix and restamp off for the topic"
    )
    MALFORMED = "a message's lengths contradict its type: see the node on the other side that sent it"
    TOO_MANY_LENGTHS = (
        "a message has more than {limit:,} strings and sequences: have its node send smaller ones, "
        "or switch frame_prefix and restamp off for the topic"
    )
    TOO_LONG = "the frame {name} is longer than its field allows ({bound} characters): choose a shorter frame_prefix"
    TYPE = "the description of {type} has something that no ROS type has"


class UnknownTypeError(ValueError):
    """A description has something that no ROS type has."""


# --- layouts of fixed size


class _Layout(NamedTuple):
    """Fields of fixed size.

    Attributes:
        pieces: (alignment, bytes) of each, with the padding within it. Alignments grow from piece to piece: behind a
            field of the largest one, all places are known.
        sizes: bytes with all padding, by where it begins modulo 8.
    """

    pieces: tuple[tuple[int, int], ...]
    sizes: tuple[int, ...]

    @property
    def alignment(self) -> int:
        return self.pieces[-1][0] if self.pieces else 1


def _layout(pieces: Iterable[tuple[int, int]]) -> _Layout:
    merged: list[tuple[int, int]] = []
    for alignment, size in pieces:
        if merged and merged[-1][0] >= alignment:
            largest, before = merged[-1]
            merged[-1] = largest, before + -before % alignment + size
        else:
            merged.append((alignment, size))
    sizes = []
    for begin in range(8):
        at = begin
        for alignment, size in merged:
            at += -at % alignment + size
        sizes.append(at - begin)
    return _Layout(tuple(merged), tuple(sizes))


_NOTHING = _layout(())
_LENGTH = _layout([(4, 4)])
_TIME = _layout([(4, 8)])


def _joined(first: _Layout, second: _Layout) -> _Layout:
    return _layout((*first.pieces, *second.pieces)) if first.pieces else second


def _times(element: _Layout, count: int) -> _Layout:
    """Return the layout of an array; from its second element on, all begin at one place modulo the alignment."""
    *before, (alignment, size) = element.pieces
    return _layout((*before, (alignment, size + (count - 1) * element.sizes[size % alignment])))


# --- steps


class _Step(NamedTuple):
    """A length with its content, a stamp, or fields of fixed size.

    Attributes:
        before: what precedes the content: fields, and the length. Of a stamp: up to its end.
        unit: bytes of a character or an element; of a frame, the characters that its field holds, or 0 for any number.
        number: elements of an array.
        body: of elements whose sizes vary.
        element: the layout of others.
        least: bytes of an element.
    """

    kind: int
    before: _Layout
    unit: int = 0
    number: int = 0
    body: tuple[_Step, ...] = ()
    element: _Layout = _NOTHING
    least: int = 1

    @property
    def changes(self) -> bool:
        """Whether it has something that is rewritten."""
        return self.kind in (_FRAME, _STAMP) or any(each.changes for each in self.body)


Body: TypeAlias = tuple[_Step, ...]


@dataclass(frozen=True)
class RewritePlan:
    """The steps of a type whose messages have something that is rewritten.

    Attributes:
        body: up to the last step that rewrites something.
        rest: the steps behind it, each with the largest alignment from it on.
    """

    body: Body
    rest: tuple[tuple[int, Body], ...]


def compile_plan(description: TypeDescription, *, frames: bool, stamps: bool) -> RewritePlan | None:
    """Return how a type's messages are rewritten, or None if they have nothing of that.

    Raises:
        UnknownTypeError: the description has something that no ROS type has.
    """
    body = _Compiler(description, frames=frames, stamps=stamps).body(description.type_description.type_name, DEPTH)
    last = max((at for at, each in enumerate(body) if each.changes), default=None)
    if last is None:
        return None
    rest: list[tuple[int, Body]] = []
    alignment = 1
    for each in reversed(body[last + 1 :]):
        alignment = max(alignment, _alignment(each))
        rest.insert(0, (alignment, (each,)))
    return RewritePlan(body[: last + 1], tuple(rest))


def _alignment(step: _Step) -> int:
    of_body = max((_alignment(each) for each in step.body), default=1)
    return max(step.before.alignment, step.element.alignment, of_body)


class _Compiler:
    def __init__(self, description: TypeDescription, *, frames: bool, stamps: bool) -> None:
        types = (description.type_description, *description.referenced_type_descriptions)
        self._fields = {each.type_name: each.fields for each in types}
        self._bodies: dict[str, Body] = {}
        self._frames, self._stamps = frames, stamps

    def body(self, type_name: str, depth: int) -> Body:
        if (known := self._bodies.get(type_name)) is not None:
            return known
        fields = self._fields.get(type_name)
        if fields is None or depth == 0:
            raise UnknownTypeError(Unchanged.TYPE(type=sanitize_text(type_name)))
        steps: list[_Step] = []
        for field in fields:
            for step in self._field(type_name, field.name, field.type, depth):
                _append(steps, step)
        if not fields:
            steps.append(_fixed(1))  # DDS has no empty type: rosidl adds a byte
        self._bodies[type_name] = body = tuple(steps)
        return body

    def _field(self, owner: str, name: str, kind: FieldType, depth: int) -> Body:
        container, base = divmod(kind.type_id - 1, KINDS)
        element = self._element(owner, name, kind, base + 1, depth)
        fixed = element[0].before if [each.kind for each in element] == [_FIXED] else None
        if container == _PLAIN:
            return element if len(element) <= _INLINED else (_Step(_REPEATED, _NOTHING, number=1, body=element),)
        if container == _ARRAY and kind.capacity:
            if fixed is not None:
                return (_Step(_FIXED, _times(fixed, kind.capacity)),)
            return (_Step(_REPEATED, _NOTHING, number=kind.capacity, body=element, least=_least(element)),)
        if container not in (_BOUNDED, _UNBOUNDED):
            raise UnknownTypeError(Unchanged.TYPE(type=sanitize_text(owner)))
        if fixed is None:
            return (_Step(_SEQUENCE, _LENGTH, body=element, least=_least(element)),)
        if len(fixed.pieces) == 1 and fixed.pieces[0] in ((1, 1), (2, 2), (4, 4)):  # it needs no padding anywhere
            return (_Step(_TEXT, _LENGTH, unit=fixed.pieces[0][1]),)
        return (_Step(_ELEMENTS, _LENGTH, element=fixed, least=fixed.sizes[0]),)

    def _element(self, owner: str, name: str, kind: FieldType, base: int, depth: int) -> Body:
        if base == NESTED:
            if self._stamps and (owner, name, kind.nested_type_name) == (HEADER, "stamp", TIME):
                return (_Step(_STAMP, _TIME),)
            return self.body(kind.nested_type_name, depth - 1)
        if base in PRIMITIVE_SIZES:
            return (_fixed(PRIMITIVE_SIZES[base]),)
        if base in STRINGS:
            if self._frames and (name == FRAME or name.endswith(FRAME_END)):
                return (_Step(_FRAME, _LENGTH, unit=kind.string_capacity if base in BOUNDED_STRINGS else 0),)
            return (_Step(_TEXT, _LENGTH, unit=1),)
        if base in WIDE_STRINGS:
            return (_Step(_TEXT, _LENGTH, unit=WIDE_CHARACTER),)
        raise UnknownTypeError(Unchanged.TYPE(type=sanitize_text(owner)))


def _fixed(size: int) -> _Step:
    return _Step(_FIXED, _layout([(size, size)]))


def _append(steps: list[_Step], step: _Step) -> None:
    """Add a step; fields of fixed size before it become a part of it."""
    if steps and steps[-1].kind == _FIXED:
        step = step._replace(before=_joined(steps.pop().before, step.before))
    steps.append(step)


def _least(body: Body) -> int:
    """Bytes that an element of varying size has at least."""
    return max(1, sum(sum(size for _, size in each.before.pieces) for each in body))


# --- messages


class Rewriter:
    """Rewrites the messages of one type.

    Args:
        prefix: of frames, or empty.

    Attributes:
        shift: ns that is added to stamps.
        steps: strings and sequences in the last message.
    """

    def __init__(self, plan: RewritePlan, prefix: str = "") -> None:
        self._plan = plan
        self._prefix = prefix.encode()
        self.shift = 0
        self.steps = 0
        self._structs = struct.Struct(">iI"), struct.Struct("<iI")
        self._lengths = struct.Struct(">I"), struct.Struct("<I")
        # By byte order, then the name with its zero: the length and the new name, and the bytes that these have more.
        self._names: tuple[dict[bytes, tuple[bytes, int]], ...] = {}, {}
        # Of the message in hand:
        self._order = 0
        self._payload = b""
        self._words: Sequence[int] = ()
        self._pieces: list[bytes] = []
        self._copied = 0  # bytes of it that are in the pieces, or replaced there

    def rewrite(self, payload: bytes) -> bytes:
        """Return a message with its frames and stamps rewritten, and all else as it was.

        Raises:
            TransformError: it does not fit its type as far as that is seen here, has too many parts, or a new name is
                too long for its field.
        """
        self.steps = 0
        if len(payload) < HEADER_LENGTH or payload[0] or payload[1] > 1:
            raise TransformError(Unchanged.NOT_XCDR1(beginning=payload[:HEADER_LENGTH].hex(" ")))
        self._order, self._payload, self._words = payload[1], payload, _words_of(payload)
        self._pieces, self._copied = [], 0
        try:
            return self._rewritten(len(payload) - HEADER_LENGTH)
        except IndexError:
            raise TransformError(Unchanged.MALFORMED()) from None
        finally:
            self._payload, self._words, self._pieces = b"", (), []  # a message may have megabytes

    def _rewritten(self, end: int) -> bytes:
        plan, payload, pieces = self._plan, self._payload, self._pieces
        at, moved = self._walk(plan.body, 1, 0, 0, end)
        for alignment, body in plan.rest:
            if not moved % alignment:
                break
            at, moved = self._walk(body, 1, at, moved, end)
        if at > end:
            raise IndexError
        if not pieces:
            return payload
        return b"".join((*pieces, memoryview(payload)[self._copied :]))  # an image has megabytes behind its frame

    def _walk(self, body: Body, count: int, at: int, moved: int, end: int) -> tuple[int, int]:
        """Pass `count` elements; `moved` is how many bytes later than `at` they are in the new message.

        Returns:
            The same behind them. A place beyond the end is found by reading a length there (IndexError), or at last.
        """
        words = self._words
        for _ in range(count):
            for kind, before, unit, number, inner, element, least in body:
                if moved & 7:
                    at, moved = self._pad(before, at, moved)
                else:
                    at += before.sizes[at & 7]
                if kind == _FIXED:
                    continue
                # A length that ends at `at` is the word that begins there, behind an encapsulation header of one word.
                if kind == _FRAME:
                    length = words[at >> 2]
                    if length > 1:
                        moved += self._rename(at, length, unit)
                    at += length
                elif kind == _TEXT:
                    at += words[at >> 2] * unit
                elif kind == _STAMP:
                    if self.shift:
                        self._shift_stamp(at)
                elif kind == _ELEMENTS:
                    length = words[at >> 2]
                    if length:
                        at, moved = self._elements(element, length, at, moved)
                else:
                    length = number if kind == _REPEATED else words[at >> 2]
                    if length * least > end - at:
                        raise IndexError
                    self.steps += length
                    if self.steps > STEPS:
                        raise TransformError(Unchanged.TOO_MANY_LENGTHS(limit=STEPS))
                    at, moved = self._walk(inner, length, at, moved, end)
        return at, moved

    def _pad(self, layout: _Layout, at: int, moved: int) -> tuple[int, int]:
        """Pass fields of fixed size, with the padding that they need where they are now."""
        for alignment, size in layout.pieces:
            old, new = -at % alignment, -(at + moved) % alignment
            if old != new:
                self._replace(at + HEADER_LENGTH, bytes(new), old)
                moved += new - old
            at += old + size
        return at, moved

    def _elements(self, element: _Layout, count: int, at: int, moved: int) -> tuple[int, int]:
        """Pass elements of fixed size; behind the first, they are aligned alike in both messages."""
        if moved % element.alignment:
            at, moved = self._pad(element, at, moved)
        else:
            at += element.sizes[at & 7]
        return at + (count - 1) * element.sizes[at & 7], moved

    def _replace(self, begin: int, new: bytes, length: int) -> None:
        """Have `new` instead of so many bytes from a place in the payload on."""
        self._pieces += self._payload[self._copied : begin], new
        self._copied = begin + length

    def _shift_stamp(self, at: int) -> None:
        """Shift the stamp that ends at `at`; zero, which means none or the newest, and what is no time stay."""
        seconds, rest = self._words[(at >> 2) - 1], self._words[at >> 2]
        if not (seconds or rest) or seconds > _LAST_SECOND or rest >= _SECOND:
            return
        seconds, rest = divmod(seconds * _SECOND + rest + self.shift, _SECOND)
        if 0 <= seconds <= _LAST_SECOND and (seconds or rest):
            self._replace(at - 8 + HEADER_LENGTH, self._structs[self._order].pack(seconds, rest), 8)

    def _rename(self, at: int, length: int, bound: int) -> int:
        """Rename the frame of so many bytes behind its length, and return how many more it has."""
        name = self._payload[at + HEADER_LENGTH : at + HEADER_LENGTH + length]
        names = self._names[self._order]
        if (found := names.get(name)) is None:
            new = renamed(name, self._prefix)
            if bound and new != name and len(new) - 1 > bound:
                shown = sanitize_text(new[:-1].decode(errors="replace"))
                raise TransformError(Unchanged.TOO_LONG(name=shown, bound=bound))
            text = b"" if new == name else self._lengths[self._order].pack(len(new)) + new
            found = text, len(new) - length
            if length <= _NAME_LENGTH:
                if len(names) >= _NAMES:
                    names.clear()
                names[name] = found
        text, more = found
        if text:
            self._replace(at, text, 4 + length)
        return more


def renamed(name: bytes, prefix: bytes) -> bytes:
    """Return a frame with its prefix, both names with their final zero; an empty one stays, and one that has it.

    A leading slash goes, as tf2 takes ``/odom`` for ``odom`` (`tf2::BufferCore`).
    """
    bare = name.removeprefix(b"/")
    if bare in (b"", b"\0"):
        return name
    return bare if bare.startswith(prefix) else prefix + bare


def _words_of(payload: bytes) -> Sequence[int]:
    """Return a message as words of four bytes, its encapsulation header too; each length is one of them."""
    whole = len(payload) & ~3
    if payload[1] == _NATIVE:
        return memoryview(payload)[:whole].cast("I")
    words = array("I", payload[:whole])
    words.byteswap()
    return words

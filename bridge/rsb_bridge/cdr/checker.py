"""Checks serialized messages (XCDR1) against the descriptions of their types, before a reader allocates for them.

A reader believes the lengths in a message: eight bytes can make it reserve gigabytes. A checker walks from one length
to the next, and skips all that lies between them at once: a type of fixed size costs one comparison, an image four
lengths. Values and the zeros at the ends of strings are not looked at, since no reader allocates for them.
"""

from __future__ import annotations

import struct
import sys
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn, TypeAlias

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
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.cdr.description import FieldType, TypeDescription

STEPS: Final = 250_000
"""Lengths in sequences that are read in one message at most, which takes some 0.1 s; 100 transforms have 200."""

Sizes: TypeAlias = tuple[int, ...]
"""Bytes of something, with the padding before it, by where it begins modulo 8."""

_PLAIN, _ARRAY, _BOUNDED, _UNBOUNDED = range(4)
_ANY_LENGTH = 2**32
"""Above each length, which has 32 bits."""
_LENGTHS_INLINED = 16
"""Lengths of a nested message up to which the outer one has them as its own. A round figure.

Without a limit, 60 types that have the next one twice each would make 2^60 steps.
"""
_READERS: Final = (struct.Struct(">I").unpack_from, struct.Struct("<I").unpack_from)
"""By the second byte of the encapsulation header: CDR_BE, CDR_LE (DDSI-RTPS 2.5 section 10.2)."""
_NATIVE: Final = int(sys.byteorder == "little")


class Malformed(Wording):
    """A contradiction between a message and its type."""

    NOT_XCDR1 = "it does not begin with an XCDR1 header: {beginning}"
    NO_BYTES = "it is empty: not even an XCDR1 header"
    SHORTER_THAN_TYPE = "it has {length:,} bytes; its type needs at least {least:,}"
    LENGTHS = "its lengths contradict each other"
    ENDS_EARLY = "the message ends within it"
    ENDS_BEFORE = "the message ends before it"
    ABOVE_BOUND = "its length exceeds its bound of {bound:,}"
    BEYOND_MESSAGE = "its length exceeds the rest of the message"
    TOO_MANY_LENGTHS = "the message has more than {limit:,} strings and sequences"


class Uncheckable(Wording):
    """The reason why messages of a type cannot be checked."""

    TOO_DEEP = "{type} has more than {limit} levels"
    TYPE_MISSING = "the description lacks {type}"
    EMPTY_ARRAY = "{field} is an array of length 0"
    FIELD_TYPE_UNKNOWN = "{field} has the unknown type {type}"
    TYPE_UNKNOWN = "a value has the unknown type {type}"


class MalformedError(ValueError):
    """A message does not fit its type; the text names the field.

    Attributes:
        field: path of the field, ``transforms[].header.frame_id``, or an empty string for the message as a whole.
        steps: lengths that were read, or 0 if the message was refused at once.
    """

    def __init__(self, field: str, text: str, steps: int = 0) -> None:
        super().__init__(sanitize_text(f"{field}: {text}" if field else text))
        self.field = field
        self.steps = steps


class TooComplexError(Exception):
    """A message has more lengths than are read."""


class UncheckableError(ValueError):
    """Messages of a type cannot be checked: its description has something that no ROS type has."""


class _Kind(IntEnum):
    """The content behind a length, or in an array."""

    STRINGS = 0
    """Unbounded strings, one after the other."""
    UNITS = 1
    """Characters, or elements that need no padding behind a length."""
    FIXED = 2
    """Elements of fixed size."""
    VARYING = 3
    """Elements that have lengths themselves."""
    ARRAY = 4
    """As VARYING, without a length before it."""


class _Step(NamedTuple):
    """A length and the elements that it counts.

    Attributes:
        sizes: bytes from the end of the previous content to the end of the length, or to the array.
        bound: the largest number of elements, or an array's number.
        unit: bytes of one unit.
        zero: units of the terminating zero, which the length of a string counts and its type's bound does not.
        repeated: elements of fixed size.
        body: the body of elements of varying size.
    """

    kind: _Kind
    sizes: Sizes
    bound: int
    name: str
    unit: int = 1
    zero: int = 0
    repeated: tuple[_Repeated, ...] = ()
    body: _Body | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """A message type, or an element.

    Attributes:
        tail: bytes behind the content of the last one.
        least: bytes that it has at least.
        last: name of its last field.
        walked: its steps for `_walk`.
    """

    steps: tuple[_Step, ...]
    tail: Sizes
    least: int
    last: str
    walked: tuple[Any, ...]


_NOTHING: Sizes = (0,) * 8


def _then(first: Sizes, second: Sizes) -> Sizes:
    return tuple(size + second[(at + size) % 8] for at, size in enumerate(first))


def _primitive(size: int) -> Sizes:
    return tuple(-at % size + size for at in range(8))


class _Repeated:
    """Any number of elements of fixed size, which begin at one place modulo 8: their padding repeats."""

    def __init__(self, sizes: Sizes, begin: int) -> None:
        places: dict[int, int] = {}  # the number of the first element that begins there
        ends = [0]
        at = begin
        while at not in places:
            places[at] = len(ends) - 1
            ends.append(ends[-1] + sizes[at])
            at = (begin + ends[-1]) % 8
        self._ends = tuple(ends)
        self._before = places[at]
        self._period = len(ends) - 1 - self._before
        self._length = ends[-1] - ends[self._before]

    def size(self, count: int) -> int:
        """Return the bytes of `count` elements."""
        if count <= self._before:
            return self._ends[count]
        periods, rest = divmod(count - self._before, self._period)
        return self._ends[self._before + rest] + periods * self._length


_LENGTH = _primitive(4)


class Checker:
    """Checks messages of one type.

    Attributes:
        loops: whether messages have any number of lengths, so that the time of a check depends on the message.
    """

    def __init__(self, description: TypeDescription) -> None:
        """Compile the checker.

        Raises:
            UncheckableError: the type has something that no ROS type has.
        """
        compiler = _Compiler(description)
        self._body = compiler.body(description.type_description.type_name, DEPTH)
        self._shortest = HEADER_LENGTH + (self._body.least if self._body.steps else self._body.tail[0])
        self.loops = any(step.body is not None for step in self._body.steps)
        self._lengths = tuple((step.sizes, step.bound, step.unit, step.repeated) for step in self._body.steps)
        self._tail = self._body.tail

    def check(self, payload: bytes) -> int:
        """Check a message with its encapsulation header; more bytes than the type needs are allowed.

        Returns:
            The number of lengths in sequences that were read, which is about what the check costs.

        Raises:
            MalformedError: it does not fit the type.
            TooComplexError: it has more than `STEPS` lengths in sequences.
        """
        size = len(payload)
        if size < self._shortest or payload[0] or payload[1] > 1:
            self._explain_beginning(payload)
        # A list, because the lengths that were read count also if the walk raises an error.
        end, spent = size - HEADER_LENGTH, [0]
        if self.loops:
            try:
                if _walk(_words_of(payload), self._body.walked, 1, 0, end, spent) <= end:
                    return spent[0]
            except IndexError:
                pass
        else:
            # As `_walk`, and quicker, without elements that vary. Not a function: it would be a call for each message.
            at, read = 0, _READERS[payload[1]]
            try:
                for sizes, bound, unit, repeated in self._lengths:
                    at += sizes[at & 7]
                    (length,) = read(payload, at)
                    if length > bound:
                        break
                    at += repeated[at & 7].size(length) if repeated else length * unit
                else:
                    if at + self._tail[at & 7] <= end:
                        return 0
            except (struct.error, OverflowError):  # it would lie beyond the end, or beyond any memory
                pass
        # A malformed message is walked once more: to keep the names of fields would cost each good one.
        _Explainer(_words_of(payload), end, spent[0]).explain(self._body, 1, 0, "")
        raise MalformedError("", Malformed.LENGTHS(), spent[0])

    def _explain_beginning(self, payload: bytes) -> NoReturn:
        if len(payload) < HEADER_LENGTH or payload[0] or payload[1] > 1:
            text = Malformed.NOT_XCDR1 if payload else Malformed.NO_BYTES
            raise MalformedError("", text(beginning=payload[:HEADER_LENGTH].hex(" ")))
        raise MalformedError("", Malformed.SHORTER_THAN_TYPE(length=len(payload), least=self._shortest))


# --- walking


class _Words:
    """The words of a message whose byte order is not this machine's."""

    def __init__(self, payload: bytes) -> None:
        self._payload = payload
        self._unpack = _READERS[payload[1]]

    def __getitem__(self, number: int) -> int:
        """Return a word; IndexError if there are not so many."""
        if number >= len(self._payload) // 4:
            raise IndexError(number)
        word: int = self._unpack(self._payload, number * 4)[0]
        return word


def _words_of(payload: bytes) -> memoryview | _Words:
    """Return a message as words of four bytes, the encapsulation header too; each length is one of them."""
    if payload[1] != _NATIVE:
        return _Words(payload)
    # A cast takes whole words only, and no length lies in the last bytes.
    return memoryview(payload)[: len(payload) & ~3].cast("I")


class _TooLongError(IndexError):
    """A length is beyond its bound, or beyond what the bytes can hold."""


def _walk(words: memoryview | _Words, body: tuple[Any, ...], count: int, at: int, end: int, spent: list[int]) -> int:
    """Return the place behind `count` elements, from behind the encapsulation header; it may lie beyond the end.

    A place beyond the end is found by reading the next length there, which raises IndexError, or by the caller.
    A length that ends at a place is the word that begins there, as the encapsulation header is as long as a word.
    """
    steps, tail, strings, aligned = body
    if strings is not None:
        if aligned is not None and count > 1:
            at = _skip_aligned(words, at, count - 1, *aligned)
            count = 1  # what follows the last one may need less padding
        for _ in range(count):
            for sizes in strings:
                at += sizes[at & 7]
                at += words[at >> 2]
            at += tail[at & 7]
        return at
    for _ in range(count):
        # Kinds are numbers here (`_Kind`): to look up the members would cost each length.
        for kind, sizes, bound, content, least, lengths in steps:
            if kind == 0:
                for sizes in content:  # noqa: PLW2901 (a step of strings has no other sizes)
                    at += sizes[at & 7]
                    at += words[at >> 2]
                continue
            at += sizes[at & 7]
            length = bound if kind == 4 else words[at >> 2]
            if length > bound:
                raise _TooLongError
            if kind == 1:
                at += length * content
            elif kind == 2:
                at += content[at & 7].size(length)
            else:
                if length * least > end - at:
                    raise _TooLongError  # nothing of it is read, so it costs nothing
                spent[0] += length * lengths
                if spent[0] > STEPS:
                    raise TooComplexError(Malformed.TOO_MANY_LENGTHS(limit=STEPS))
                at = _walk(words, content, length, at, end, spent)
        at += tail[at & 7]
    return at


def _skip_aligned(
    words: memoryview | _Words, at: int, count: int, strings: tuple[tuple[int, int], ...], tails: tuple[int, int]
) -> int:
    """Return the place behind elements of which each part begins at a word; see `_aligned`. It counts in words."""
    word = (at + 3) >> 2
    # Without the inner loop: TransformStamped and KeyValue, of which a message has hundreds, have two.
    if len(strings) == 2:
        (first, first_bytes), (second, second_bytes) = strings
        for _ in range(count):
            word += words[word + first] + first_bytes >> 2
            word += words[word + second] + second_bytes >> 2
            word += tails[word & 1]
        return word << 2
    for _ in range(count):
        for before, size in strings:
            word += words[word + before] + size >> 2
        word += tails[word & 1]
    return word << 2


def _aligned(strings: Sequence[Sizes], tail: Sizes) -> tuple[Any, ...] | None:
    """Return what `_skip_aligned` takes of an element of strings, or None if a part of it does not begin at a word.

    That is for each string the words before its content, and the same in bytes with what rounds the content up; and
    the words behind the last one, by whether its end is at an odd word.
    """
    found = []
    for sizes in strings:
        if any(size != -at % 4 + sizes[0] for at, size in enumerate(sizes)):
            return None
        found.append((sizes[0] // 4, sizes[0] + 3))
    if tail != _NOTHING and any(size != -at % 4 + tail[(at + -at % 4) % 8] for at, size in enumerate(tail)):
        return None
    if tail[0] % 4 or tail[4] % 4:
        return None
    return tuple(found), (tail[0] // 4, tail[4] // 4)


def _walked(steps: Sequence[_Step], tail: Sizes) -> tuple[Any, ...]:
    """Return the steps as `_walk` takes them: strings that follow each other are one."""
    rows: list[tuple[Any, ...]] = []
    for step in steps:
        if step.kind is _Kind.UNITS and step.unit == 1 and step.bound == _ANY_LENGTH:
            if rows and rows[-1][0] == _Kind.STRINGS:
                rows[-1] = (0, _NOTHING, 0, (*rows[-1][3], step.sizes), 0, 0)
            else:
                rows.append((0, _NOTHING, 0, (step.sizes,), 0, 0))
        elif step.kind is _Kind.UNITS:
            rows.append((1, step.sizes, step.bound, step.unit, 0, 0))
        elif step.kind is _Kind.FIXED:
            rows.append((2, step.sizes, step.bound, step.repeated, 0, 0))
        else:
            assert step.body is not None
            least, lengths = step.body.least, max(1, len(step.body.steps))
            rows.append((int(step.kind), step.sizes, step.bound, step.body.walked, least, lengths))
    strings = rows[0][3] if len(rows) == 1 and rows[0][0] == _Kind.STRINGS else None
    return tuple(rows), tail, strings, None if strings is None else _aligned(strings, tail)


class _Explainer:
    """Walks a malformed message once more, to the field that shows it."""

    def __init__(self, words: memoryview | _Words, end: int, spent: int) -> None:
        self._words = words
        self._end = end
        self._spent = spent

    def explain(self, body: _Body, count: int, at: int, prefix: str) -> int:
        """Return the place behind elements that are as they should be; see `_walk`.

        Raises:
            MalformedError: they are not.
        """
        for _ in range(count):
            for step in body.steps:
                at = self._step(step, at, prefix)
            at += body.tail[at % 8]
            if at > self._end:
                self._fail(prefix + body.last, Malformed.ENDS_EARLY())
        return at

    def _step(self, step: _Step, at: int, prefix: str) -> int:
        name = prefix + step.name
        at += step.sizes[at % 8]
        if at > self._end:
            self._fail(name, Malformed.ENDS_BEFORE())
        length = step.bound if step.kind is _Kind.ARRAY else self._words[at >> 2]
        if length > step.bound:
            self._fail(name, Malformed.ABOVE_BOUND(bound=step.bound - step.zero))
        if step.kind in (_Kind.VARYING, _Kind.ARRAY):
            assert step.body is not None
            needed = length * step.body.least
        else:
            needed = step.repeated[at % 8].size(length) if step.kind is _Kind.FIXED else length * step.unit
        if needed > self._end - at:
            self._fail(name, Malformed.BEYOND_MESSAGE())
        if step.body is None:
            return at + needed
        # A nested message with many lengths is an array of one, see `_Building.inline`.
        alone = step.kind is _Kind.ARRAY and step.bound == 1
        return self.explain(step.body, length, at, f"{name}." if alone else f"{name}[].")

    def _fail(self, field: str, text: str) -> NoReturn:
        raise MalformedError(field.removesuffix("."), text, self._spent)


# --- compiling


class _Compiler:
    """Makes bodies of the types of one description."""

    def __init__(self, description: TypeDescription) -> None:
        types = (description.type_description, *description.referenced_type_descriptions)
        self._fields = {each.type_name: each.fields for each in types}
        self._bodies: dict[str, _Body] = {}

    def body(self, type_name: str, depth: int) -> _Body:
        """Return the body of a type.

        Raises:
            UncheckableError: the type has something that no ROS type has.
        """
        if (known := self._bodies.get(type_name)) is not None:
            return known
        if depth == 0:
            raise UncheckableError(Uncheckable.TOO_DEEP(type=type_name, limit=DEPTH))
        fields = self._fields.get(type_name)
        if fields is None:
            raise UncheckableError(Uncheckable.TYPE_MISSING(type=type_name))
        building = _Building()
        for each in fields:
            self._add(building, each.name, each.type, depth)
        if not fields:
            building.fix("", _primitive(1))  # DDS has no empty type: rosidl adds a byte
        body = self._bodies[type_name] = building.body()
        return body

    def _add(self, building: _Building, name: str, kind: FieldType, depth: int) -> None:
        container, base = divmod(kind.type_id - 1, KINDS)
        element = self._element(kind, base + 1, depth)
        if container == _PLAIN:
            building.inline(name, element)
        elif container == _ARRAY:
            if kind.capacity == 0:
                raise UncheckableError(Uncheckable.EMPTY_ARRAY(field=name))
            building.array(name, element, kind.capacity)
        elif container in (_BOUNDED, _UNBOUNDED):
            building.sequence(name, element, kind.capacity if container == _BOUNDED else _ANY_LENGTH)
        else:
            raise UncheckableError(Uncheckable.FIELD_TYPE_UNKNOWN(field=name, type=kind.type_id))

    def _element(self, kind: FieldType, base: int, depth: int) -> _Body:
        building = _Building()
        if base == NESTED:
            return self.body(kind.nested_type_name, depth - 1)
        if base in PRIMITIVE_SIZES:
            building.fix("", _primitive(PRIMITIVE_SIZES[base]))
        elif base in STRINGS or base in WIDE_STRINGS:
            unit, zero = (WIDE_CHARACTER, 0) if base in WIDE_STRINGS else (1, 1)
            bound = kind.string_capacity + zero if base in BOUNDED_STRINGS else _ANY_LENGTH
            building.step(_Step(_Kind.UNITS, _LENGTH, bound, "", unit, zero), 4)
        else:
            raise UncheckableError(Uncheckable.TYPE_UNKNOWN(type=kind.type_id))
        return building.body()


class _Building:
    """A body that is being made, field by field."""

    def __init__(self) -> None:
        self._steps: list[_Step] = []
        self._run = _NOTHING
        self._least = 0
        self._last = ""

    def body(self) -> _Body:
        """Return what has been made."""
        return _Body(tuple(self._steps), self._run, self._least, self._last, _walked(self._steps, self._run))

    def fix(self, name: str, sizes: Sizes) -> None:
        """Add a field of fixed size."""
        self._run = _then(self._run, sizes)
        self._least += min(sizes)
        self._last = name

    def step(self, step: _Step, least: int) -> None:
        """Add a length, of a field that has at least so many bytes."""
        self._steps.append(step._replace(sizes=_then(self._run, step.sizes)))
        self._run = _NOTHING
        self._least += least
        self._last = step.name

    def inline(self, name: str, element: _Body) -> None:
        """Add a field, with its own lengths if they are few."""
        if not element.steps:
            self.fix(_joined(name, element.last), element.tail)
        elif len(element.steps) > _LENGTHS_INLINED:
            self.step(_Step(_Kind.ARRAY, _NOTHING, 1, name, body=element), element.least)
        else:
            for step in element.steps:
                self.step(step._replace(name=_joined(name, step.name)), 0)
            self.fix(_joined(name, element.last), element.tail)
            self._least += element.least - min(element.tail)  # `fix` has added the tail

    def array(self, name: str, element: _Body, count: int) -> None:
        """Add an array."""
        if element.steps:
            self.step(_Step(_Kind.ARRAY, _NOTHING, count, name, body=element), element.least * count)
        else:
            self.fix(name, tuple(_Repeated(element.tail, begin).size(count) for begin in range(8)))

    def sequence(self, name: str, element: _Body, bound: int) -> None:
        """Add a sequence."""
        if element.steps:
            step = _Step(_Kind.VARYING, _LENGTH, bound, name, body=element)
        elif element.tail in _UNPADDED:
            step = _Step(_Kind.UNITS, _LENGTH, bound, name, _UNPADDED[element.tail])
        else:
            repeated = tuple(_Repeated(element.tail, begin) for begin in range(8))
            step = _Step(_Kind.FIXED, _LENGTH, bound, name, repeated=repeated)
        self.step(step, 4)


_UNPADDED: Final = {_primitive(size): size for size in (1, 2, 4)}
"""Elements that need no padding behind a length, which ends at a multiple of four."""


def _joined(name: str, inner: str) -> str:
    return f"{name}.{inner}" if inner else name

"""Serialized calls through Fast CDR: bytes in the place where rmw_fastrtps_cpp expects a ROS message.

It calls a message's type support to write the message to a Cdr, or to read it from one. So a type support that copies
bytes carries any type. In the message's place is a Python object:

- To send, a callable that writes the payload to the Cdr that it is called with (`outgoing`). The middleware calls it
  with its writer locked. If Python gave up the GIL there, a thread that has it and wants the writer would wait for
  ever. So not one Python instruction may run: `operator.call`, `functools.partial` and what they call are C.
- To take, a list that the payload is put into. The middleware has nothing locked then.
"""

from __future__ import annotations

import ctypes
import operator
import struct
from functools import lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.ros.native.librcl import address_of
from rsb_bridge.ros.ros_interface import RosError, RosProblem

if TYPE_CHECKING:
    from collections.abc import Callable

_HEADER = 4
"""bytes: the encapsulation before the message, which the middleware writes itself."""
_WRITTEN = b"\0\1"
"""How the encapsulation begins that it writes: CDR, little endian."""
_LIBRARY = "libfastcdr.so.2"
_SPACE = "_ZN8eprosima7fastcdr"
_WORD = struct.Struct("@P")
_word_at = ctypes.c_size_t.from_address
_ROOM = 1024
"""bytes that a Cdr certainly fits in; it takes some 200 in fastcdr 2.2.5."""


class _Cdr(NamedTuple):
    """A Cdr seen from outside: it does not export how many bytes it reads, so its memory is looked at.

    Attributes:
        buffer: place in a Cdr of the address of its FastBuffer.
        data: place in a FastBuffer of the address of the bytes.
        size: place in a FastBuffer of their number.
        write: C function that appends ``length`` bytes at ``data`` to ``cdr``.
    """

    buffer: int
    data: int
    size: int
    write: Callable[..., int]


def copies_calls() -> bool:
    """Whether bytes get in and out of this version of fastcdr."""
    return _cdr() is not None


def outgoing(payload: bytes) -> object:
    """Return an object to send in the message's place.

    The caller passes its address (`id`), and keeps it and the payload alive until the middleware has returned.

    Raises:
        RosError: the payload is too short or of another byte order.
    """
    if len(payload) < _HEADER:
        raise RosError(RosProblem.MESSAGE_TOO_SHORT(length=len(payload)))
    if not payload.startswith(_WRITTEN):
        raise RosError(f"a message that is encapsulated as {payload[:2].hex()} cannot be sent in a call, only 0001 can")
    cdr = _cdr()
    assert cdr is not None
    length = len(payload) - _HEADER
    writing = partial(cdr.write, data=address_of(payload) + _HEADER, length=length)
    vars(writing)["size"] = length
    return writing


def _deserialize(address: int, taken: list[bytes]) -> bool:
    """Put the payload that a Cdr reads into a list."""
    cdr = _cdr()
    assert cdr is not None
    buffer = _word_at(address + cdr.buffer).value
    data, size = _word_at(buffer + cdr.data).value, _word_at(buffer + cdr.size).value
    taken.append(ctypes.string_at(data, size))
    return True


SERIALIZE = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)(operator.call)
DESERIALIZE = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.py_object)(_deserialize)
SIZE = ctypes.PYFUNCTYPE(ctypes.c_uint32, ctypes.py_object)(operator.attrgetter("size"))
"""The callbacks of a type support (rosidl_typesupport_fastrtps_cpp/message_type_support.h)."""


@lru_cache(1)
def _cdr() -> _Cdr | None:
    """Find out the layout of a Cdr by making one; return None if it is not the expected one."""
    try:
        library = ctypes.PyDLL(_LIBRARY)  # the middleware has loaded it
        new_buffer = library[f"{_SPACE}10FastBufferC1EPcm"]
        new_cdr = library[f"{_SPACE}3CdrC1ERNS0_10FastBufferENS1_10EndiannessENS0_10CdrVersionE"]
        bytes_of = library[f"{_SPACE}3Cdr18get_buffer_pointerEv"]
        write = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)(
            (f"{_SPACE}3Cdr15serialize_arrayEPKcm", library), ((1, "cdr"), (1, "data"), (1, "length"))
        )
    except (OSError, AttributeError):
        return None
    new_buffer.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t]
    new_cdr.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_int]
    bytes_of.argtypes, bytes_of.restype = [ctypes.c_void_p], ctypes.c_void_p

    # 77 is a number that no other word of a FastBuffer has, so that `_place` finds it once.
    content, buffer, cdr = (ctypes.create_string_buffer(size) for size in (77, _ROOM, _ROOM))
    new_buffer(buffer, content, len(content))
    new_cdr(cdr, buffer, 1, 1)  # little endian, XCDR version 1
    write(cdr, b"here", 4)
    # What is called by addresses has no types: only its effect shows whether it is what its name says.
    if bytes_of(cdr) != ctypes.addressof(content) or content.raw[:5] != b"here\0":
        return None
    try:
        return _Cdr(
            buffer=_place(cdr, ctypes.addressof(buffer)),
            data=_place(buffer, ctypes.addressof(content)),
            size=_place(buffer, len(content)),
            write=write,
        )
    except LookupError:
        return None


def _place(memory: ctypes.Array[ctypes.c_char], word: int) -> int:
    """Return the place of a word that must occur once.

    Raises:
        LookupError: the word is missing or occurs several times.
    """
    found = [place for place in range(0, _ROOM, _WORD.size) if _WORD.unpack_from(memory, place) == (word,)]
    if len(found) != 1:
        raise LookupError(word)
    return found[0]

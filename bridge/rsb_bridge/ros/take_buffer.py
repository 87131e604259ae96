"""What messages are taken into: each large one into bytes of exactly its size, so that it is not copied once more.

rcl asks the allocator for more memory where a message is larger than the buffer, and says how large it is; what it gets
then is the content of a new bytes object. Struct: rcutils/allocator.h (ROS 2 Jazzy).
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING

from rsb_bridge.ros.serialization import Buffer

if TYPE_CHECKING:
    from collections.abc import Callable

_SMALL = 32 * 1024
"""Bytes up to which a copy costs less than a call from C."""

_new_bytes = ctypes.pythonapi.PyBytes_FromStringAndSize
_new_bytes.argtypes, _new_bytes.restype = [ctypes.c_void_p, ctypes.c_ssize_t], ctypes.py_object
_address_of = ctypes.pythonapi.PyBytes_AsString
_address_of.argtypes, _address_of.restype = [ctypes.py_object], ctypes.c_void_p
_REALLOCATE = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
_DEALLOCATE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)


class TakeBuffer(Buffer):
    """Takes one message at a time. It is shared by all that take on one thread."""

    def __init__(self) -> None:
        super().__init__()
        self._large: list[bytes] = []
        self._memory = ctypes.create_string_buffer(_SMALL)
        self._start = ctypes.addressof(self._memory)
        self._callbacks = _REALLOCATE(_growing(self._large)), _DEALLOCATE(_keep)
        self.allocator.reallocate, self.allocator.deallocate = (
            ctypes.cast(each, ctypes.c_void_p) for each in self._callbacks
        )
        self._shrink()

    def taken(self) -> bytes:
        """The message that was just taken; to be asked once."""
        if not self._large:
            return ctypes.string_at(self.data, self.length)
        payload = self._large.pop()
        self._shrink()
        return payload

    def discard(self) -> None:
        """Forget the message that was just taken."""
        if self._large:
            self._large.clear()
            self._shrink()

    def free(self) -> None:
        """Forget all. There is nothing of rcl's to free."""
        self.discard()

    def _shrink(self) -> None:
        self.data, self.capacity = self._start, _SMALL


def _growing(large: list[bytes]) -> Callable[[int | None, int, int | None], int | None]:
    """What stands for `realloc`. It refers to no buffer, which could not be freed at once otherwise."""

    def grow(_data: int | None, size: int, _state: int | None) -> int | None:
        try:
            payload: bytes = _new_bytes(None, size)
        except MemoryError:
            return None
        large[:] = [payload]
        address: int = _address_of(payload)
        return address

    return grow


def _keep(_data: int | None, _state: int | None) -> None:
    """What stands for `free`: the memory is Python's."""

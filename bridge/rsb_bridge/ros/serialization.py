"""Serializes messages of installed types, with zeros for padding. Struct: rcutils/types/uint8_array.h (ROS 2 Jazzy).

rclpy, as the middleware under it, leaves padding as it finds it in memory: up to 7 bytes before a number, of whatever
this process had there before. What crosses to a peer has to tell it nothing.
"""

from __future__ import annotations

import ctypes
from typing import Any

from rclpy.type_support import check_for_type_support

from rsb_bridge.ros.api import RosError
from rsb_bridge.ros.librcl import librcl, reset_error
from rsb_bridge.ros.typesupport import pointer_in, type_support_of


class _Allocator(ctypes.Structure):
    """A rcutils_allocator_t."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in ("allocate", "deallocate", "reallocate", "zero", "state"))


class Serialized(ctypes.Structure):
    """A rcl_serialized_message_t."""

    _fields_ = (
        ("data", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class Buffer(Serialized):
    """One that rcl makes larger as it needs."""

    def __init__(self) -> None:
        super().__init__()
        _buffer_init(self, 0, _default_allocator())

    def free(self) -> None:
        """To be called once."""
        _buffer_fini(self)


_default_allocator = librcl.rcutils_get_default_allocator
_default_allocator.restype = _Allocator
_buffer_init = librcl.rcutils_uint8_array_init
_buffer_init.argtypes = [ctypes.POINTER(Buffer), ctypes.c_size_t, ctypes.POINTER(_Allocator)]
_buffer_fini = librcl.rcutils_uint8_array_fini
_buffer_fini.argtypes = [ctypes.POINTER(Buffer)]
_serialize = librcl.rmw_serialize
_serialize.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.POINTER(Buffer)]

_CREATE = ctypes.PYFUNCTYPE(ctypes.c_void_p)
_CONVERT = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)
_DESTROY = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)
"""What a message class's metaclass has, in capsules: makes its C struct, fills it from a Python message, frees it."""


def serialize_message(message: Any) -> bytes:
    """As `rclpy.serialization.serialize_message`: CDR with its encapsulation header.

    It is written twice, as nobody tells its size before: the second time over zeros.

    Raises:
        RosError: the middleware refused it.
    """
    check_for_type_support(type(message))
    functions: Any = type(type(message))
    type_support = ctypes.addressof(type_support_of(type(message)))
    in_c = _CREATE(pointer_in(functions._CREATE_ROS_MESSAGE))()
    buffer = Buffer()
    try:
        _CONVERT(pointer_in(functions._CONVERT_FROM_PY))(message, in_c)  # raises what rclpy would
        code = _serialize(in_c, type_support, buffer)
        if not code:
            ctypes.memset(buffer.data, 0, buffer.capacity)
            code = _serialize(in_c, type_support, buffer)
        if code:
            reset_error()
            raise RosError(f"a {type(message).__name__} could not be serialized (rmw error {code})")
        return ctypes.string_at(buffer.data, buffer.length)
    finally:
        buffer.free()
        _DESTROY(pointer_in(functions._DESTROY_ROS_MESSAGE))(in_c)

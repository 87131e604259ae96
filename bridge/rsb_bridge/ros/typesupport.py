"""rosidl's type supports seen through ctypes, and the message classes that are installed here.

A message class keeps its type support in a capsule without a name: a pointer to rosidl_message_type_support_t, laid
out as in rosidl_runtime_c/message_type_support_struct.h and rosidl_runtime_c/type_hash.h (ROS 2 Jazzy).
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
from functools import cache
from pathlib import Path
from typing import Any

from rsb_bridge.model.type_names import split_type_name

HASH_PREFIX = "RIHS01_"


class TypeHash(ctypes.Structure):
    """A rosidl_type_hash_t."""

    _fields_ = (("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * 32))


class TypeSupport(ctypes.Structure):
    """A rosidl_message_type_support_t."""

    _fields_ = (
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("find", ctypes.c_void_p),
        ("get_hash", ctypes.c_void_p),
        ("get_description", ctypes.c_void_p),
        ("get_description_sources", ctypes.c_void_p),
    )


FIND = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
"""``TypeSupport.find``: a type support and an identifier in, the type support of that identifier or null out."""

GET_HASH = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
"""``TypeSupport.get_hash``: a type support in, the address of its `TypeHash` out."""

FIND_DESCRIPTION = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
"""``TypeSupport.get_description``: a type support in, the address of its type's description out."""

_capsule_get_pointer = ctypes.pythonapi.PyCapsule_GetPointer
_capsule_get_pointer.restype = ctypes.c_void_p
_capsule_get_pointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
_capsule_new = ctypes.pythonapi.PyCapsule_New
_capsule_new.restype = ctypes.py_object
_capsule_new.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]


def type_support_of(message_class: type) -> TypeSupport:
    """The type support of a message class, in place: it lives as long as the process."""
    metaclass: Any = type(message_class)
    if metaclass._TYPE_SUPPORT is None:
        metaclass.__import_type_support__()
    return TypeSupport.from_address(_capsule_get_pointer(metaclass._TYPE_SUPPORT, None))


def capsule_of(type_support: TypeSupport) -> object:
    """A capsule that rclpy takes for a message class's type support; the caller keeps `type_support` alive."""
    return _capsule_new(ctypes.addressof(type_support), None, None)


def hash_of(message_class: type) -> str:
    """The type hash (REP 2016) that the middleware announces for a message class: ``RIHS01_`` and 64 hex digits."""
    type_support = type_support_of(message_class)
    address = GET_HASH(type_support.get_hash)(ctypes.addressof(type_support))
    return HASH_PREFIX + bytes(TypeHash.from_address(address).value).hex()


@cache
def installed_class(type_name: str) -> type | None:
    """The message class of a type that is installed here, else None.

    Raises:
        ValueError: `type_name` is not of the form ``pkg/msg/Name``.
    """
    package, kind, name = split_type_name(type_name)
    if kind != "msg" or not _is_interface_package(package):
        return None
    try:
        messages = importlib.import_module(f"{package}.msg")
    except ImportError:  # it has services or actions only, or is broken
        return None
    found: type | None = getattr(messages, name, None)
    return found


def _is_interface_package(package: str) -> bool:
    """Whether rosidl generated a Python package: the name may come from a peer, and importing runs code."""
    spec = importlib.util.find_spec(package)
    locations = spec.submodule_search_locations if spec else None
    return any(any(Path(each).glob(f"{package}_s__rosidl_typesupport_c*.so")) for each in locations or ())

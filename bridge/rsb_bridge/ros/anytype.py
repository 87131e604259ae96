"""Message classes for raw use, of types that need not be installed.

Raw CDR needs no layout. rmw_fastrtps_cpp asks a type support for its name, its hash, a bound on its size and an
introspection handle, all while an endpoint is created; what knows the layout it calls only for messages that are not
raw. So a type support for a bare name and hash is std_msgs/String's (unbounded, no key) under another name and hash.
Layout of its inside: rosidl_typesupport_fastrtps_cpp/message_type_support.h (ROS 2 Jazzy). Other middlewares need the
layout, and other distributions lay the struct out otherwise: there the type's package must be installed.
"""

from __future__ import annotations

import ctypes
import re
from functools import cache
from importlib.metadata import version
from typing import TypeVar

from rclpy.utilities import get_rmw_implementation_identifier

from rsb_bridge.model.type_names import split_type_name
from rsb_bridge.ros.api import RosError
from rsb_bridge.ros.typesupport import (
    FIND,
    GET_HASH,
    HASH_PREFIX,
    TypeHash,
    TypeSupport,
    capsule_of,
    hash_of,
    installed_class,
    type_support_of,
)

_FASTRTPS = b"rosidl_typesupport_fastrtps_c"
_INTROSPECTION = b"rosidl_typesupport_introspection_c"
_JAZZY = "7.1."  # rclpy's version; ROS_DISTRO is set only where a setup file was sourced


class _Callbacks(ctypes.Structure):
    """A message_type_support_callbacks_t."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("serialize", ctypes.c_void_p),
        ("deserialize", ctypes.c_void_p),
        ("serialized_size", ctypes.c_void_p),
        ("max_serialized_size", ctypes.c_void_p),
        ("key_callbacks", ctypes.c_void_p),
    )


_MOST_TYPES = 2000
"""Types known by name alone: each takes 8 kB as long as the process lives, and a peer may name any."""

_Struct = TypeVar("_Struct", bound=ctypes.Structure)


def message_class(type_name: str, type_hash: str) -> type:
    """The class that rclpy creates raw endpoints of a type with: the installed one, else one made here.

    Args:
        type_name: ``pkg/msg/Name``.
        type_hash: ``RIHS01_...``, or empty where it is not known: then the type must be installed.

    Raises:
        RosError: it is installed with another hash, or it is not installed and cannot be done without.
    """
    try:
        installed = installed_class(type_name)
    except ValueError as error:
        raise RosError(str(error)) from None
    if installed is None:
        return _any_type(type_name, type_hash)
    here = hash_of(installed)  # which loads the type support too
    if type_hash not in {"", here}:
        raise RosError(
            f"{type_name} is another message here ({here}) than there ({type_hash}): "
            f"install the same version of {type_name.partition('/')[0]} on both sides"
        )
    return installed


@cache  # endpoints keep pointers into it, so a class lives as long as the process
def _any_type(type_name: str, type_hash: str) -> type:
    package, kind, name = split_type_name(type_name)
    remedy = f"install ros-jazzy-{package.replace('_', '-')}, or source the workspace that has it"
    if not type_hash:
        raise RosError(f"{type_name} is not installed and no publisher tells its type hash: {remedy}")
    if not re.fullmatch(HASH_PREFIX + "[0-9a-f]{64}", type_hash):
        raise RosError(f"{type_hash!r} is not a type hash: {HASH_PREFIX} and 64 hex digits")
    middleware = get_rmw_implementation_identifier()
    if middleware != "rmw_fastrtps_cpp" or not version("rclpy").startswith(_JAZZY):
        raise RosError(f"{type_name} is not installed, which only rmw_fastrtps_cpp on ROS 2 Jazzy can do: {remedy}")
    if _any_type.cache_info().currsize >= _MOST_TYPES:
        raise RosError(f"{type_name} is not installed, and {_MOST_TYPES:,} types are known by name already: {remedy}")
    return _build(f"{package}::{kind}", name, bytes.fromhex(type_hash.removeprefix(HASH_PREFIX)))


def _build(namespace: str, name: str, value: bytes) -> type:
    string = installed_class("std_msgs/msg/String")
    if string is None:
        raise RosError("std_msgs is not installed: install ros-jazzy-std-msgs")
    original = type_support_of(string)
    find_in_string = FIND(original.find)
    fastrtps = find_in_string(ctypes.addressof(original), _FASTRTPS)
    introspection = find_in_string(ctypes.addressof(original), _INTROSPECTION)

    type_support = _copy(TypeSupport.from_address(fastrtps))
    callbacks = _copy(_Callbacks.from_address(type_support.data))
    callbacks.namespace, callbacks.name = namespace.encode(), name.encode()
    type_hash = TypeHash(1, (ctypes.c_uint8 * 32)(*value))
    answers = {_FASTRTPS: ctypes.addressof(type_support), _INTROSPECTION: introspection}
    find = FIND(lambda _, identifier: answers.get(identifier))
    get_hash = GET_HASH(lambda _: ctypes.addressof(type_hash))
    type_support.data = ctypes.addressof(callbacks)
    type_support.find = ctypes.cast(find, ctypes.c_void_p).value
    type_support.get_hash = ctypes.cast(get_hash, ctypes.c_void_p).value

    # What rclpy looks for in a message class's metaclass. It converts no message: they are raw.
    metaclass = type(
        "AnyType",
        (type,),
        {
            "_TYPE_SUPPORT": capsule_of(type_support),
            "_CREATE_ROS_MESSAGE": None,
            "_CONVERT_FROM_PY": None,
            "_CONVERT_TO_PY": None,
            "_DESTROY_ROS_MESSAGE": None,
            "_keep_alive": (type_support, callbacks, type_hash, find, get_hash),
        },
    )
    made: type = metaclass(name, (), {})
    return made


def _copy(struct: _Struct) -> _Struct:
    return type(struct).from_buffer_copy(struct)

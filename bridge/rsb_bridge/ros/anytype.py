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
import threading
from functools import cache, partial
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

from rclpy.utilities import get_rmw_implementation_identifier

from rsb_bridge.model.names import split_type_name
from rsb_bridge.ros.api import RosError
from rsb_bridge.ros.typesupport import (
    FIND,
    GET_HASH,
    HASH_PATTERN,
    HASH_PREFIX,
    TypeHash,
    TypeSupport,
    capsule_of,
    hash_of,
    installed_class,
    type_support_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable

FASTRTPS = b"rosidl_typesupport_fastrtps_c"
_INTROSPECTION = b"rosidl_typesupport_introspection_c"
_JAZZY = "7.1."  # rclpy's version; ROS_DISTRO is set only where a setup file was sourced


class MessageCallbacks(ctypes.Structure):
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


_Struct = TypeVar("_Struct", bound=ctypes.Structure)


def borrow_type(type_name: str, type_hash: str) -> BorrowedType:
    """What rclpy creates raw endpoints of a type with: the installed class, else one made here.

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
        _check_named(type_name, type_hash)
        return named_types.borrow(type_name, type_hash)
    check_same(type_name, hash_of(installed), type_hash, "message")  # which loads the type support too
    return BorrowedType(installed, nothing)


def check_same(type_name: str, here: str, there: str, what: str) -> None:
    """Refuse a type that is installed with another hash.

    Raises:
        RosError: `there` is known, and is not `here`.
    """
    if there not in {"", here}:
        raise RosError(
            f"{type_name} is another {what} here ({here}) than there ({there}): "
            f"install the same version of {type_name.partition('/')[0]} on both sides"
        )


def remedy(type_name: str) -> str:
    """What to do where a type has to be installed."""
    package = split_type_name(type_name)[0]
    return f"install ros-jazzy-{package.replace('_', '-')}, or source the workspace that has it"


def layouts_known() -> bool:
    """Whether type supports of this middleware are laid out as this module knows them."""
    return get_rmw_implementation_identifier() == "rmw_fastrtps_cpp" and _is_jazzy()


@cache
def _is_jazzy() -> bool:
    from importlib.metadata import version  # noqa: PLC0415  2 MB, which installed messages do without

    return version("rclpy").startswith(_JAZZY)


def _check_named(type_name: str, type_hash: str) -> None:
    to_do = remedy(type_name)
    if not type_hash:
        raise RosError(f"{type_name} is not installed and no publisher tells its type hash: {to_do}")
    if not re.fullmatch(HASH_PATTERN, type_hash):
        raise RosError(f"{type_hash!r} is not a type hash: {HASH_PREFIX} and 64 hex digits")
    if not layouts_known():
        raise RosError(f"{type_name} is not installed, which only rmw_fastrtps_cpp on ROS 2 Jazzy can do: {to_do}")


class BorrowedType(NamedTuple):
    """A message or service class that an endpoint uses.

    Attributes:
        interface: for rclpy.
        give_back: to be called once, when the endpoint is gone.
    """

    interface: type
    give_back: Callable[[], None]


class NamedType(Protocol):
    """A type support under a name and a hash that can be changed while no endpoint uses it.

    Attributes:
        interface: the class by which rclpy finds it.
    """

    interface: type

    def rename(self, type_name: str, type_hash: str) -> None:
        """Be another type."""
        ...


class NamedTypes:
    """Types known by name and hash alone, each for as long as an endpoint uses it.

    One that nobody uses any more is renamed for the next type. None is ever freed: should the middleware keep a pointer
    to one, it points at valid memory.

    Attributes:
        made: how many there are, used or not.
    """

    def __init__(self, make: Callable[[], NamedType] | None = None) -> None:
        """Make none yet.

        Args:
            make: of messages or of services; None: of messages.
        """
        self.made = 0
        self._make = make or NamedMessage
        self._lock = threading.Lock()
        self._used: dict[tuple[str, str], _Used] = {}
        self._free: list[NamedType] = []

    @property
    def used(self) -> int:
        """How many types endpoints use now."""
        return len(self._used)

    def borrow(self, type_name: str, type_hash: str) -> BorrowedType:
        """The class of a type; endpoints of one type share it."""
        key = (type_name, type_hash)
        with self._lock:
            used = self._used.get(key)
            if used is None:
                used = _Used(self._free.pop() if self._free else self._another())
                used.named.rename(type_name, type_hash)
                self._used[key] = used
            used.users += 1
        return BorrowedType(used.named.interface, partial(self._give_back, key))

    def _another(self) -> NamedType:
        self.made += 1
        return self._make()

    def _give_back(self, key: tuple[str, str]) -> None:
        with self._lock:
            used = self._used[key]
            used.users -= 1
            if not used.users:
                self._free.append(self._used.pop(key).named)


class _Used:
    """A type, and the number of endpoints that use it."""

    def __init__(self, named: NamedType) -> None:
        self.named = named
        self.users = 0


class NamedSupport:
    """A message's type support under a name and a hash that can be changed.

    Attributes:
        type_support: for rcl and for the middleware.
        callbacks: which the middleware calls.
    """

    def __init__(self) -> None:
        string = installed_class("std_msgs/msg/String")
        if string is None:
            raise RosError("std_msgs is not installed: install ros-jazzy-std-msgs")
        original = type_support_of(string)
        find_in_string = FIND(original.find)
        fastrtps = find_in_string(ctypes.addressof(original), FASTRTPS)
        introspection = find_in_string(ctypes.addressof(original), _INTROSPECTION)

        type_support = self.type_support = _copy(TypeSupport.from_address(fastrtps))
        callbacks = self.callbacks = _copy(MessageCallbacks.from_address(type_support.data))
        type_hash = self._hash = TypeHash(version=1)
        answers = {FASTRTPS: ctypes.addressof(type_support), _INTROSPECTION: introspection}
        find = FIND(lambda _, identifier: answers.get(identifier))
        get_hash = GET_HASH(lambda _: ctypes.addressof(type_hash))
        type_support.data = ctypes.addressof(callbacks)
        type_support.find = ctypes.cast(find, ctypes.c_void_p).value
        type_support.get_hash = ctypes.cast(get_hash, ctypes.c_void_p).value
        self._keep_alive = (find, get_hash)

    def rename(self, type_name: str, type_hash: str) -> None:
        """Be another message."""
        package, kind, name = split_type_name(type_name)
        self.callbacks.namespace, self.callbacks.name = f"{package}::{kind}".encode(), name.encode()
        self._hash.value[:] = bytes.fromhex(type_hash.removeprefix(HASH_PREFIX))


class NamedMessage:
    """A message type; see `NamedType`."""

    def __init__(self) -> None:
        self._support = NamedSupport()
        # What rclpy looks for in a message class's metaclass. It converts no message: they are raw.
        metaclass = type(
            "AnyType",
            (type,),
            {
                "_TYPE_SUPPORT": capsule_of(self._support.type_support),
                "_CREATE_ROS_MESSAGE": None,
                "_CONVERT_FROM_PY": None,
                "_CONVERT_TO_PY": None,
                "_DESTROY_ROS_MESSAGE": None,
            },
        )
        self.interface: type = metaclass("Any", (), {})
        self.rename = self._support.rename


named_types = NamedTypes()
"""The process's: the middleware knows types by their names, whichever node uses them."""


def nothing() -> None:
    """An installed type is not given back."""


def _copy(struct: _Struct) -> _Struct:
    return type(struct).from_buffer_copy(struct)

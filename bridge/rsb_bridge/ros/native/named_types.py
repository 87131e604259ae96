"""Type supports under a name and a hash that can be changed, for raw endpoints of types that are not installed.

Raw CDR needs no layout. While an endpoint is created, rmw_fastrtps_cpp asks a type support for its name, its hash, a
bound on its size and, in some distributions, an introspection handle; rmw_cyclonedds_cpp asks the introspection handle
for the name, and whether the type has pointers. Both use the layout only for ordinary messages. So a type support for a
bare name and hash is std_msgs/String's (unbounded, no key) with these.

A service's type support is a struct with the type supports of its request and response. rcl has no function that takes
or sends a call serialized: it has the middleware take and send a ROS message, and rmw_fastrtps_cpp calls that message's
type support to write it to a Cdr, or to read it from one (`fast_cdr`).

Layouts: rosidl_typesupport_fastrtps_cpp/message_type_support.h and service_type_support.h,
rosidl_runtime_c/service_type_support_struct.h, rosidl_typesupport_introspection_c/message_introspection.h (ROS 2 Jazzy
and Kilted).
"""

from __future__ import annotations

import ctypes
import threading
from functools import cache, partial
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, TypeVar

from rsb_bridge.model.type_names import split_type_name
from rsb_bridge.ros.distribution import package_of
from rsb_bridge.ros.native import cyclone_dds
from rsb_bridge.ros.native.fast_cdr import DESERIALIZE, SERIALIZE, SIZE
from rsb_bridge.ros.native.typesupport import (
    FIND,
    GET_HASH,
    HASH_PREFIX,
    ServiceTypeSupport,
    TypeHash,
    TypeSupport,
    capsule_of,
    installed_class,
    type_support_of,
)
from rsb_bridge.ros.ros_interface import RosError, RosProblem

if TYPE_CHECKING:
    from collections.abc import Callable

FASTRTPS = b"rosidl_typesupport_fastrtps_c"
_INTROSPECTION = b"rosidl_typesupport_introspection_c"


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


class MessageMembers(ctypes.Structure):
    """A rosidl_typesupport_introspection_c__MessageMembers."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("count", ctypes.c_uint32),
        ("size", ctypes.c_size_t),
        ("has_key", ctypes.c_bool),
        ("members", ctypes.c_void_p),
        ("initialize", ctypes.c_void_p),
        ("finalize", ctypes.c_void_p),
    )


_Struct = TypeVar("_Struct", bound=ctypes.Structure)


class BorrowedType(NamedTuple):
    """A message or service class that an endpoint uses.

    Attributes:
        give_back: to be called once, when the endpoint is gone.
    """

    interface: type
    give_back: Callable[[], None]


class NamedTypes:
    """Types known by name and hash alone, each for as long as an endpoint uses it.

    One that nobody uses any more is renamed for the next type. None is ever freed: should the middleware keep a pointer
    to one, it points at valid memory.

    Attributes:
        made: how many there are, used or not.
    """

    def __init__(self, make: Callable[[], NamedType] | None = None) -> None:
        """Begin without types.

        Args:
            make: makes a type, or None for message types.
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
        """Return the class of a type; endpoints of one type share it."""
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
    """A message's type support under a name and a hash that can be changed."""

    def __init__(self) -> None:
        string = installed_class("std_msgs/msg/String")
        if string is None:
            raise RosError(RosProblem.NO_STRINGS(package=package_of("std_msgs")))
        original = type_support_of(string)
        find_in_string = FIND(original.find)
        fastrtps = find_in_string(ctypes.addressof(original), FASTRTPS)

        type_support = self.type_support = _copy(TypeSupport.from_address(fastrtps))
        callbacks = self.callbacks = _copy(MessageCallbacks.from_address(type_support.data))
        type_hash = self._hash = TypeHash(version=1)
        answers = {FASTRTPS: ctypes.addressof(type_support)}
        introspection = _copy(TypeSupport.from_address(find_in_string(ctypes.addressof(original), _INTROSPECTION)))
        members = self._members = _copy(MessageMembers.from_address(introspection.data))
        if cyclone_dds.is_used() or not _announces_fields():
            answers[_INTROSPECTION] = ctypes.addressof(introspection)
        find = FIND(lambda _, identifier: answers.get(identifier))
        get_hash = GET_HASH(lambda _: ctypes.addressof(type_hash))
        type_support.data, introspection.data = ctypes.addressof(callbacks), ctypes.addressof(members)
        # Both: with its original functions, either would lead to String's type supports and hash.
        for each in (type_support, introspection):
            each.find = ctypes.cast(find, ctypes.c_void_p).value
            each.get_hash = ctypes.cast(get_hash, ctypes.c_void_p).value
        self._keep_alive = (find, get_hash, introspection)

    def rename(self, type_name: str, type_hash: str) -> None:
        """Be another message."""
        package, kind, name = split_type_name(type_name)
        self.callbacks.namespace, self.callbacks.name = f"{package}::{kind}".encode(), name.encode()
        self._members.namespace, self._members.name = f"{package}__{kind}".encode(), name.encode()
        self._hash.value[:] = bytes.fromhex(type_hash.removeprefix(HASH_PREFIX))


class NamedMessage(NamedSupport):
    """A message type; see `NamedType`."""

    def __init__(self) -> None:
        super().__init__()
        # What rclpy looks for in a message class's metaclass. It converts no message: they are raw.
        metaclass = type(
            "AnyType",
            (type,),
            {
                "_TYPE_SUPPORT": capsule_of(self.type_support),
                "_CREATE_ROS_MESSAGE": None,
                "_CONVERT_FROM_PY": None,
                "_CONVERT_TO_PY": None,
                "_DESTROY_ROS_MESSAGE": None,
            },
        )
        self.interface: type = metaclass("Any", (), {})


class _Callbacks(ctypes.Structure):
    """A service_type_support_callbacks_t."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("request", ctypes.c_void_p),
        ("response", ctypes.c_void_p),
    )


class NamedService:
    """A service type; see `NamedType`."""

    def __init__(self) -> None:
        self._parts = request, response = NamedSupport(), NamedSupport()
        for part in self._parts:
            part.callbacks.serialize = ctypes.cast(SERIALIZE, ctypes.c_void_p).value
            part.callbacks.deserialize = ctypes.cast(DESERIALIZE, ctypes.c_void_p).value
            part.callbacks.serialized_size = ctypes.cast(SIZE, ctypes.c_void_p).value
        callbacks = self._callbacks = _Callbacks(
            request=ctypes.addressof(request.type_support), response=ctypes.addressof(response.type_support)
        )
        # rcl files what it makes of the hash and description of a type under that hash; the request's will do for it.
        like = request.type_support
        type_support = self._type_support = ServiceTypeSupport(
            identifier=FASTRTPS,
            data=ctypes.addressof(callbacks),
            request=ctypes.pointer(request.type_support),
            response=ctypes.pointer(response.type_support),
            get_hash=like.get_hash,
            get_description=like.get_description,
            get_description_sources=like.get_description_sources,
        )
        answers = {FASTRTPS: ctypes.addressof(type_support)}
        find = FIND(lambda _, identifier: answers.get(identifier))
        type_support.find = ctypes.cast(find, ctypes.c_void_p).value
        self._keep_alive = find
        metaclass = type("AnyType", (type,), {"_TYPE_SUPPORT": capsule_of(type_support)})
        self.interface: type = metaclass("AnyService", (), {})

    def rename(self, type_name: str, type_hash: str) -> None:
        """Be another service."""
        package, kind, name = split_type_name(type_name)
        self._callbacks.namespace, self._callbacks.name = f"{package}::{kind}".encode(), name.encode()
        for part, ending, each in zip(self._parts, ("_Request", "_Response"), type_hash.split("+"), strict=True):
            part.rename(type_name + ending, each)


NamedType: TypeAlias = NamedMessage | NamedService
"""A type support under a name and a hash that can be changed while no endpoint uses it.

Its `interface` is the class by which rclpy finds it.
"""


@cache
def fast_dds_keys(message_class: type) -> bool:
    """Whether endpoints of an installed class have a key for Fast DDS, or nothing here tells."""
    if cyclone_dds.is_used():
        return False
    type_support = type_support_of(message_class)
    found = FIND(type_support.find)(ctypes.addressof(type_support), _INTROSPECTION)
    if found is None:  # without the package's library for introspection
        return True
    members = MessageMembers.from_address(TypeSupport.from_address(found).data)
    return bool(members.has_key)


@cache
def _announces_fields() -> bool:
    """Whether rmw_fastrtps_cpp announces the fields of a type that has an introspection handle, as from Kilted on.

    Endpoints of other processes match only if their fields are the same, and String's are not. Before, it announces
    nothing, and demands the handle.
    """
    try:
        library = ctypes.PyDLL("librmw_fastrtps_shared_cpp.so")  # the middleware has loaded it
    except OSError:
        return True
    return hasattr(library, "_ZN23rmw_fastrtps_shared_cpp11TypeSupport35register_type_object_representationEv")


def _copy(struct: _Struct) -> _Struct:
    return type(struct).from_buffer_copy(struct)


named_types = NamedTypes()
"""The process's messages: the middleware identifies a type by its name for all nodes."""
named_services = NamedTypes(NamedService)
"""The process's services."""


def nothing() -> None:
    """An installed type is not given back."""

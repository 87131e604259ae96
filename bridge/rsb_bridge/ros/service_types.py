"""Service classes for raw use, of types that need not be installed.

As `rsb_bridge.ros.anytype` for messages: a service's type support is a struct with those of its request and response,
whose callbacks here copy bytes (`rsb_bridge.ros.raw_cdr`). Where that cannot be, with another middleware or another
version of it, the service's package has to be installed, and rclpy converts the messages.
Layouts: rosidl_runtime_c/service_type_support_struct.h, rosidl_typesupport_fastrtps_cpp/service_type_support.h.
"""

from __future__ import annotations

import ctypes
import re
from typing import NamedTuple

from rsb_bridge.model.names import split_type_name
from rsb_bridge.ros import raw_cdr
from rsb_bridge.ros.anytype import (
    FASTRTPS,
    BorrowedType,
    NamedSupport,
    NamedTypes,
    check_same,
    layouts_known,
    nothing,
    remedy,
)
from rsb_bridge.ros.api import RosError
from rsb_bridge.ros.typesupport import (
    FIND,
    HASH_PATTERN,
    HASH_PREFIX,
    ServiceTypeSupport,
    capsule_of,
    installed_service,
    service_hash_of,
)

_HASHES = re.compile(rf"({HASH_PATTERN})\+({HASH_PATTERN})")


class BorrowedService(NamedTuple):
    """A service class that an endpoint uses.

    Attributes:
        type: its class, and how to give it back.
        raw: calls are carried as bytes; else as the installed class's messages.
    """

    type: BorrowedType
    raw: bool


def borrow_service(type_name: str, type_hash: str) -> BorrowedService:
    """What rclpy creates a service's endpoints with.

    Args:
        type_name: ``pkg/srv/Name``, or ``pkg/action/Name_SendGoal`` and the like.
        type_hash: as `rsb_bridge.ros.api.RosInterface.servers` gives it, or empty where it is not known: then the type
            must be installed.

    Raises:
        RosError: it is installed with another hash, or it is not installed and cannot be done without.
    """
    try:
        installed = installed_service(type_name)
        kind = split_type_name(type_name)[1]
    except ValueError:
        kind, installed = "", None
    if kind not in {"srv", "action"}:
        raise RosError(f"{type_name!r} is not a service type: write it as package/srv/Name")
    if installed is not None:
        here = service_hash_of(installed)
        check_same(type_name, here, type_hash, "service")
        type_hash = here
    reason = why_not_raw()
    if installed is not None and reason:
        return BorrowedService(BorrowedType(installed, nothing), raw=False)
    if not type_hash:
        raise RosError(f"{type_name} is not installed and no node tells its type hash: {remedy(type_name)}")
    if not _HASHES.fullmatch(type_hash):
        raise RosError(f"{type_hash!r} is not a service's hash: two of {HASH_PREFIX} and 64 hex digits, with + between")
    if reason:
        raise RosError(f"{type_name} is not installed, and {reason}: {remedy(type_name)}")
    return BorrowedService(named_services.borrow(type_name, type_hash), raw=True)


def why_not_raw() -> str:
    """Why calls of types that are not installed cannot be carried here; empty: they can."""
    if not layouts_known():
        return "only rmw_fastrtps_cpp on ROS 2 Jazzy can do without"
    if not raw_cdr.usable():
        return "this version of Fast CDR is not one that can do without"
    return ""


class _Callbacks(ctypes.Structure):
    """A service_type_support_callbacks_t."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("request", ctypes.c_void_p),
        ("response", ctypes.c_void_p),
    )


class NamedService:
    """A service type; see `rsb_bridge.ros.anytype.NamedType`."""

    def __init__(self) -> None:
        self._parts = request, response = NamedSupport(), NamedSupport()
        for part in self._parts:
            part.callbacks.serialize = ctypes.cast(raw_cdr.SERIALIZE, ctypes.c_void_p).value
            part.callbacks.deserialize = ctypes.cast(raw_cdr.DESERIALIZE, ctypes.c_void_p).value
            part.callbacks.serialized_size = ctypes.cast(raw_cdr.SIZE, ctypes.c_void_p).value
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


named_services = NamedTypes(NamedService)
"""The process's."""

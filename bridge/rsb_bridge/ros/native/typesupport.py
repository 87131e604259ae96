"""rosidl's type supports seen through ctypes, and the message and service classes that are installed here.

A class keeps its type support in a capsule without a name: a pointer to rosidl_message_type_support_t or
rosidl_service_type_support_t, laid out as in rosidl_runtime_c/message_type_support_struct.h,
service_type_support_struct.h and type_hash.h (ROS 2 Jazzy and Kilted).
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import sys
import threading
import time
from functools import lru_cache
from pathlib import Path
from typing import Any

from rsb_bridge.model.type_names import split_type_name

HASH_PREFIX = "RIHS01_"
HASH_PATTERN = f"{HASH_PREFIX}[0-9a-f]{{64}}"
_REMEMBERED = 4096
"""Names of types that are not installed which are remembered: a peer may name any type."""
_LOOKED_FOR_EVERY = 10.0
"""s, about, after which a type that was not installed is looked for again. A look takes some 0.1 ms for each folder of
`sys.path`, and hundreds of topics may wait for their types. Not measured."""


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


class ServiceTypeSupport(ctypes.Structure):
    """A rosidl_service_type_support_t."""

    _fields_ = (
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("find", ctypes.c_void_p),
        ("request", ctypes.POINTER(TypeSupport)),
        ("response", ctypes.POINTER(TypeSupport)),
        ("event", ctypes.c_void_p),
        ("event_create", ctypes.c_void_p),
        ("event_destroy", ctypes.c_void_p),
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
    """Return the type support of a message class, in place: it lives as long as the process."""
    return TypeSupport.from_address(_address_of(message_class))


def capsule_of(type_support: TypeSupport | ServiceTypeSupport) -> object:
    """Return a capsule that rclpy takes for a class's type support; the caller keeps `type_support` alive."""
    return _capsule_new(ctypes.addressof(type_support), None, None)


def pointer_in(capsule: object) -> int:
    """Return the pointer in a capsule without a name."""
    pointer: int = _capsule_get_pointer(capsule, None)
    return pointer


def hash_of(message_class: type) -> str:
    """Return the type hash (REP 2016) of a message class, as the middleware has it: ``RIHS01_`` and 64 hex digits."""
    return _hash_of(type_support_of(message_class))


def service_hash_of(service_class: type) -> str:
    """Return the hash that tells versions of a service apart; see `RosInterface.servers`."""
    type_support = ServiceTypeSupport.from_address(_address_of(service_class))
    return joined_hash(_hash_of(type_support.request.contents), _hash_of(type_support.response.contents))


def joined_hash(request: str, response: str) -> str:
    """Return a service's hash, of its request's and its response's; empty where one is not known."""
    return f"{request}+{response}" if request and response else ""


def _address_of(interface: type) -> int:
    metaclass: Any = type(interface)
    if metaclass._TYPE_SUPPORT is None:
        _leave_out_generator()
        metaclass.__import_type_support__()
    return pointer_in(metaclass._TYPE_SUPPORT)


_GENERATOR = "rosidl_generator_py"
_leaving_out = threading.Lock()
"""Types are loaded on several threads."""


def _leave_out_generator() -> None:
    """Import what loads type supports without what generates Python code for them.

    The package imports both, and does without the second where that cannot be imported, as in an installation without
    its parser. That takes 5 MB of memory and a tenth of the time in which a bridge starts.
    """
    with _leaving_out:
        if _GENERATOR in sys.modules:
            return
        part = f"{_GENERATOR}.generate_py_impl"
        modules: dict[str, Any] = sys.modules
        modules[part] = None  # which has its import fail
        try:
            importlib.import_module(_GENERATOR)
        except ImportError:
            pass  # its user reports that
        finally:
            del modules[part]


def _hash_of(type_support: TypeSupport) -> str:
    address = GET_HASH(type_support.get_hash)(ctypes.addressof(type_support))
    return HASH_PREFIX + bytes(TypeHash.from_address(address).value).hex()


def installed_class(type_name: str) -> type | None:
    """Return the message class of a type that is installed here, else None. No class changes until the process ends.

    Messages inside services and actions are found, too: ``pkg/srv/Name_Request``, ``pkg/action/Name_FeedbackMessage``.

    Raises:
        ValueError: `type_name` is not of the form ``pkg/msg/Name``.
    """
    found = _installed(type_name)
    return found if hasattr(found, "get_fields_and_field_types") else None


def installed_service(type_name: str) -> type | None:
    """Return the class of a service that is installed here, else None.

    Raises:
        ValueError: `type_name` is not of the form ``pkg/srv/Name``, as ``pkg/action/Name_SendGoal`` is.
    """
    found = _installed(type_name)
    return found if hasattr(found, "Request") and hasattr(found, "Response") else None


_found: dict[str, type] = {}  # as many as are installed


def _installed(type_name: str) -> type | None:
    found = _found.get(type_name) or _look_for(type_name, time.monotonic() // _LOOKED_FOR_EVERY)
    if found is not None:
        _found[type_name] = found
    return found


@lru_cache(_REMEMBERED)
def _look_for(type_name: str, _turn: float) -> type | None:
    """Return a class that is installed, or None, for a while: an operator may install what a text of ours names."""
    package, kind, name = split_type_name(type_name)
    if not _is_interface_package(package):
        return None
    try:
        interfaces = importlib.import_module(f"{package}.{kind}")
    except ImportError:  # it has none of that kind, or is broken
        return None
    # The module of an interface has the interfaces inside it, too; its own name has no underscore (ROS's naming rules).
    outermost = getattr(interfaces, name.partition("_")[0], None)
    found: type | None = getattr(sys.modules.get(getattr(outermost, "__module__", "")), name, None)
    return found


def _is_interface_package(package: str) -> bool:
    """Whether rosidl generated a Python package: the name may come from a peer, and importing runs code."""
    spec = importlib.util.find_spec(package)
    locations = spec.submodule_search_locations if spec else None
    return any(any(Path(each).glob(f"{package}_s__rosidl_typesupport_c*.so")) for each in locations or ())

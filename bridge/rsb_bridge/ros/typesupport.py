"""The type supports of rosidl, seen through ctypes: the classes installed here, their hashes and descriptions.

A class keeps its type support in a capsule without a name: a pointer to rosidl_message_type_support_t or
rosidl_service_type_support_t, laid out as in rosidl_runtime_c/message_type_support_struct.h,
service_type_support_struct.h and type_hash.h (ROS 2 Jazzy). Into it rosidl compiles the type's description: structs of
type_description_interfaces as C (rosidl_runtime_c/type_description/*__struct.h).
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
from typing import TYPE_CHECKING, Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import qos_profile_services_default
from rclpy.type_support import check_for_type_support

from rsb_bridge.cdr.description import DESCRIPTION_LIMIT, Field, FieldType, MessageType, TypeDescription, text_of
from rsb_bridge.model.names import split_type_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

HASH_PREFIX = "RIHS01_"
HASH_PATTERN = f"{HASH_PREFIX}[0-9a-f]{{64}}"
_REMEMBERED = 4096
"""Type names whose class, or that there is none, is remembered: a peer may name any."""


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
    """The type support of a message class, in place: it lives as long as the process."""
    return TypeSupport.from_address(_address_of(message_class))


def capsule_of(type_support: TypeSupport | ServiceTypeSupport) -> object:
    """A capsule that rclpy takes for a class's type support; the caller keeps `type_support` alive."""
    return _capsule_new(ctypes.addressof(type_support), None, None)


def pointer_in(capsule: object) -> int:
    """What a capsule without a name holds."""
    pointer: int = _capsule_get_pointer(capsule, None)
    return pointer


def hash_of(message_class: type) -> str:
    """The type hash (REP 2016) that the middleware announces for a message class: ``RIHS01_`` and 64 hex digits."""
    return _hash_of(type_support_of(message_class))


def service_hash_of(service_class: type) -> str:
    """What tells versions of a service apart; see `rsb_bridge.ros.api.RosInterface.servers`."""
    type_support = ServiceTypeSupport.from_address(_address_of(service_class))
    return joined_hash(_hash_of(type_support.request.contents), _hash_of(type_support.response.contents))


def joined_hash(request: str, response: str) -> str:
    """A service's hash, of its request's and its response's; empty where one is not known."""
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
        if _GENERATOR not in sys.modules:
            _import_without_generator()


def _import_without_generator() -> None:
    part = f"{_GENERATOR}.generate_py_impl"
    modules: dict[str, Any] = sys.modules
    modules[part] = None  # which has its import fail
    try:
        importlib.import_module(_GENERATOR)
    except ImportError:
        pass  # whoever needs it says so
    finally:
        del modules[part]


def _hash_of(type_support: TypeSupport) -> str:
    address = GET_HASH(type_support.get_hash)(ctypes.addressof(type_support))
    return HASH_PREFIX + bytes(TypeHash.from_address(address).value).hex()


@lru_cache(_REMEMBERED)
def installed_class(type_name: str) -> type | None:
    """The message class of a type that is installed here, else None.

    Messages inside services and actions are found, too: ``pkg/srv/Name_Request``, ``pkg/action/Name_FeedbackMessage``.

    Raises:
        ValueError: `type_name` is not of the form ``pkg/msg/Name``.
    """
    found = _installed(type_name)
    return found if hasattr(found, "get_fields_and_field_types") else None


@lru_cache(_REMEMBERED)
def installed_service(type_name: str) -> type | None:
    """The class of a service that is installed here, else None.

    Raises:
        ValueError: `type_name` is not of the form ``pkg/srv/Name``, as ``pkg/action/Name_SendGoal`` is.
    """
    found = _installed(type_name)
    return found if hasattr(found, "Request") and hasattr(found, "Response") else None


def _installed(type_name: str) -> type | None:
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


_SERVED_WITHIN = 0.5  # s: from when the client exists to when DDS has matched it
_ANSWERED_WITHIN = 2.0  # s
_SLICE_NS = 50_000_000


class _String(ctypes.Structure):
    """A rosidl_runtime_c__String."""

    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t))

    def __str__(self) -> str:
        return ctypes.string_at(self.data, self.size).decode() if self.size else ""


class _Sequence(ctypes.Structure):
    """A sequence of structs."""

    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t))

    def of(self, kind: type[Any]) -> Iterator[Any]:
        """Its elements."""
        for number in range(self.size):
            yield kind.from_address(self.data + number * ctypes.sizeof(kind))


class _FieldType(ctypes.Structure):
    _fields_ = (
        ("type_id", ctypes.c_uint8),
        ("capacity", ctypes.c_uint64),
        ("string_capacity", ctypes.c_uint64),
        ("nested_type_name", _String),
    )


class _Field(ctypes.Structure):
    _fields_ = (("name", _String), ("type", _FieldType), ("default_value", _String))


class _MessageType(ctypes.Structure):
    _fields_ = (("type_name", _String), ("fields", _Sequence))


class _TypeDescription(ctypes.Structure):
    _fields_ = (("type_description", _MessageType), ("referenced_type_descriptions", _Sequence))


def installed_description(type_name: str) -> str | None:
    """The text of the description of a type that is installed here; None: it is not.

    Raises:
        ValueError: `type_name` is not of the form ``pkg/msg/Name``.
    """
    found = installed_class(type_name)
    if found is None:
        return None
    type_support = type_support_of(found)
    if not type_support.get_description:
        return None
    address = FIND_DESCRIPTION(type_support.get_description)(ctypes.addressof(type_support))
    if not address:
        return None
    described = _TypeDescription.from_address(address)
    types = [_message_type(each, [*each.fields.of(_Field)]) for each in _all(described)]
    return text_of(TypeDescription(types[0], tuple(types[1:])))


def _all(described: _TypeDescription) -> Iterator[_MessageType]:
    yield described.type_description
    yield from described.referenced_type_descriptions.of(_MessageType)


def _message_type(described: Any, fields: list[Any]) -> MessageType:
    """A type, from its C struct or its Python message, which have the same attributes."""
    return MessageType(
        str(described.type_name), tuple(Field(str(each.name), _field_type(each.type)) for each in fields)
    )


def _field_type(described: Any) -> FieldType:
    return FieldType(
        int(described.type_id),
        int(described.capacity),
        int(described.string_capacity),
        str(described.nested_type_name),
    )


def ask_node(
    own: Any,
    context: Any,
    node: str,
    type_name: str,
    type_hash: str,
    still_wanted: Callable[[], bool],
    entities: threading.RLock,
) -> str | None:
    """Ask a node for the description of a type that it uses, by its ``~/get_type_description`` service.

    Takes some seconds at most.

    Args:
        own: our node, rclpy's handle.
        context: likewise.
        node: full name of the node to ask.
        type_name: ``pkg/msg/Name``.
        type_hash: ``RIHS01_...``.
        still_wanted: asked several times a second; False ends the waiting.
        entities: held while our node's endpoints are created or freed.

    Returns:
        The text; None: it does not serve it, or does not answer.

    Raises:
        RuntimeError: rcl failed.
    """
    try:
        from type_description_interfaces.srv import GetTypeDescription  # noqa: PLC0415 (not every ROS has it)
    except ImportError:
        return None
    check_for_type_support(GetTypeDescription)
    profile = qos_profile_services_default.get_c_qos_profile()
    with entities:
        client = _rclpy.Client(own, GetTypeDescription, f"{node}/get_type_description", profile)
    waits = _rclpy.WaitSet(0, 0, 0, 1, 0, 0, context)
    try:
        deadline = time.monotonic() + _SERVED_WITHIN
        while not client.service_server_is_available():
            if time.monotonic() > deadline or not still_wanted():
                return None
            time.sleep(_SLICE_NS / 1e9)
        client.send_request(GetTypeDescription.Request(type_name=type_name, type_hash=type_hash))
        deadline = time.monotonic() + _ANSWERED_WITHIN
        while time.monotonic() < deadline and still_wanted():
            waits.clear_entities()
            waits.add_client(client)
            waits.wait(_SLICE_NS)
            if waits.get_ready_entities("client"):
                _, answer = client.take_response(GetTypeDescription.Response)
                return _answered(answer)
    finally:
        waits.destroy_when_not_in_use()
        with entities:
            client.destroy_when_not_in_use()
    return None


def _answered(answer: Any) -> str | None:
    if answer is None or not answer.successful:
        return None
    described = answer.type_description
    types = (described.type_description, *described.referenced_type_descriptions)
    if sum(len(each.fields) for each in types) > DESCRIPTION_LIMIT // 32:  # each takes more characters than that
        return None
    found = [_message_type(each, list(each.fields)) for each in types]
    return text_of(TypeDescription(found[0], tuple(found[1:])))

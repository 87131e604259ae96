"""Descriptions of installed message types, and of types that other nodes describe.

rosidl compiles a type's description into its type support: structs of
type_description_interfaces as C (rosidl_runtime_c/type_description/*__struct.h, ROS 2 Jazzy).
"""

from __future__ import annotations

import ctypes
import time
from typing import TYPE_CHECKING, Any

from rclpy.type_support import check_for_type_support

from rsb_bridge.cdr.description import (
    DESCRIPTION_LIMIT,
    FieldType,
    MessageField,
    MessageType,
    TypeDescription,
    text_of,
)
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.native.rclpy_extension import wait_set
from rsb_bridge.ros.native.typesupport import FIND_DESCRIPTION, installed_class, type_support_of

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Iterator

    from rclpy.context import Context

    from rsb_bridge.ros.native.rclpy_extension import OwnNode

_SERVED_WITHIN = 0.5  # s: from when the client exists to when DDS has matched it
_ANSWERED_WITHIN = 2.0  # s: a round figure
_SLICE_NS = 50_000_000
"""Between two questions whether the answer is still wanted: a bridge that stops waits for this one's end."""
_QOS = Qos("reliable", "volatile", "keep_last", 10)
"""That of services by default (rmw/qos_profiles.h)."""


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
    """Return the text of an installed type's description, or None if the type is not installed.

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
    """Return a type, from its C struct or its Python message, which have the same attributes."""
    return MessageType(
        str(described.type_name), tuple(MessageField(str(each.name), _field_type(each.type)) for each in fields)
    )


def _field_type(described: Any) -> FieldType:
    return FieldType(
        int(described.type_id),
        int(described.capacity),
        int(described.string_capacity),
        str(described.nested_type_name),
    )


def ask_node(
    own: OwnNode,
    context: Context,
    node: str,
    type_name: str,
    type_hash: str,
    still_wanted: Callable[[], bool],
    entities: threading.RLock,
) -> str | None:
    """Ask a node for the description of a type that it uses, by its ``~/get_type_description`` service.

    Takes some seconds at most.

    Args:
        node: full name of the node to ask.
        still_wanted: asked several times a second; False ends the waiting.
        entities: held while our node's endpoints are created or freed.

    Returns:
        The text, or None if the node lacks that service or does not answer.

    Raises:
        RuntimeError: rcl failed.
    """
    try:
        from type_description_interfaces.srv import GetTypeDescription  # noqa: PLC0415 (not every ROS has it)
    except ImportError:
        return None
    check_for_type_support(GetTypeDescription)  # which the extension module takes for loaded
    with entities:
        entity = own.create("client", GetTypeDescription, f"{node}/get_type_description", _QOS)
    # A wait set of its own: the other one belongs to the ROS thread.
    client, waits = entity.rclpy, wait_set(context, clients=1)
    try:
        deadline = time.monotonic() + _SERVED_WITHIN
        # A request to a server that DDS has not matched yet is lost.
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
            entity.destroy()
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

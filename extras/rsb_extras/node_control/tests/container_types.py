"""The types of a container's services (composition_interfaces), described for their hashes (REP 2016)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.cdr.description import FieldType, MessageField, MessageType, TypeDescription, hash_of_text, text_of

if TYPE_CHECKING:
    from collections.abc import Iterator

_IDS = {
    "uint8": 3, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9, "double": 11, "bool": 15, "byte": 16, "string": 17,
}  # fmt: skip
_NESTED, _ARRAY, _BOUNDED, _SEQUENCE = 1, 48, 96, 144
_PARAMETERS = "rcl_interfaces/msg/Parameter[]"
_FIELDS = {
    "builtin_interfaces/msg/Time": "sec int32, nanosec uint32",
    "service_msgs/msg/ServiceEventInfo": (
        "event_type uint8, stamp builtin_interfaces/msg/Time, client_gid uint8[16], sequence_number int64"
    ),
    "rcl_interfaces/msg/Parameter": "name string, value rcl_interfaces/msg/ParameterValue",
    "rcl_interfaces/msg/ParameterValue": (
        "type uint8, bool_value bool, integer_value int64, double_value double, string_value string, "
        "byte_array_value byte[], bool_array_value bool[], integer_array_value int64[], double_array_value double[], "
        "string_array_value string[]"
    ),
    "composition_interfaces/srv/ListNodes_Request": "structure_needs_at_least_one_member uint8",
    "composition_interfaces/srv/ListNodes_Response": "full_node_names string[], unique_ids uint64[]",
    "composition_interfaces/srv/LoadNode_Request": (
        "package_name string, plugin_name string, node_name string, node_namespace string, log_level uint8, "
        f"remap_rules string[], parameters {_PARAMETERS}, extra_arguments {_PARAMETERS}"
    ),
    "composition_interfaces/srv/LoadNode_Response": (
        "success bool, error_message string, full_node_name string, unique_id uint64"
    ),
    "composition_interfaces/srv/UnloadNode_Request": "unique_id uint64",
    "composition_interfaces/srv/UnloadNode_Response": "success bool, error_message string",
}
for _service in ("ListNodes", "LoadNode", "UnloadNode"):
    _name = f"composition_interfaces/srv/{_service}"
    _FIELDS[_name] = f"request_message {_name}_Request, response_message {_name}_Response, event_message {_name}_Event"
    _FIELDS[f"{_name}_Event"] = (
        f"info service_msgs/msg/ServiceEventInfo, request {_name}_Request[<=1], response {_name}_Response[<=1]"
    )


def _field_type(text: str) -> FieldType:
    element, _, count = text.partition("[")
    shape, capacity = 0, 0
    if count == "]":
        shape = _SEQUENCE
    elif count:
        shape, capacity = (_BOUNDED if count.startswith("<=") else _ARRAY), int(count.strip("<=]"))
    nested = "" if element in _IDS else element
    return FieldType(shape + _IDS.get(element, _NESTED), capacity, 0, nested)


def _message_type(name: str) -> MessageType:
    fields = (each.split(" ", 1) for each in _FIELDS[name].split(", "))
    return MessageType(name, tuple(MessageField(field, _field_type(kind)) for field, kind in fields))


def _referenced(name: str) -> Iterator[str]:
    for field in _message_type(name).fields:
        if field.type.nested_type_name:
            yield field.type.nested_type_name
            yield from _referenced(field.type.nested_type_name)


def type_hash(name: str) -> str:
    """Return the hash of a type, ``RIHS01_`` and 64 hex digits."""
    others = sorted({*_referenced(name)})
    return hash_of_text(text_of(TypeDescription(_message_type(name), tuple(map(_message_type, others)))))


def service_hash(name: str) -> str:
    """Return the hash of a service as the bridge has it, of its request and its response."""
    return f"{type_hash(f'{name}_Request')}+{type_hash(f'{name}_Response')}"

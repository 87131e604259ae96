"""Helpers of `test_decoder` and others."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator

from rsb_bridge.cdr.description import (
    FieldType,
    MessageField,
    MessageType,
    TypeDescription,
    read_description,
)
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_bridge.ros.native.typesupport import hash_of, installed_class

PACKAGES = [
    "action_msgs", "actionlib_msgs", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "lifecycle_msgs",
    "nav_msgs", "rcl_interfaces", "rosgraph_msgs", "sensor_msgs", "service_msgs", "shape_msgs", "std_msgs",
    "stereo_msgs", "trajectory_msgs", "type_description_interfaces", "unique_identifier_msgs", "visualization_msgs",
]  # fmt: skip


def installed() -> Iterator[str]:
    for package in PACKAGES:
        for module in pkgutil.iter_modules(importlib.import_module(f"{package}.msg").__path__):
            found = importlib.import_module(f"{package}.msg.{module.name}")
            yield from (f"{package}/msg/{name}" for name in vars(found) if isinstance(vars(found)[name], type))


TYPES = sorted({name for name in installed() if "Metaclass" not in name and installed_class(name)})


def described(name: str) -> TypeDescription:
    text = installed_description(name)
    assert text is not None
    return read_description(text, hash_of(installed_class(name)))  # type: ignore[arg-type]


INNER = MessageType(
    "t/msg/Inner",
    (
        MessageField("a", FieldType(3, 0, 0, "")),
        MessageField("b", FieldType(11, 0, 0, "")),
        MessageField("w", FieldType(18, 0, 0, "")),
    ),
)


def of(*fields: tuple[str, int, int, int, str]) -> TypeDescription:
    """A description with fields of (name, type id, capacity, capacity of strings, nested type)."""
    return TypeDescription(
        MessageType("t/msg/T", tuple(MessageField(f[0], FieldType(*f[1:])) for f in fields)), (INNER,)
    )

"""The types of parameters, by their names on the wire and in options."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

ParameterType: TypeAlias = Literal[
    "not_set", "bool", "integer", "double", "string",
    "byte_array", "bool_array", "integer_array", "double_array", "string_array",
]  # fmt: skip
"""At its number in rcl_interfaces/msg/ParameterType."""
PARAMETER_TYPES: tuple[ParameterType, ...] = get_args(ParameterType)

"""Helpers of `test_messages` and others."""

from __future__ import annotations

import typing
from functools import partial
from typing import Any

import msgspec

from rsb_bridge.wire import messages


def filled(kind: msgspec.inspect.Type, default: object = None, *, all_fields: bool = True) -> Any:
    """Return a value of a type, as plain data, in which no field has its default, or which has only what it must."""
    inspect, inner = msgspec.inspect, partial(filled, all_fields=all_fields)
    match kind:
        case inspect.StructType():
            wanted = [field for field in kind.fields if all_fields or field.required]
            if kind.array_like:
                return [inner(field.type, field.default) for field in wanted]
            tag = {} if kind.tag is None else {kind.tag_field: kind.tag}
            return tag | {field.encode_name: inner(field.type, field.default) for field in wanted}
        case inspect.VarTupleType():
            return [inner(kind.item_type)] * (1 if all_fields else kind.min_length or 0)
        case inspect.TupleType():
            return [*map(inner, kind.item_types)]
        case inspect.DictType():
            return {inner(kind.key_type): inner(kind.value_type)} if all_fields else {}
        case inspect.UnionType():
            return inner(next(each for each in kind.types if not isinstance(each, inspect.NoneType)), default)
        case inspect.LiteralType():
            return next(each for each in kind.values if each != default)
        case inspect.EnumType():
            return next(each.value for each in kind.cls if each != default)
        case inspect.IntType() | inspect.FloatType():
            return min(3, 3 if kind.le is None else kind.le)
        case inspect.BytesType():
            return b"x" * (kind.min_length or 3)
        case inspect.BoolType():
            return default is not True
    assert isinstance(kind, inspect.StrType)
    return "größer"


KINDS: tuple[type[messages.ControlMessage], ...] = typing.get_args(messages.ControlMessage)


PLAIN = [filled(msgspec.inspect.type_info(kind), all_fields=each) for kind in KINDS for each in (True, False)]
"""Two of each message, as plain data."""

"""Differences between versions of a message type, in words and by codes."""

from __future__ import annotations

from typing import Any

import pytest

from rsb_bridge.cdr.description import (
    FieldType,
    MessageField,
    MessageType,
    TypeDescription,
    TypeDifference,
    difference_of_texts,
    difference_of_types,
    text_of,
    type_text,
)

FLOAT, STRING, INT = FieldType(10, 0, 0, ""), FieldType(17, 0, 0, ""), FieldType(6, 0, 0, "")
POINT = FieldType(1, 0, 0, "a_msgs/msg/Point")


def described(*fields: tuple[str, FieldType], **others: tuple[tuple[str, FieldType], ...]) -> TypeDescription:
    def message(name: str, of: tuple[tuple[str, FieldType], ...]) -> MessageType:
        return MessageType(f"a_msgs/msg/{name}", tuple(MessageField(*each) for each in of))

    return TypeDescription(message("A", fields), tuple(message(*each) for each in others.items()))


@pytest.mark.parametrize(
    ("here", "there", "expected"),
    [
        (described(("x", FLOAT)), described(("x", FLOAT), ("v", FLOAT)),
         ("ONLY_THERE", {"field": "v", "type": "float32"})),
        (described(("x", FLOAT), ("v", STRING)), described(("x", FLOAT)),
         ("ONLY_HERE", {"field": "v", "type": "string"})),
        (described(("x", FLOAT)), described(("x", INT)),
         ("OTHER_TYPE", {"field": "x", "there": "int32", "here": "float32"})),
        (described(("x", FLOAT), ("y", INT)), described(("y", INT), ("x", FLOAT)), ("ORDER", {"type": "a_msgs/msg/A"})),
        (described(("p", POINT), Point=(("x", FLOAT),)), described(("p", POINT), Point=(("x", INT),)),
         ("OTHER_TYPE", {"field": "Point.x", "there": "int32", "here": "float32"})),
        (described(("p", POINT), Point=()), described(("p", POINT)), ("NO_FIELD", {})),
    ],
)  # fmt: skip
def test_the_field_is_named(
    here: TypeDescription, there: TypeDescription, expected: tuple[str, dict[str, Any]]
) -> None:
    code, parameters = expected
    assert difference_of_types(here, there) == TypeDifference[code](**parameters)
    assert difference_of_texts(text_of(here), text_of(there)) == difference_of_types(here, there)


@pytest.mark.parametrize(("end", "half"), [("_Request", "IN_REQUEST"), ("_Response", "IN_RESPONSE")])
def test_the_half_of_a_service_is_named(end: str, half: str) -> None:
    def version(kind: FieldType) -> TypeDescription:
        return TypeDescription(MessageType(f"a_msgs/srv/A{end}", (MessageField("x", kind),)), ())

    found = TypeDifference.OTHER_TYPE(field="x", there="int32", here="float32")
    assert difference_of_types(version(FLOAT), version(INT)) == TypeDifference[half](difference=found)


def test_many_differences_are_counted_names_are_harmless() -> None:
    there = described(*((f"f{number}\x1b[31m" + "x" * 200, FLOAT) for number in range(50)))
    text = difference_of_types(described(("x", FLOAT)), there)
    assert "\x1b" not in text
    assert len(text) < 400
    assert text.endswith("and 48 more")


def test_what_is_no_description_differs_in_no_field() -> None:
    assert difference_of_texts("{}", text_of(described())) == ""


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (FieldType(10 + 48, 9, 0, ""), "float32[9]"),
        (FieldType(3 + 96, 16, 0, ""), "uint8[<=16]"),
        (FieldType(1 + 144, 0, 0, "a_msgs/msg/Point"), "a_msgs/msg/Point[]"),
        (FieldType(21, 0, 10, ""), "string<=10"),
        (FieldType(0, 0, 0, ""), "unknown"),
        (FieldType(255, 0, 0, ""), "unknown"),
    ],
)
def test_types_as_message_files_write_them(kind: FieldType, text: str) -> None:
    assert type_text(kind) == text

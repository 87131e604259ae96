"""The fields of a message are read from YAML without its surprises, and written within bounds."""

from __future__ import annotations

import time
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_bridge.cdr.decoder import Decoded, Items, Message
from rsb_bridge.config.fields_text import ITEMS, STEPS, read_fields, write_fields
from rsb_bridge.model.calls import FIELDS_LENGTH, FieldError


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("", {}),
        ("  # nothing\n", {}),
        ("{}", {}),
        ("data: true", {"data": "true"}),
        ("{a: no, b: 1.10, c: '5', d: , e: ~, f: '~', g: ''}",
         {"a": "no", "b": "1.10", "c": "5", "d": None, "e": None, "f": "~", "g": ""}),
        ("a: [1, {b: 2}]", {"a": ["1", {"b": "2"}]}),
        ('{"a": [1.0], "b": "x\\ny"}', {"a": ["1.0"], "b": "x\ny"}),
        ("a: !!str 5", {"a": "5"}),
        ("5", "5"),
    ],
)  # fmt: skip
def test_what_was_written_is_read_as_it_stands(text: str, fields: object) -> None:
    assert read_fields(text) == fields


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: &x [1]\nb: *x", "line 2: aliases (*) are not allowed"),
        ("a: !!python/name:os.system x", "tags (!) are not taken"),
        ("a: !robot x", "tags (!) are not taken"),
        ("a: !!binary aGVsbG8=", "tags (!) are not taken"),
        ("a: 1\na: 2", "line 2: a stands there twice"),
        ("{? [1] : 2}", "is no field's name"),
        ("a: [", "expected the node content"),
        ("a: 1\n---\nb: 2", "expected a single document"),
        ("[" * 40 + "]" * 40, "nested too deeply"),
        ("[" * 20_000, "nested too deeply"),
        ("a: \x07", "U+0007"),
        ("a: " + "x" * FIELDS_LENGTH, "too long"),
        ("é" * (FIELDS_LENGTH // 2 + 1), "too long"),
    ],
)
def test_what_is_no_mapping_of_fields_is_refused(text: str, words: str) -> None:
    with pytest.raises(FieldError) as refused:
        read_fields(text)
    assert words in str(refused.value)


def test_the_longest_text_takes_a_moment() -> None:
    for text in (
        f"a: [{'1,' * (FIELDS_LENGTH // 2 - 5)}]",
        "{a: " * 10_000,
        "- " * (FIELDS_LENGTH // 2),
        "&a " * 10_000,
    ):
        began = time.process_time()
        with suppress(FieldError):
            read_fields(text)
        assert time.process_time() - began < 5.0


@given(st.text(max_size=60))
def test_whatever_is_written_it_is_read_or_refused(text: str) -> None:
    with suppress(FieldError):
        read_fields(text)


def test_a_message_is_written_as_yaml() -> None:
    message: Message = {
        "flag": True,
        "name": "no",
        "pose": {"x": 1.0, "y": float("nan"), "z": float("-inf")},
        "poses": Items("t/msg/P", 2, [{"at": {"x": 1}, "names": Items("string", 1, ["5"])}, {}]),
        "data": Items("uint8", 3, [1, 2, 255]),
        "empty": Items("uint8", 0, []),
        "nothing": {"structure_needs_at_least_one_member": 0},
    }
    assert write_fields(Decoded(message)).splitlines() == [
        "flag: true", "name: 'no'", "pose: {x: 1.0, y: .nan, z: -.inf}", "poses:", "- at: {x: 1}", "  names: ['5']",
        "- {}", "data: [1, 2, 255]", "empty: []", "nothing: {}",
    ]  # fmt: skip
    assert write_fields(Decoded({"structure_needs_at_least_one_member": 0})) == "{}\n"


def test_what_is_left_out_is_said() -> None:
    message: Message = {
        "a": {"data": Items("uint8", 5000, [0] * ITEMS)},
        "b": "x" * 1_000_000,
        "c": Items("string", 20, ["y" * 9000] * 20),
    }
    text = write_fields(Decoded(message, "d: 4 bytes are expected, and 0 are there"))
    assert "# a.data: the first 1,000 of 5,000 elements" in text
    assert "# b: the first 65,536 of 1,000,000 characters" in text
    assert "# and parts of 12 more" in text
    assert text.endswith("# not read further: d: 4 bytes are expected, and 0 are there\n")
    assert len(text) < 100_000
    assert read_fields("\n".join(line for line in text.splitlines() if not line.startswith("b:")))


def test_the_largest_answer_takes_a_moment() -> None:
    element: Message = {"name": "é" * 6, "value": {"type": 3, "x": 0.1}}
    count = STEPS // 5
    began = time.process_time()
    text = write_fields(Decoded({"values": Items("t/msg/V", count, [element] * count)}))
    assert time.process_time() - began < 5.0
    assert text.count("name") == count


@given(st.text(st.characters(codec="utf-8")))
def test_no_text_of_a_message_does_anything_to_a_terminal(words: str) -> None:
    text = write_fields(Decoded({"data": words + "\u202e\x1b[2J"}))
    assert "\u202e" not in text
    assert "\x1b" not in text
    assert read_fields(text) == {"data": words + "\u202e\x1b[2J"}

"""The fields of a message are read from YAML without its surprises, and written within bounds."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.wording import says

from rsb_bridge.cdr.decoder import Decoded, Items, Message
from rsb_bridge.config.fields_text import ITEMS, STEPS, FieldNote, FieldProblem, read_fields, write_fields
from rsb_bridge.config.yaml_text import YamlMistake
from rsb_bridge.model.calls import FIELDS_LENGTH, FieldError

if TYPE_CHECKING:
    from rsb_bridge.model.wording import Wording


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
    ("text", "code", "parameters"),
    [
        ("a: &x [1]\nb: *x", FieldProblem.ON_LINE, {"line": 2, "problem": YamlMistake.ALIAS()}),
        ("a: !!python/name:os.system x", FieldProblem.TAG, {"line": 1}),
        ("a: !robot x", FieldProblem.TAG, {"line": 1}),
        ("a: !!binary aGVsbG8=", FieldProblem.TAG, {"line": 1}),
        ("a: 1\na: 2", FieldProblem.TWICE, {"line": 2, "name": "a"}),
        ("{? [1] : 2}", FieldProblem.NOT_A_NAME, {"line": 1}),
        ("[" * 40 + "]" * 40, YamlMistake.TOO_DEEP, {}),
        ("[" * 20_000, YamlMistake.TOO_DEEP, {}),
        ("a: \x07", YamlMistake.CHARACTER, {"code": 7}),
        ("a: " + "x" * FIELDS_LENGTH, FieldProblem.TOO_LONG, {}),
        ("é" * (FIELDS_LENGTH // 2 + 1), FieldProblem.TOO_LONG, {}),
    ],
)
def test_text_without_mapping_is_refused(text: str, code: Wording, parameters: dict[str, Any]) -> None:
    with pytest.raises(FieldError) as refused:
        read_fields(text)
    assert says(refused.value, code, **parameters)


@pytest.mark.parametrize(
    ("text", "words_of_pyyaml"),
    [("a: [", "expected the node content"), ("a: 1\n---\nb: 2", "expected a single document")],
)
def test_a_text_that_is_no_yaml_is_refused(text: str, words_of_pyyaml: str) -> None:
    with pytest.raises(FieldError, match=words_of_pyyaml):
        read_fields(text)


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
    text = write_fields(Decoded(message, "the problem"))
    notes = [line.removeprefix("# ") for line in text.splitlines() if line.startswith("# ")]
    assert FieldNote.ELEMENTS(location="a.data", shown=ITEMS, total=5000) in notes
    assert FieldNote.CHARACTERS(location="b", shown=65_536, total=1_000_000) in notes
    assert notes[-2:] == [FieldNote.MORE(count=12), FieldNote.UNREADABLE(problem="the problem")]
    assert text.endswith(f"# {notes[-1]}\n")
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
def test_no_text_of_message_does_anything_to_terminal(words: str) -> None:
    text = write_fields(Decoded({"data": words + "\u202e\x1b[2J"}))
    assert "\u202e" not in text
    assert "\x1b" not in text
    assert read_fields(text) == {"data": words + "\u202e\x1b[2J"}

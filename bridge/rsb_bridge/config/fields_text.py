"""The fields of a message as an operator writes and reads them: YAML, within bounds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import yaml

from rsb_bridge.cdr.decoder import Items
from rsb_bridge.config.yaml_text import YamlError, compose, dump_yaml, scalar
from rsb_bridge.model.calls import FIELDS_LENGTH, FieldError
from rsb_bridge.model.text import escape_text, is_clean
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.cdr.decoder import Decoded, Value
    from rsb_bridge.model.calls import Fields

ITEMS = 1000  # elements of an array that are written
STEPS = 10_000  # values of a message that are written. A test has so many written within 5 s of CPU
_TEXT_LENGTH = 64 << 10  # characters of all texts of a message that are written
_NOTES = 10  # omitted parts that are named; the others are counted
_WIDTH = 100
_NOTHING_IN_IT = "structure_needs_at_least_one_member"  # what rosidl puts into a message without fields

_NO_NUMBER = (".inf", "-.inf", ".nan")  # unquoted: values of fields, which a session has none of
_TAGS = frozenset(f"tag:yaml.org,2002:{kind}" for kind in ("null", "bool", "int", "float", "str", "seq", "map"))
_NULL = "tag:yaml.org,2002:null"


class FieldProblem(Wording):
    TOO_LONG = "the text is too long: at most {limit} bytes are allowed"
    ON_LINE = "line {line}: {problem}"
    TAG = "line {line}: tags (!) are not allowed: write the value without the tag"
    NOT_A_NAME = "line {line}: the text before the colon is not a field name"
    TWICE = "line {line}: duplicate key {name}"


class FieldNote(Wording):
    """A part of a message that is not shown."""

    ELEMENTS = "{location}: the first {shown:,} of {total:,} elements"
    CHARACTERS = "{location}: the first {shown:,} of {total:,} characters"
    MORE = "and parts of {count:,} more fields"
    UNREADABLE = "not read further: {problem}"


def read_fields(text: str) -> Fields:
    """Read the fields that an operator wrote. An empty text has no fields.

    Raises:
        FieldError: it is no YAML, or too much of it.
    """
    # The characters first: a text that is far too long is not copied.
    if len(text) > FIELDS_LENGTH or len(text.encode("utf-8", "replace")) > FIELDS_LENGTH:
        raise FieldError(FieldProblem.TOO_LONG(limit=f"{FIELDS_LENGTH:,}"))
    try:
        node = compose(text)
    except YamlError as error:
        has_lines = error.line and "\n" in text.strip()
        raise FieldError(FieldProblem.ON_LINE(line=error.line, problem=error) if has_lines else str(error)) from None
    return {} if node is None else _fields(node)


def _fields(node: yaml.Node) -> Fields:
    if node.tag not in _TAGS:
        raise FieldError(FieldProblem.TAG(line=node.start_mark.line + 1))
    if isinstance(node, yaml.SequenceNode):
        return [_fields(each) for each in node.value]
    if not isinstance(node, yaml.MappingNode):
        return None if node.tag == _NULL else str(node.value)
    fields: dict[str, Fields] = {}
    for key, value in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode):
            raise FieldError(FieldProblem.NOT_A_NAME(line=line))
        if key.value in fields:
            raise FieldError(FieldProblem.TWICE(line=line, name=escape_text(key.value)))
        fields[key.value] = _fields(value)
    return fields


def write_fields(decoded: Decoded) -> str:
    """Write a message as YAML. Comments at the end name the parts that are omitted or unreadable."""
    writing = _Writing()
    data = writing.plain(decoded.message, "")
    text = dump_yaml(data, width=_WIDTH)
    if not all(map(is_clean, text.split("\n"))):
        # YAML calls marks that turn the direction of text printable; a terminal obeys them.
        text = dump_yaml(data, allow_unicode=False, width=_WIDTH)
    return text + "".join(f"# {note}\n" for note in writing.notes(decoded.problem))


def whole_fields(decoded: Decoded) -> tuple[Any, str]:
    """Return a message as plain data, with texts of any length, and what of it is omitted or unreadable."""
    writing = _Writing(room=None)
    data = writing.plain(decoded.message, "")
    return data, "; ".join(writing.notes(decoded.problem))


def read_written(text: str) -> Any:
    """Read the YAML of `write_fields` as plain data, without its comments.

    Raises:
        FieldError: it is no YAML.
    """
    try:
        node = compose(text)
    except YamlError as error:
        raise FieldError(str(error)) from None
    return None if node is None else _written(node)


def _written(node: yaml.Node) -> Any:
    if isinstance(node, yaml.MappingNode):
        return {str(key.value): _written(value) for key, value in node.value}
    if isinstance(node, yaml.SequenceNode):
        return [_written(each) for each in node.value]
    if isinstance(node, yaml.ScalarNode) and node.style is None and node.value in _NO_NUMBER:
        return float(node.value.replace(".", ""))
    return scalar(node)


class _Writing:
    """Makes plain data of a message, and notes the parts that it omits."""

    def __init__(self, room: int | None = _TEXT_LENGTH) -> None:
        self._room = room
        self._left_out: list[str] = []

    def plain(self, value: Value, location: str) -> Any:
        """Return a value as it is written; `location` is its own."""
        if isinstance(value, dict):
            before = f"{location}." if location else ""
            return {name: self.plain(each, before + name) for name, each in value.items() if name != _NOTHING_IN_IT}
        if isinstance(value, Items):
            if len(value.shown) < value.total:
                note = FieldNote.ELEMENTS(location=location, shown=len(value.shown), total=value.total)
                self._left_out.append(note)
            return [self.plain(each, f"{location}[{number}]") for number, each in enumerate(value.shown)]
        if isinstance(value, str):
            kept = value[: self._room]
            if self._room is not None:
                self._room -= len(kept)
            if len(kept) < len(value):
                self._left_out.append(FieldNote.CHARACTERS(location=location, shown=len(kept), total=len(value)))
            return kept
        return value

    def notes(self, problem: str) -> Iterator[str]:
        """Yield notes on the omitted parts, and on the problem that ended reading."""
        yield from self._left_out[:_NOTES]
        if (more := len(self._left_out) - _NOTES) > 0:
            yield FieldNote.MORE(count=more)
        if problem:
            yield FieldNote.UNREADABLE(problem=problem)

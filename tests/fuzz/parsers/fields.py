"""The fields of messages: what an operator of this machine writes, and what of a peer's answer is written."""

from __future__ import annotations

from tests.fuzz.editing import edit_text
from tests.fuzz.parser import Parser, check_text
from tests.fuzz.parsers.descriptions import DESCRIPTION, MESSAGE

from rsb_bridge.cdr.decoder import decode
from rsb_bridge.config.fields_text import read_fields, write_fields
from rsb_bridge.model.calls import FieldError, Fields
from rsb_bridge.model.text import is_clean

_DEPTH = 20


def _depth(fields: Fields) -> int:
    match fields:
        case dict():
            return 1 + max(map(_depth, fields.values()), default=0)
        case list():
            return 1 + max(map(_depth, fields), default=0)
        case _:
            return 1


def _read(data: bytes) -> None:
    try:
        fields = read_fields(data.decode(errors="surrogateescape"))
    except FieldError as error:
        check_text(str(error).replace("\t", " "), 1000)
        return
    assert _depth(fields) <= _DEPTH


def _write(data: bytes) -> None:
    """Check that the text of any answer can be read, and has no effect on a terminal."""
    text = write_fields(decode(DESCRIPTION, data, items=5, steps=300))
    assert all(map(is_clean, text.split("\n")))
    assert isinstance(read_fields(text), dict)


_REQUEST = b"""header: auto
pose:
  position: {x: 1, y: -.5e3, z: .nan}
names: [a, "b\\x41", 'c d', no]
parameters:
- {name: gain, value: {type: 3, double_value: 2}}
"""

PARSERS = (
    Parser("fields_text", _read, (_REQUEST, b"data: true"), edit_text),
    Parser("fields_written", _write, (MESSAGE,)),
)

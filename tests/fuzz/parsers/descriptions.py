"""Descriptions of types, and messages that are read by them or copied: all are the peer's, or of any node's."""

from __future__ import annotations

import contextlib
from pathlib import Path

import zstandard
from tests.fuzz.editing import edit_json
from tests.fuzz.parser import LONGEST, Parser, check_text

from rsb_bridge.cdr.checker import Checker, MalformedError, UncheckableError
from rsb_bridge.cdr.decoder import Decoded, Items, Value, decode
from rsb_bridge.cdr.description import DESCRIPTION_LIMIT, DescriptionError, hash_of_text, read_description, text_of
from rsb_bridge.cdr.event_node import ParameterEventError, node_of, with_node
from rsb_bridge.link.questions import description_in

_ITEMS, _STEPS = 5, 300
_EVERYTHING, *_DIGITS = (
    Path(__file__).parents[2].joinpath("cdr", "everything.txt").read_text(encoding="utf-8").splitlines()
)
MESSAGE = bytes.fromhex("".join(_DIGITS))
DESCRIPTION = read_description(_EVERYTHING, hash_of_text(_EVERYTHING))


def _values(value: Value) -> int:
    match value:
        case Items(_, total, shown):
            assert len(shown) <= min(_ITEMS, total)
            return 1 + sum(map(_values, shown))
        case dict():
            return 1 + sum(map(_values, value.values()))
        case _:
            return 1


def _check(decoded: Decoded) -> None:
    assert len(decoded.problem) <= 500
    assert _values(decoded.message) <= 2 * _STEPS + 2, "more was read than the steps allow"


def _read_message(data: bytes) -> None:
    """Any bytes, as a message with all kinds of fields."""
    _check(decode(DESCRIPTION, data, items=_ITEMS, steps=_STEPS))


_CHECKER = Checker(DESCRIPTION)


def _check_message(data: bytes) -> None:
    """Any bytes, checked as a message with all kinds of fields: what passes can be read to its end."""
    passed = _passes(_CHECKER, data)
    problem = decode(DESCRIPTION, data, items=0, steps=4 * LONGEST).problem
    if passed:
        assert not problem or "without its end" in problem or "16 bits" in problem
    else:
        assert problem


def _passes(checker: Checker, data: bytes) -> bool:
    try:
        assert 0 <= checker.check(data) <= len(data)
    except MalformedError as error:
        check_text(str(error), 500)
        return False
    return True


def _read_description(data: bytes) -> None:
    """Any text, and a message read by what it describes."""
    text = data.decode(errors="surrogateescape")
    try:
        description = read_description(text, hash_of_text(text) if text.isprintable() else "RIHS01_")
    except DescriptionError as error:
        check_text(str(error), 500)
        return
    again = text_of(description)
    assert read_description(again, hash_of_text(again)) == description
    for message in (MESSAGE, b"\0\1\0\0" + bytes(200), b"\0\0\0\0" + bytes(200)):
        _check(decode(description, message, items=_ITEMS, steps=_STEPS))
        with contextlib.suppress(UncheckableError):
            _passes(Checker(description), message)


def _read_answer(data: bytes) -> None:
    text = description_in(data)
    assert text is None or len(text) <= DESCRIPTION_LIMIT


def _copy_event(data: bytes) -> None:
    """Any bytes, as an event of some node's parameters."""
    try:
        node = node_of(data)
        copies = [with_node(data, name) for name in ("/robot1/camera", "/a")]
    except ParameterEventError as error:
        check_text(str(error), 200)
        return
    for copy, name in zip(copies, ("/robot1/camera", "/a"), strict=True):
        assert node_of(copy) == name
        assert len(copy) <= 2 * len(data) + 20
        assert with_node(copy, "/a") == copies[1]
    assert len(node) <= len(data)


_EVENT = bytes.fromhex(
    "0001000000000000 0000000008000000 2f63616d65726100 0100000004000000 6770730002010000 0000000003000000 "
    "0000000000000000 0000e03f06000000 68656c6c6f000000 0200000007080000 0100000001000000 0100000009000000 "
    "0000000001000000 0000000000000000 0000f03f01000000 0200000062000000 0000000000000000 "
)


PARSERS = (
    Parser("cdr", _read_message, (MESSAGE, b"\0\0\0\0" + MESSAGE[4:80])),
    Parser("checked", _check_message, (MESSAGE, b"\0\1\0\0" + bytes(400))),
    Parser("parameter_event", _copy_event, (_EVENT, b"\0\0\0\0" + bytes(11) + b"\3/a" + bytes(13))),
    Parser("type_description", _read_description, (_EVERYTHING.encode(),), edit_json),
    Parser("type_answer", _read_answer, (zstandard.compress(b"a description"), b"")),
)

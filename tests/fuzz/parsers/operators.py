"""Operators over a network: what strangers say to an engine and to a console, and records once both know each other."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from tests.fuzz.editing import behind, edit_bytes
from tests.fuzz.parser import Parser, check_text
from tests.wire.operators_helpers import attached, make_console, make_engine

from rsb_bridge.wire.connection import HOST_BYTES, RECORD_CONTENT, OperatorConsole, OperatorEngine
from rsb_bridge.wire.events import Admitted, Event, Failed, OperatorOpened, RefusalCode, StreamRefused
from rsb_bridge.wire.framing import PREAMBLE_LIMIT, pack_frame
from rsb_bridge.wire.preamble import MESSAGE_LIMIT, PreambleKind, preamble_frame, refuse_frame

End = OperatorConsole | OperatorEngine

_ANSWER = 2 * PREAMBLE_LIMIT
"""Bytes that a stranger can have this side send at most: an ACCEPT and a REFUSE."""


def _read(start: Callable[[], End], data: bytes) -> None:
    """The first byte says in which pieces it comes."""
    end, content = start(), data[1:]
    size = (data[0] if data else 0) or len(content) or 1
    events: list[Event] = []
    answer = b""
    for at in range(0, len(content), size):
        events += end.receive_data(content[at : at + size])
        answer += end.data_to_send()
    assert len(answer) <= _ANSWER
    _check(events)


def _check(events: list[Event]) -> None:
    ended = [event for event in events if isinstance(event, Failed | StreamRefused)]
    assert len(ended) <= 1
    assert not ended or events[-1] is ended[0]
    for event in events:
        match event:
            case Failed(reason):
                check_text(reason, MESSAGE_LIMIT)
            case StreamRefused(_, message, _):
                check_text(message, 2 * MESSAGE_LIMIT)
            case Admitted(host, _):
                check_text(host, HOST_BYTES)
            case OperatorOpened(content):
                assert 0 < len(content) <= RECORD_CONTENT
            case _:
                raise AssertionError("an event of links")


def _started() -> OperatorConsole:
    console = make_console()
    console.start()
    return console


def _sealed(data: bytes) -> None:
    """Check that sealed pieces of both sides arrive, split as the first byte gives, and that anything behind them ends
    the connection.
    """
    console, engine = attached()
    content, size = data[1:], (data[0] if data else 0) or 1
    stream = b"".join(console.send(content[at : at + size]) for at in range(0, len(content), size))
    events = engine.receive_data(stream)
    assert b"".join(event.content for event in events if isinstance(event, OperatorOpened)) == content
    rest = engine.receive_data(data)
    assert not any(isinstance(event, OperatorOpened | Admitted) for event in rest)
    _check(rest)


_FIRST = make_console().start()

PARSERS = (
    Parser(
        "operator_engine",
        partial(_read, make_engine),
        (bytes(1) + _FIRST, b"\7" + _FIRST[:60], bytes(1) + _FIRST + pack_frame(bytes(16))),
        behind(1, edit_bytes),
    ),
    Parser(
        "operator_console",
        partial(_read, _started),
        (
            bytes(1) + pack_frame(refuse_frame(RefusalCode.WRONG_KEY, "the keys of 'anna' differ")),
            bytes(1) + pack_frame(preamble_frame(PreambleKind.ACCEPT, bytes(48))),
        ),
        behind(1, edit_bytes),
    ),
    Parser("operator_records", _sealed, (b"\5hello, robot", bytes(1) + pack_frame(bytes(17)), b""), edit_bytes),
)

"""What a peer says of units, and what it asks for."""

from __future__ import annotations

import msgspec
from tests.fuzz.editing import edit_msgpack
from tests.fuzz.parser import Parser
from tests.fuzz.parsers.control_messages import check_message

from rsb_bridge.wire.codec import decode, encode
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_extras.units.link_units import AskUnits, RunUnit, UnitAnswer, UnitEnded
from rsb_extras.units.unit_process import CommandEnd
from rsb_extras.units.unit_records import ACTIONS, LINES, MOST_UNITS, NAME, UnitOutcome, UnitRecord, UnitState, UnitText

_MESSAGES = (
    AskUnits(1),
    AskUnits(1, ticket=True),
    UnitAnswer(1, 2, (UnitRecord("nav", ACTIONS, True, UnitState.RUNNING, 1.5, "restart"),)),
    RunUnit("nav", "restart", ticket=2, who="anna on pts/3"),
    UnitEnded(2, UnitOutcome(seconds=4.2, state=UnitState.RUNNING)),
    UnitEnded(2, UnitOutcome(reason="restart ended with exit code 7", output=("no device",), log=("x" * 255,))),
)


def _read_message(data: bytes) -> None:
    try:
        message = decode(data)
    except ProtocolError:
        return
    if isinstance(message, RunUnit):
        assert not message.unit or NAME.fullmatch(message.unit)
        assert message.action in ACTIONS
    elif isinstance(message, UnitAnswer):
        assert len(message.units) <= MOST_UNITS
        assert all(not each.name or NAME.fullmatch(each.name) for each in message.units)
    elif isinstance(message, UnitEnded):
        assert all(len(lines) <= LINES for lines in (message.outcome.output, message.outcome.log))
        for action in ACTIONS:
            UnitText.of(action, message.outcome)
    else:
        return
    check_message(message)
    assert decode(encode(message)) == message


def _read_output(data: bytes) -> None:
    """Whatever a command prints fits into a message."""
    outcome = UnitOutcome(output=CommandEnd(output=data).lines)
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(outcome), type=UnitOutcome) == outcome


PARSERS = (
    Parser("unit_message", _read_message, tuple(map(encode, _MESSAGES)), edit_msgpack),
    Parser("unit_output", _read_output, (b"started\nno device\r\n\x1b[2J\xff\n" * 3, b"\xe2\x80\xae\x0c\x1c\n")),
)

"""What a peer says of managed nodes and asks for, and what nodes answer."""

from __future__ import annotations

from contextlib import suppress

from tests.fuzz.editing import edit_msgpack
from tests.fuzz.parser import Parser
from tests.fuzz.parsers.control_messages import check_message

from rsb_bridge.model.text import is_clean
from rsb_bridge.wire.codec import decode, encode
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_extras.node_control.cdr_fields import FieldWriter, MalformedAnswerError
from rsb_extras.node_control.change_records import LIFECYCLE_ACTIONS, MOST_MANAGED, MOST_STEPS, TRANSITIONS, ChangeText
from rsb_extras.node_control.lifecycle_messages import read_offers, read_state, read_success
from rsb_extras.node_control.link_changes import AskManaged, ChangeEnded, ManagedAnswer, RunChange
from rsb_extras.node_control.tests.scripted_answers import DONE, FAILED, SIDES

_MESSAGES = (
    AskManaged(1),
    AskManaged(1, ticket=True),
    ManagedAnswer(1, 2),
    ManagedAnswer(1, 0, SIDES[1].managed),
    RunChange(2, "nav", "up", "anna on pts/3"),
    RunChange(2, "/nav/planner_server", "configure", again=True),
    ChangeEnded(2, DONE),
    ChangeEnded(2, FAILED),
)


def _read_message(data: bytes) -> None:
    try:
        message = decode(data)
    except ProtocolError:
        return
    if isinstance(message, RunChange):
        assert 0 < len(message.target) <= 255
        assert message.action in LIFECYCLE_ACTIONS
    elif isinstance(message, ManagedAnswer):
        assert len(message.managed.nodes) <= MOST_MANAGED
    elif isinstance(message, ChangeEnded):
        assert len(message.outcome.steps) <= MOST_STEPS
        ChangeText.of("up", message.outcome)
    else:
        return
    check_message(message)
    assert decode(encode(message)) == message


def _read_answers(data: bytes) -> None:
    with suppress(MalformedAnswerError):
        state = read_state(data)
        assert is_clean(state)
        assert len(state) <= 32
    with suppress(MalformedAnswerError):
        assert {each.transition for each in read_offers(data)} <= {*TRANSITIONS}
    with suppress(MalformedAnswerError):
        read_success(data)


def offers_answer(*offers: tuple[int, str]) -> bytes:
    """Return an answer of GetAvailableTransitions."""
    writer = FieldWriter().number("I", len(offers))
    for number, label in offers:
        writer.number("B", number).text(label)
        writer.number("B", 1).text("unconfigured").number("B", 10).text("configuring")
    return writer.message


PARSERS = (
    Parser("change_message", _read_message, tuple(map(encode, _MESSAGES)), edit_msgpack),
    Parser(
        "lifecycle_answer", _read_answers,
        (
            FieldWriter().number("B", 3).text("active").message,
            offers_answer((1, "configure"), (5, "shutdown")),
            FieldWriter().number("?", True).message,
        ),
    ),
)  # fmt: skip

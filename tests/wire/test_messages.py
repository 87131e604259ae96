import math
import typing
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.wording import pattern
from tests.wire.links import HELLO, WELCOME
from tests.wire.messages_helpers import PLAIN

from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.wire import messages
from rsb_bridge.wire.codec import decode, decode_hello, decode_urgent, decode_welcome, encode
from rsb_bridge.wire.order_messages import OrderBase
from rsb_bridge.wire.protocol_error import Broken, ProtocolError
from rsb_bridge.wire.records import OrderOutcome

PROPOSE = messages.Propose(route=1, topic="/scan", remote_topic="/robot1/scan", from_client=True)


def says(written: Any, plain: Any) -> bool:
    """Whether a message says at least what another one does."""
    if isinstance(written, dict) and isinstance(plain, dict):
        return all(key in written and says(written[key], value) for key, value in plain.items())
    return bool(written == plain)


@pytest.mark.parametrize("plain", PLAIN, ids=[f"{each['message']}{number % 2}" for number, each in enumerate(PLAIN)])
def test_a_message_reads_as_it_was_written(plain: dict[str, Any]) -> None:
    message: Any = decode(msgspec.msgpack.encode(plain))
    assert type(message).__name__.lower() == plain["message"]
    assert says(msgspec.msgpack.decode(encode(message)), plain)
    assert decode(encode(message)) == message


def test_handshake_s_messages_read_as_they_were_written() -> None:
    assert decode_hello(encode(HELLO)) == HELLO
    assert decode_welcome(encode(WELCOME)) == WELCOME


@given(reason=st.text(), route=st.integers(1, 2**32 - 1))
def test_any_text_crosses_made_plain(reason: str, route: int) -> None:
    message = messages.Close(route=route, reason=sanitize_text(reason))
    assert decode(encode(message)) == message
    assert sanitize_text(message.reason) == message.reason


@pytest.mark.parametrize("message", [messages.Lease(3, 2), messages.Disarm(5, "operator", "anna")])
def test_urgent_message_is_same_as_datagram(message: messages.Lease | messages.Disarm) -> None:
    assert decode_urgent(encode(message)) == message


def test_no_other_message_is_taken_from_a_datagram() -> None:
    with pytest.raises(ProtocolError):
        decode_urgent(encode(messages.Arm(5, "anna")))


HIDDEN = [f"a{sign}b" for sign in "\u200b\u2060\ufeff\u00ad\ufe0f\u3164\U000e0041"]
"""Marks and letters that a reader does not see."""


@pytest.mark.parametrize("reason", ["\x1b[2J", "two\nlines", "end\n", "\x9b1m", "\u202egnp", "x" * 501, "\0", *HIDDEN])
def test_harmful_text_is_refused(reason: str) -> None:
    with pytest.raises(ProtocolError):
        decode(encode(messages.Close(route=1, reason=reason)))
    assert sanitize_text(reason) != reason
    with pytest.raises(ProtocolError):
        decode_hello(encode(msgspec.structs.replace(HELLO, version=reason)))


@pytest.mark.parametrize("field", ["message", "transport", "topic", "type"])
@pytest.mark.parametrize(
    "text",
    ["\x1b]0;title\x07", "x\n2026-01-01 00:00:00 ERROR   engine   forged", "x" * (1 << 20)],
    ids=["escape", "forged", "long"],
)
def test_error_quotes_peer_in_clean_line(field: str, text: str) -> None:
    fields = msgspec.to_builtins(PROPOSE) | {"message": "propose", field: text}
    with pytest.raises(ProtocolError) as raised:
        decode(msgspec.msgpack.encode(fields))
    shown = str(raised.value)
    assert shown.isprintable()
    assert len(shown) <= 500
    assert "regex" not in shown


def test_unknown_fields_are_ignored_missing_have_defaults() -> None:
    fields = {"message": "propose", "route": 1, "topic": "/scan", "remote_topic": "/robot1/scan", "from_client": True}
    assert decode(msgspec.msgpack.encode(fields | {"later": [1, {"a": None}]})) == PROPOSE
    newer = {"message": "accept", "route": 1, "topic": "/cmd_vel", "limits": {"linear": 0.5, "jerk": 3.0}}
    assert decode(msgspec.msgpack.encode(newer)) == messages.Accept(1, "/cmd_vel", limits=VelocityLimits(0.5))


@settings(max_examples=settings().max_examples * 5)
@given(example=st.sampled_from([*map(msgspec.msgpack.encode, PLAIN), encode(HELLO), encode(WELCOME)]), data=st.data())
def test_a_damaged_message_reads_or_gives_words(example: bytes, data: st.DataObject) -> None:
    damaged = bytearray(example)
    for _ in range(data.draw(st.integers(1, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    del damaged[data.draw(st.integers(0, len(damaged))) :]
    try:
        message = decode(bytes(damaged))
    except ProtocolError:
        return
    assert isinstance(message, typing.get_args(messages.ControlMessage))


@given(st.binary())
def test_garbage_gives_words(garbage: bytes) -> None:
    for read in (decode, decode_hello, decode_welcome):
        with pytest.raises(ProtocolError, match=pattern(Broken.INVALID_CONTROL_MESSAGE)):
            read(garbage)


def test_nesting_without_end_gives_words() -> None:
    nested = msgspec.msgpack.encode({"message": "ready", "route": 1, "x": 0})[:-1] + b"\x91" * 100_000
    with pytest.raises(ProtocolError):  # about the depth, or from Python 3.14 on about the missing end
        decode(nested)


@pytest.mark.parametrize(
    "fields",
    [
        {"message": "ready", "route": 0},
        {"message": "ready", "route": 2**32},
        {"message": "ping", "n": -1, "sent": 0},
        {"message": "ping", "n": 2**63, "sent": 0},
        {"message": "hello"},
        {"message": "refuse", "route": 1, "code": "whim", "reason": ""},
        {"message": "accept", "route": 1, "topic": "/cmd_vel", "limits": {"linear": 0}},
        {"message": "provide", "route": 1, "lanes": [{"type": "a"}] * 17},
        {"message": "provide", "route": 1, "lanes": [{"type": "a", "providers": -1}]},
        {"message": "provide", "route": 1, "nodes": ["/node"] * 17},
        {"message": "provide", "route": 1, "via": ["a_1/b"] * 17},
        {"message": "provide", "route": 1, "via": [""]},
        {"message": "report", "sent": [], "received": [], "calls": [{"route": 1, "nodes": ["/n"] * 17}]},
        {"message": "report", "sent": [{"route": 1, "publisher_qos": {"depth": -1}}], "received": []},
        {"message": "report", "sent": [], "received": [{"route": 1, "subscriber_qos": {"deadline": 1e-9}}]},
    ],
)
def test_a_field_out_of_its_range_gives_words(fields: dict[str, Any]) -> None:
    with pytest.raises(ProtocolError, match=pattern(Broken.INVALID_CONTROL_MESSAGE)):
        decode(msgspec.msgpack.encode(fields))


@pytest.mark.parametrize(
    "change",
    [
        {"port": 65536},
        {"transport": "ip"},
        {"arm": True, "deadman": 1.0},
        {"kind": "\x1b[2J"},
        *({"max_rate": rate} for rate in (math.nan, 1e-310, 0.0009, 1e7, math.inf)),
        *({"stale_after": after} for after in (-1.0, 0.01, 2e6)),
        *({"late_after": after} for after in (-1.0, 0.001)),
        *({"max_age": age} for age in (-1.0, 0.001, 1e5)),
        *({"timeout": timeout} for timeout in (-1.0, math.nan, math.inf)),
        *({"qos": {"depth": depth}} for depth in (-1, 0, 2**31)),
        *({"qos": qos} for qos in ({"deadline": math.nan}, {"deadline": 1e-9}, {"lifespan": 1.1e9}, {"surprise": 1})),
        *({"limits": limits} for limits in ({"linear": 0}, {"angular": -1.0}, {"linear": math.nan}, {"linear": 1e9})),
    ],
)
def test_a_proposal_out_of_its_range_gives_words(change: Any) -> None:
    with pytest.raises(ProtocolError, match=pattern(Broken.INVALID_CONTROL_MESSAGE)):
        decode(msgspec.msgpack.encode(msgspec.to_builtins(PROPOSE) | change))


def test_a_link_id_has_eight_bytes() -> None:
    for link_id in (b"", bytes(7), bytes(9)):
        with pytest.raises(ProtocolError, match="link_id"):
            decode_welcome(
                msgspec.msgpack.encode(msgspec.to_builtins(WELCOME, builtin_types=(bytes,)) | {"link_id": link_id})
            )


def test_order_is_done_unless_there_is_a_reason() -> None:
    class Run(OrderBase, frozen=True):
        unit: str

    assert msgspec.msgpack.decode(encode(Run("nav", ticket=3)), type=Run) == Run("nav", ticket=3)
    assert OrderOutcome().done
    assert not OrderOutcome(reason="it does not start").done

import math
import typing
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.wording import pattern

from rsb_bridge.model.pictures import Wish
from rsb_bridge.model.qos import PROFILES, Qos
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.velocity_limits import VelocityLimits
from rsb_bridge.wire import messages
from rsb_bridge.wire.codec import decode, decode_hello, decode_urgent, decode_welcome, encode
from rsb_bridge.wire.protocol_error import Broken, ProtocolError
from rsb_bridge.wire.records import (
    CallsReport,
    LaneEntry,
    ReceivedReport,
    SentReport,
    Source,
    TopicEntry,
    VerdictRecord,
)

PROPOSE = messages.Propose(route=1, topic="/scan", remote_topic="/robot1/scan", from_client=True)
EXAMPLES: list[messages.ControlMessage] = [
    PROPOSE,
    messages.Follow(
        request=1, patterns=(messages.NamePattern("/camera/**"), messages.NamePattern("/nav/*", "service"))
    ),
    messages.Followed(
        request=1,
        present=(
            messages.FoundName("/camera/image", "sensor_msgs/msg/Image"),
            messages.FoundName("/nav/plan", kind="action"),
        ),
        gone=(messages.FoundName("/camera/depth"),),
        more=3,
    ),
    messages.Propose(
        route=2**32 - 1,
        topic="/map",
        remote_topic="/map",
        from_client=False,
        type="nav_msgs/msg/OccupancyGrid",
        transport="bluetooth",
        port=30,
        qos=PROFILES["latched"],
        compression="zstd",
        max_rate=5.0,
        expected_rate=4.5,
        stale_after=15.0,
        paused=True,
    ),
    messages.Propose(
        route=5, topic="/fibonacci", remote_topic="/fibonacci", from_client=True, kind="action", timeout=5.0
    ),
    messages.Propose(route=7, topic="view/1", remote_topic="view/1", from_client=False, purpose="view"),
    messages.Propose(route=9, topic="/a", remote_topic="/a", from_client=True, limits=VelocityLimits(angular=2.0)),
    messages.Accept(route=1, topic="/robot1/scan", arm=True, deadman=2.0),
    messages.Refuse(route=1, code="type_differs", reason="the type's hash differs"),
    messages.Describe(
        route=1,
        type="sensor_msgs/msg/LaserScan",
        type_hash="RIHS01_00",
        qos=Qos(deadline=0.5, lifespan=2.0),
        sources=(Source(("rsb_a_1/scan",)), Source(("rsb_b_2/other", "rsb_a_1/scan"), live=False)),
    ),
    messages.Neighbours(bridges=("rsb_a_1", "rsb_b_2")),
    messages.Ready(route=1, sources=2, newest={bytes(16): 2**63 - 1}),
    messages.Publishers(route=1, present={bytes(16): 0, b"sixteen bytes...": 1000}),
    messages.Provide(route=1),
    messages.ByHand(route=1, lane=4, request="parameters: []", who="anna"),
    messages.ByHand(route=1, lane=4, who="anna", outcome="answered after 0.1 s"),
    messages.Provide(
        route=1,
        lanes=(
            LaneEntry("test_msgs/action/Fibonacci_SendGoal", "RIHS01_00", providers=1),
            LaneEntry("action_msgs/msg/GoalStatusArray", qos=PROFILES["latched"]),
        ),
        nodes=("/fibonacci_server",),
        via=("rsb_b_2/other", "rsb_a_1/fibonacci"),
        pause_revision=3,
    ),
    messages.Close(route=1, reason="removed", removed=True),
    messages.Amend(route=1, max_rate=2.5, stale_after=0.0),
    messages.Limit(route=1, max_rate=10.0),
    messages.Pause(route=1, paused=True, revision=3),
    messages.Arm(route=1, who="anna"),
    messages.Armed(route=1),
    messages.Disarm(route=1, cause="deadman"),
    messages.AskForArming(route=1, who="bert"),
    messages.AskEnded(route=1, how="given"),
    messages.AskEnded(route=1, how="withdrawn", own=True),
    messages.Ping(n=1, sent=2**62),
    messages.Pong(n=1, sent=2, received=3, answered=4),
    messages.Report(
        sent=(
            SentReport(
                route=1,
                offered=9,
                delivered=7,
                dropped={"queue full": 2},
                subscribed=True,
                verdict=VerdictRecord("down", "loop", "übel"),
                nodes=("/talker",),
            ),
        ),
        received=(
            ReceivedReport(
                route=2,
                received=3,
                newest=2**40,
                latency_p50=-0.001,
                jitter=0.0,
                verdict=VerdictRecord("newer than us"),
                velocity=(0.2, -0.5),
            ),
        ),
        calls=(
            CallsReport(
                route=5,
                asked=9,
                answered=4,
                expired=1,
                refused={"calls under way": 1},
                lost=1,
                in_flight=2,
                verdict=VerdictRecord("waiting", "no_provider", "nobody serves it"),
                nodes=("/fibonacci_client",),
            ),
        ),
    ),
    messages.ListTopics(request=1),
    messages.TopicList(
        request=1, topics=(TopicEntry("/scan", "", "", None, 0, 1), TopicEntry("/a", "b", "c", Qos(), 1, 0))
    ),
    messages.TopicList(request=2, topics=(TopicEntry("/add", "example/srv/Add", "RIHS01_00", None, 1, 2, "service"),)),
    messages.AskType(route=1),
    messages.TypeText(route=1, text=b"\x28\xb5\x2f\xfd"),
    messages.BenchAsk(request=1, route=3, reset=True, size=2500, rate=100.0, count=50),
    messages.Look(
        request=2, route=3, topics=("/camera", "/tf"), wish=Wish(width=120, how="map", fields=("a.b[0]",), zoom=2.0)
    ),
    messages.LookAnswer(request=2, problem="no"),
    messages.BenchAnswer(
        request=1, problem="no", sent=5, rate=9.5, received=4, p50=-0.001, cpu=1.5, memory=7, max_rate=10.0
    ),
    messages.Lease(number=7, echo=2**32 - 1),
    messages.Settled(route=3),
    messages.Receipts(received=((1, 4096), (3, 0)), every=((2, 512),)),
    messages.Duplicate(address="10.0.0.9", host="spare", others=2),
    messages.Shutdown(reason="stopped"),
]
HELLO = messages.Hello(version="0.1.0", name="robot1", instance="abc", domain_id=2)
WELCOME = messages.Welcome(version="0.1.0", name="pc", link_id=b"linklink", instance="def", domain_id=0)


def test_there_is_an_example_of_every_message() -> None:
    assert {type(example) for example in EXAMPLES} == set(typing.get_args(messages.ControlMessage))


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)
def test_a_message_reads_as_it_was_written(message: messages.ControlMessage) -> None:
    data = encode(message)
    assert decode(data) == message
    assert msgspec.msgpack.decode(data)["message"] == type(message).__name__.lower()


def test_the_handshake_s_messages_read_as_they_were_written() -> None:
    assert decode_hello(encode(HELLO)) == HELLO
    assert decode_welcome(encode(WELCOME)) == WELCOME


@given(reason=st.text(), route=st.integers(1, 2**32 - 1))
def test_any_text_crosses_made_plain(reason: str, route: int) -> None:
    message = messages.Close(route=route, reason=sanitize_text(reason))
    assert decode(encode(message)) == message
    assert sanitize_text(message.reason) == message.reason


@pytest.mark.parametrize("message", [messages.Lease(3, 2), messages.Disarm(5, "operator", "anna")])
def test_an_urgent_message_is_the_same_as_a_datagram(message: messages.Lease | messages.Disarm) -> None:
    assert decode_urgent(encode(message)) == message


def test_no_other_message_is_taken_from_a_datagram() -> None:
    with pytest.raises(ProtocolError):
        decode_urgent(encode(messages.Arm(5, "anna")))


HIDDEN = [f"a{sign}b" for sign in "\u200b\u2060\ufeff\u00ad\ufe0f\u3164\U000e0041"]
"""Marks and letters that a reader does not see."""


@pytest.mark.parametrize("reason", ["\x1b[2J", "two\nlines", "end\n", "\x9b1m", "\u202egnp", "x" * 501, "\0", *HIDDEN])
def test_text_that_would_harm_a_terminal_or_a_log_is_refused(reason: str) -> None:
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
def test_an_error_quotes_the_peer_in_one_short_line_without_escape_sequences(field: str, text: str) -> None:
    fields = msgspec.to_builtins(PROPOSE) | {"message": "propose", field: text}
    with pytest.raises(ProtocolError) as raised:
        decode(msgspec.msgpack.encode(fields))
    shown = str(raised.value)
    assert shown.isprintable()
    assert len(shown) <= 500
    assert "regex" not in shown


def test_unknown_fields_are_ignored_and_missing_ones_have_their_defaults() -> None:
    fields = {"message": "propose", "route": 1, "topic": "/scan", "remote_topic": "/robot1/scan", "from_client": True}
    assert decode(msgspec.msgpack.encode(fields | {"later": [1, {"a": None}]})) == PROPOSE
    newer = {"message": "accept", "route": 1, "topic": "/cmd_vel", "limits": {"linear": 0.5, "jerk": 3.0}}
    assert decode(msgspec.msgpack.encode(newer)) == messages.Accept(1, "/cmd_vel", limits=VelocityLimits(0.5))


@settings(max_examples=settings().max_examples * 5)
@given(example=st.sampled_from([*map(encode, EXAMPLES), encode(HELLO), encode(WELCOME)]), data=st.data())
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
        {"message": "provide", "route": 1, "lanes": [{"type": "a", "qos": {"depth": -1}}]},
        {"message": "provide", "route": 1, "nodes": ["/node"] * 17},
        {"message": "provide", "route": 1, "via": ["a_1/b"] * 17},
        {"message": "provide", "route": 1, "via": [""]},
        {"message": "report", "sent": [], "received": [], "calls": [{"route": 1, "refused": {"": 1.5}}]},
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
        {"max_rate": math.nan},
        {"max_rate": 1e-310},
        {"max_rate": 0.0009},
        {"max_rate": 1e7},
        {"max_rate": math.inf},
        {"stale_after": -1.0},
        {"transport": "ip"},
        {"qos": {"depth": -1}},
        {"qos": {"depth": 2**31}},
        {"qos": {"deadline": math.nan}},
        {"qos": {"deadline": 1e-9}},
        {"qos": {"lifespan": 1.1e9}},
        {"qos": {"depth": 0}},
        {"stale_after": 0.01},
        {"stale_after": 2e6},
        {"late_after": -1.0},
        {"late_after": 0.001},
        {"max_age": -1.0},
        {"max_age": 0.001},
        {"max_age": 1e5},
        {"arm": True, "deadman": 1.0},
        {"kind": "\x1b[2J"},
        {"timeout": -1.0},
        {"timeout": math.nan},
        {"timeout": math.inf},
        {"qos": {"surprise": 1}},
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

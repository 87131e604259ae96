"""Control messages of a peer with the key, and contents of the handshake's messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import msgspec
import zstandard
from tests.fuzz.editing import behind, edit_frames, edit_msgpack, split_frames
from tests.fuzz.parser import Parser, check_text
from tests.wire.links import CONTROL_HEADER, HELLO, WELCOME, established
from tests.wire.messages_helpers import PLAIN

from rsb_bridge.link.control_channel import entries_in_slices
from rsb_bridge.model.limits import REASON_LENGTH
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.text import is_clean
from rsb_bridge.wire.codec import ReportParts, decode, decode_hello, decode_welcome, encode, topic_entries
from rsb_bridge.wire.events import DataFrame, Event, Failed, MessageReceived, StreamRefused
from rsb_bridge.wire.framing import HEADER, pack_frame
from rsb_bridge.wire.messages import Report
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.records import TopicEntry
from rsb_bridge.wire.sealing import CipherSuite, Sealer

_EXAMPLES: list[Any] = [decode(msgspec.msgpack.encode(each)) for each in PLAIN]


def _leaves(value: Any) -> Iterator[Any]:
    match value:
        case dict():
            for key, each in value.items():
                yield key
                yield from _leaves(each)
        case list() | tuple():
            for each in value:
                yield from _leaves(each)
        case _:
            yield value


def check_message(message: Any) -> None:
    """A message that was accepted has short, clean text and real figures, and is the same after another crossing."""
    for leaf in _leaves(msgspec.to_builtins(message, builtin_types=(bytes,))):
        if isinstance(leaf, str):
            assert is_clean(leaf)
            assert len(leaf) <= REASON_LENGTH
        elif isinstance(leaf, float) and not isinstance(message, Report):  # the reader of a report limits its figures
            assert not math.isnan(leaf), "a figure is no number"


def _read(decode: Callable[[bytes], Any], data: bytes) -> None:
    try:
        message = decode(data)
    except ProtocolError as error:
        check_text(str(error), REASON_LENGTH)
        return
    if isinstance(message, ReportParts):
        return  # its entries are decoded later, by the decoders of short ones
    check_message(message)
    again = encode(message)
    assert encode(decode(again)) == again


def _read_topics(data: bytes) -> None:
    entries: list[TopicEntry] = []
    try:
        for _ in entries_in_slices(topic_entries(zstandard.compress(data)), entries.append):
            pass
    except ProtocolError as error:
        check_text(str(error), REASON_LENGTH)
    for each in entries:
        check_message(each)


def _read_sealed(data: bytes) -> None:
    """Read the frames of a peer that has the key. The first byte gives the side that reads, and its kind of link.

    The first byte of each frame decides whether it is sealed as a control frame, or used as it is.
    """
    choice = data[0] if data else 0
    client, server, _, _ = established(CipherSuite.PLAIN, multiplexed=bool(choice & 2))
    reader = client if choice & 1 else server
    sealer = Sealer(CipherSuite.PLAIN, None)
    sealer.sequence = 0 if choice & 1 else 1  # the client's confirmation was the first
    events: list[Event] = []
    for frame in split_frames(data[1:]):
        sealed = sealer.seal(frame[1:], CONTROL_HEADER)
        events += reader.receive_data(
            pack_frame(CONTROL_HEADER, sealed) if frame[:1] != b"\1" else pack_frame(frame[1:])
        )
    ended = [event for event in events if isinstance(event, Failed | StreamRefused)]
    assert len(ended) <= 1
    assert not ended or events[-1] is ended[0]
    for event in events:
        match event:
            case MessageReceived(content):
                _read(decode, content)
            case DataFrame(frame_of_data):
                assert len(frame_of_data) >= HEADER.size
            case Failed(reason):
                assert is_clean(reason)
            case StreamRefused(_, message, _):
                assert is_clean(message)
            case _:
                raise AssertionError(f"{type(event).__name__} once the link is up")


def _framed(*contents: bytes) -> bytes:
    return b"".join(len(content).to_bytes(4, "big") + content for content in contents)


_DATA_FRAME = b"\1" + HEADER.pack(1, 0, 7, 8) + b"content" + bytes(4)
_ENTRY = TopicEntry("/scan", "sensor_msgs/msg/LaserScan", "RIHS01_" + "5a" * 32, Qos(depth=1, deadline=0.1), 1, 2)
_REFUSE = b"\1rsb\2\4\x08busy"

PARSERS = (
    Parser("control_message", partial(_read, decode), tuple(encode(each) for each in _EXAMPLES), edit_msgpack),
    Parser("topic_list", _read_topics, (msgspec.msgpack.encode([_ENTRY] * 3),), edit_msgpack),
    Parser("hello", partial(_read, decode_hello), (encode(HELLO),), edit_msgpack),
    Parser("welcome", partial(_read, decode_welcome), (encode(WELCOME),), edit_msgpack),
    Parser(
        "sealed_control",
        _read_sealed,
        (
            bytes(1) + _framed(*(bytes(1) + encode(each) for each in _EXAMPLES[:6])),
            bytes((1,)) + _framed(*(bytes(1) + encode(each) for each in _EXAMPLES[6:12])),
            bytes((2,)) + _framed(_DATA_FRAME, bytes(1) + encode(_EXAMPLES[0])),
            bytes((3,)) + _framed(_REFUSE),
            bytes((1,)) + _framed(_REFUSE),
        ),
        behind(1, edit_frames),
    ),
)

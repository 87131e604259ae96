"""The headers of payloads: of calls, of messages with a history, and of those with a lease."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.wording import pattern

from rsb_bridge.wire import headers
from rsb_bridge.wire.headers import CALL_HEADER_LENGTH, MOST_TOOK, CallFrame, HistoryHeader, What
from rsb_bridge.wire.protocol_error import Broken, ProtocolError

PUBLISHER = bytes(range(16))
FRAMES = [
    CallFrame(What.CALL, 0, 1, 0, b"\0\1\0\0request"),
    CallFrame(What.ANSWER, 5, 2**64 - 1, MOST_TOOK, b"\0\1\0\0response"),
    CallFrame(What.REFUSED, 255, 7, 0, b"calls under way"),
    CallFrame(What.MESSAGE, 4, 0, 0, b""),
]


@pytest.mark.parametrize("frame", FRAMES, ids=lambda frame: frame.what.name)
def test_a_frame_reads_as_it_was_written(frame: CallFrame) -> None:
    payload = frame.pack()
    assert headers.unpack_call(payload) == frame
    assert len(payload) == CALL_HEADER_LENGTH + len(frame.content)


@pytest.mark.parametrize("content", [b"", b"content"])
def test_a_header_and_its_content_come_apart_again(content: bytes) -> None:
    history = HistoryHeader(PUBLISHER, number=2**63 - 1, depth=5)
    assert headers.split_history(history.pack() + content) == (history, content)
    for number in (0, 1, headers.LAST_LEASE):
        packed = headers.with_number(number, content)
        assert packed == number.to_bytes(4, "big") + content
        assert headers.split_number(packed) == (number, content)


@pytest.mark.parametrize(
    ("read", "payload", "broken", "parameters"),
    [
        (headers.unpack_call, *row)
        for row in (
            (b"", Broken.CALL_FRAME_TOO_SHORT, {"length": 0, "header": 18}),
            (FRAMES[0].pack()[: CALL_HEADER_LENGTH - 1], Broken.CALL_FRAME_TOO_SHORT, {"length": 17}),
            (struct.pack(">BBQQ", 0, 0, 1, 0), Broken.CALL_KIND_UNKNOWN, {"kind": 0}),
            (struct.pack(">BBQQ", 6, 0, 1, 0), Broken.CALL_KIND_UNKNOWN, {"kind": 6}),
            (struct.pack(">BBQQ", What.CALL, 0, 0, 0), Broken.CALL_NUMBER_INVALID, {"kind": 1, "number": 0}),
            (struct.pack(">BBQQ", What.MESSAGE, 0, 1, 0), Broken.CALL_NUMBER_INVALID, {"kind": 4, "number": 1}),
            (struct.pack(">BBQQ", What.ANSWER, 0, 1, MOST_TOOK + 1), Broken.CALL_DURATION_INVALID, {"kind": 2}),
            (struct.pack(">BBQQ", What.CALL, 0, 1, 1), Broken.CALL_DURATION_INVALID, {"kind": 1, "took": 1}),
            (struct.pack(">BBQQ", What.MESSAGE, 0, 0, 1), Broken.CALL_DURATION_INVALID, {"kind": 4, "took": 1}),
        )
    ]
    + [
        (headers.split_history, b"", Broken.HISTORY_HEADER_TOO_SHORT, {"length": 0}),
        (headers.split_history, bytes(27), Broken.HISTORY_HEADER_TOO_SHORT, {"length": 27}),
        (headers.split_history, struct.pack(">16sQI", PUBLISHER, 1, 0), Broken.HISTORY_HEADER_INVALID, {"depth": 0}),
        (headers.split_history, PUBLISHER + struct.pack(">QI", 2**63, 1), Broken.HISTORY_HEADER_INVALID, {"depth": 1}),
        (headers.split_number, bytes(3), Broken.LEASE_HEADER_TOO_SHORT, {"length": 3}),
    ],
)
def test_what_is_no_header_is_refused_in_words(
    read: Callable[[bytes], object], payload: bytes, broken: Broken, parameters: dict[str, object]
) -> None:
    with pytest.raises(ProtocolError, match=pattern(broken, **parameters)):
        read(payload)


def test_every_gid_makes_an_id() -> None:
    assert headers.publisher_id(PUBLISHER) == headers.publisher_id(PUBLISHER + b"more") == PUBLISHER
    assert headers.publisher_id(b"short") == b"short" + bytes(11)


@given(st.binary(max_size=64))
def test_anything_reads_or_gives_words(payload: bytes) -> None:
    try:
        frame = headers.unpack_call(payload)
    except ProtocolError:
        return
    assert frame.pack() == payload


def test_call_holds_its_frames_bytes_of_budget() -> None:
    assert headers.frame_size(b"12345") == len(CallFrame(What.CALL, 0, 1, 0, b"12345").pack())

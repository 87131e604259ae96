"""The frames of routes of calls."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_bridge.wire.headers import CALL_HEADER_LENGTH, MOST_TOOK, CallFrame, What, unpack_call
from rsb_bridge.wire.protocol_error import ProtocolError

FRAMES = [
    CallFrame(What.CALL, 0, 1, 0, b"\0\1\0\0request"),
    CallFrame(What.ANSWER, 5, 2**64 - 1, MOST_TOOK, b"\0\1\0\0response"),
    CallFrame(What.REFUSED, 255, 7, 0, b"calls under way"),
    CallFrame(What.MESSAGE, 4, 0, 0, b""),
    CallFrame(What.AGAIN, 2, 8, 0, b"\0\1\0\0request"),
]


@pytest.mark.parametrize("frame", FRAMES, ids=lambda frame: frame.what.name)
def test_a_frame_reads_as_it_was_written(frame: CallFrame) -> None:
    payload = frame.pack()
    assert unpack_call(payload) == frame
    assert len(payload) == CALL_HEADER_LENGTH + len(frame.content)


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "at least 18 bytes, not 0"),
        (FRAMES[0].pack()[: CALL_HEADER_LENGTH - 1], "at least 18 bytes, not 17"),
        (struct.pack(">BBQQ", 0, 0, 1, 0), "kind 0"),
        (struct.pack(">BBQQ", 6, 0, 1, 0), "kind 6"),
        (struct.pack(">BBQQ", What.CALL, 0, 0, 0), "kind 1 with the number 0"),
        (struct.pack(">BBQQ", What.MESSAGE, 0, 1, 0), "kind 4 with the number 1"),
        (struct.pack(">BBQQ", What.ANSWER, 0, 1, MOST_TOOK + 1), "kind 2 that took"),
        (struct.pack(">BBQQ", What.CALL, 0, 1, 1), "kind 1 that took 1 ns"),
        (struct.pack(">BBQQ", What.MESSAGE, 0, 0, 1), "kind 4 that took 1 ns"),
    ],
)
def test_what_is_no_frame_is_refused_in_words(payload: bytes, words: str) -> None:
    with pytest.raises(ProtocolError, match=words):
        unpack_call(payload)


@given(st.binary(max_size=64))
def test_anything_reads_or_gives_words(payload: bytes) -> None:
    try:
        frame = unpack_call(payload)
    except ProtocolError:
        return
    assert frame.pack() == payload

"""The frames of routes of calls."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.wording import pattern

from rsb_bridge.wire.headers import CALL_HEADER_LENGTH, MOST_TOOK, CallFrame, What, frame_size, unpack_call
from rsb_bridge.wire.protocol_error import Broken, ProtocolError

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
    ("payload", "broken", "parameters"),
    [
        (b"", Broken.CALL_FRAME_TOO_SHORT, {"length": 0, "header": 18}),
        (FRAMES[0].pack()[: CALL_HEADER_LENGTH - 1], Broken.CALL_FRAME_TOO_SHORT, {"length": 17}),
        (struct.pack(">BBQQ", 0, 0, 1, 0), Broken.CALL_KIND_UNKNOWN, {"kind": 0}),
        (struct.pack(">BBQQ", 6, 0, 1, 0), Broken.CALL_KIND_UNKNOWN, {"kind": 6}),
        (struct.pack(">BBQQ", What.CALL, 0, 0, 0), Broken.CALL_NUMBER_INVALID, {"kind": 1, "number": 0}),
        (struct.pack(">BBQQ", What.MESSAGE, 0, 1, 0), Broken.CALL_NUMBER_INVALID, {"kind": 4, "number": 1}),
        (struct.pack(">BBQQ", What.ANSWER, 0, 1, MOST_TOOK + 1), Broken.CALL_DURATION_INVALID, {"kind": 2}),
        (struct.pack(">BBQQ", What.CALL, 0, 1, 1), Broken.CALL_DURATION_INVALID, {"kind": 1, "took": 1}),
        (struct.pack(">BBQQ", What.MESSAGE, 0, 0, 1), Broken.CALL_DURATION_INVALID, {"kind": 4, "took": 1}),
    ],
)
def test_what_is_no_frame_is_refused_in_words(payload: bytes, broken: Broken, parameters: dict[str, object]) -> None:
    with pytest.raises(ProtocolError, match=pattern(broken, **parameters)):
        unpack_call(payload)


@given(st.binary(max_size=64))
def test_anything_reads_or_gives_words(payload: bytes) -> None:
    try:
        frame = unpack_call(payload)
    except ProtocolError:
        return
    assert frame.pack() == payload


def test_a_call_holds_as_many_bytes_of_the_budget_as_its_frame_has() -> None:
    assert frame_size(b"12345") == len(CallFrame(What.CALL, 0, 1, 0, b"12345").pack())

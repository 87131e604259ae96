"""Data frames of streams: chunks, budgets, histories, and what is compressed."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from tests.fuzz.editing import behind, edit_bytes, split_frames
from tests.fuzz.parser import Parser, check_text
from tests.support.frames import StreamedReader, write_chunks, write_frame

from rsb_bridge.wire.framing import DATA, HEADER, HISTORY, MORE, Budget, DataWriter, FrameReader, pack_frame
from rsb_bridge.wire.headers import CallFrame, HistoryHeader, What, split_history, unpack_call
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.sealing import CipherSuite, Sealer, SealError, StreamOpener

_KEY = bytes(range(32))
_BUDGET = 3000
_LONGEST = 1000
_ROUTE = 7


def _read_stream(data: bytes) -> None:
    """Bytes as they come, in pieces as the first one says: a peer that seals as it should, or anything at all."""
    choice = data[0] if data else 0
    budget = Budget(_BUDGET)
    reader = StreamedReader(StreamOpener(CipherSuite.PLAIN, None), _LONGEST, budget)
    sealer = Sealer(CipherSuite.PLAIN, None)
    stream = data[1:]
    if choice & 1:
        stream = b"".join(_sealed(sealer, frame) for frame in split_frames(stream))
    size = choice >> 1 or len(stream) or 1
    kept = 0
    try:
        for at in range(0, len(stream), size):
            messages = reader.receive_data(stream[at : at + size])
            kept += sum(len(payload) for payload, _, _ in messages)
            for payload, _, flags in messages:
                assert len(payload) <= _LONGEST
                assert not flags & MORE
                if flags & HISTORY:
                    _read_history(payload)
            assert 0 <= budget.held <= _BUDGET
    except (ProtocolError, SealError):
        pass
    assert kept <= len(stream)
    reader.close()
    assert budget.held == 0


def _sealed(sealer: Sealer, frame: bytes) -> bytes:
    header, content = frame[: HEADER.size], frame[HEADER.size :]
    return pack_frame(header, sealer.seal(content, header))


def _read_frames(data: bytes) -> None:
    """Frames of any content come out as they went in, however the stream is cut."""
    choice = data[0] if data else 0
    budget = Budget(_BUDGET)
    reader = FrameReader(_LONGEST, budget)
    frames: list[bytes] = []
    stream = data[1:]
    size = choice or 1
    try:
        for at in range(0, len(stream), size):
            frames += map(bytes, reader.feed(stream[at : at + size]))
            assert 0 <= budget.held <= _BUDGET
    except ProtocolError:
        pass
    else:
        assert b"".join(map(pack_frame, frames)) == stream[: sum(len(frame) + 4 for frame in frames)]
    assert all(len(frame) <= _LONGEST for frame in frames)


def _read_history(payload: bytes) -> None:
    try:
        header, rest = split_history(payload)
    except ProtocolError:
        return
    assert split_history(header.pack() + rest) == (header, rest)


def _read_call(payload: bytes) -> None:
    try:
        frame = unpack_call(payload)
    except ProtocolError as error:
        check_text(str(error), 100)
        return
    assert frame.pack() == payload
    assert (frame.what is What.MESSAGE) == (frame.call == 0)


def _round_trip(suite: CipherSuite, data: bytes) -> None:
    """Check that one side reads what the other writes: in one frame or in chunks, interleaved."""
    choice = data[0] if data else 0
    payload = data[1:]
    writer = DataWriter(Sealer(suite, _KEY), _ROUTE)
    reader = StreamedReader(StreamOpener(suite, _KEY), max(len(payload), 1))
    chunk = choice + 1
    stream = write_frame(writer, payload, 5, choice & 1) + b"".join(write_chunks(writer, payload, 2**64 - 1, 0, chunk))
    assert reader.receive_data(stream) == [(payload, 5, choice & 1), (payload, 2**64 - 1, 0)]


def _frame(flags: int, content: bytes) -> bytes:
    frame = HEADER.pack(DATA, flags, _ROUTE, 9) + content
    return len(frame).to_bytes(4, "big") + frame


def _calls() -> Iterator[bytes]:
    for what in What:
        yield CallFrame(what, 2, 0 if what is What.MESSAGE else 7, 0, b"\0\1\0\0content").pack()


_HISTORY = HistoryHeader(bytes(range(16)), 3, 10).pack()

PARSERS = (
    Parser(
        "data_stream",
        _read_stream,
        (
            b"\1" + _frame(0, b"a message") + _frame(HISTORY, _HISTORY + b"kept"),
            b"\1" + _frame(MORE, b"a ") + _frame(MORE, b"message ") + _frame(0, b"in chunks"),
            b"\7" + _frame(MORE, bytes(900)) + _frame(0, bytes(90)),
            bytes(1) + write_frame(DataWriter(Sealer(CipherSuite.PLAIN, None), _ROUTE), b"a message", 9),
        ),
        behind(1, edit_bytes),
    ),
    Parser("frames", _read_frames, (b"\3" + pack_frame(b"one") + pack_frame(b"") + pack_frame(b"three"),)),
    Parser("history_header", _read_history, (_HISTORY + b"content",)),
    Parser("call_frame", _read_call, tuple(_calls())),
    Parser("data_round_trip", partial(_round_trip, CipherSuite.AESGCM), (b"\3any content", bytes(40))),
)

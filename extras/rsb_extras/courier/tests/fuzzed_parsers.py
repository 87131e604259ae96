"""What a peer says of recordings and asks for, and its pieces."""

from __future__ import annotations

from hashlib import sha256

import msgspec
from tests.fuzz.editing import edit_msgpack
from tests.fuzz.parser import Parser
from tests.fuzz.parsers.control_messages import check_message

from rsb_bridge.wire.codec import decode, encode
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_extras.courier.courier_messages import AskRecordings, BeginPieces, PiecesEnded, PiecesTaken, RecordingsAnswer
from rsb_extras.courier.courier_records import LATEST, MOST_SPANS, MOST_TOPICS, PAGE, Cursor, Wanted, WantedSpan
from rsb_extras.courier.picking import picked
from rsb_extras.courier.pieces import PIECE, Cutter, Joiner, PieceError, decode_piece, encode_piece
from rsb_extras.courier.tests.bags import BEGAN, channel
from rsb_extras.courier.tests.scripted_answers import DRIVE
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.stored_message import StoredMessage

_WANTED = Wanted(DRIVE.id, DRIVE.stamp, ("/scan", "/tf"), 1, 2)
_MESSAGES = (
    AskRecordings(1),
    AskRecordings(2, DRIVE.id),
    RecordingsAnswer(1, (DRIVE,), more=True),
    RecordingsAnswer(1, problem="no"),
    BeginPieces(1, 2, _WANTED, Cursor(1, 2, 3), (b"12345678",)),
    BeginPieces(2, 2, Wanted(DRIVE.id, DRIVE.stamp, ("/scan",), 1, 2, heads=True)),
    BeginPieces(3, 2, msgspec.structs.replace(_WANTED, spans=(WantedSpan(0, 0, 5), WantedSpan(1, 3)))),
    PiecesTaken(1, 9, 4),
    PiecesEnded(1, "the recording has changed", is_final=True),
)


class _NoRecording(OpenRecording):
    """One without a message, which is looked through all the same."""

    def __init__(self) -> None:
        self._blocks = []


_RECORDING = _NoRecording()
_OWN = tuple(type(each) for each in _MESSAGES)


def _read_message(data: bytes) -> None:
    try:
        message = decode(data)
    except ProtocolError:
        return
    if not isinstance(message, _OWN):
        return
    check_message(message)
    if isinstance(message, RecordingsAnswer):
        assert len(message.recordings) <= PAGE
        assert all(len(each.topics) <= MOST_TOPICS for each in message.recordings)
    if isinstance(message, BeginPieces):
        assert len(message.wanted.spans) <= MOST_SPANS
        assert not [*picked(_RECORDING, message.wanted, message.wanted.topics, message.at.time)]
    assert decode(encode(message)) == message


_CONTENT = tuple(StoredMessage(channel("/scan"), BEGAN + at, 0, at, memoryview(b"\0\1\0\0abcd")) for at in range(3))
_HASH = 32


def _read_piece(data: bytes) -> None:
    """Its hash is made anew: a peer that lies can do that, too."""

    joiner = Joiner({"/scan"}, 0, LATEST)
    try:
        content = decode_piece(sha256(data).digest() + data).content()
        found = [*joiner.add(content)]
        joiner.finish()
    except PieceError:
        return
    assert len(content.messages) <= PIECE
    assert all(each.channel.topic == "/scan" for each in found)
    assert [each.time for each in found] == sorted(each.time for each in found)


_PIECE = encode_piece(Cutter(1, iter(_CONTENT), Cursor(), ()).next())
PARSERS = (
    Parser("recordings_message", _read_message, tuple(map(encode, _MESSAGES)), edit_msgpack),
    Parser("recording_piece", _read_piece, (_PIECE[_HASH:],)),
)

import itertools
import struct
import time
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.frames import StreamedReader, write_chunks, write_frame
from tests.support.held import held_by
from tests.support.wording import pattern, says

from rsb_bridge.wire.framing import (
    HEADER,
    MORE,
    RESUMED,
    SOURCE_FLAGS,
    SOURCE_SHIFT,
    ZSTD,
    Budget,
    DataWriter,
    FrameReader,
    Message,
    pack_frame,
)
from rsb_bridge.wire.protocol_error import Broken, ProtocolError
from rsb_bridge.wire.sealing import EPOCH_BITS, CipherSuite, InvalidSeal, Sealer, SealError, StreamOpener

FLAGS = [0, ZSTD, SOURCE_FLAGS, ZSTD | 1 << SOURCE_SHIFT]
KEY = bytes(range(32))
ROUTE = 7
SUITES = pytest.mark.parametrize("suite", list(CipherSuite))

messages = st.lists(st.tuples(st.binary(max_size=300), st.integers(0, 2**64 - 1), st.sampled_from(FLAGS)), max_size=8)


@st.composite
def pieces(draw: st.DrawFn, stream: bytes) -> list[bytes]:
    cuts = sorted(draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    return [stream[a:b] for a, b in itertools.pairwise([0, *cuts, len(stream)])]


def data_ends(
    suite: CipherSuite, route: int = ROUTE, limit: int = 1 << 20, key: bytes = KEY, budget: Budget | None = None
) -> tuple[DataWriter, StreamedReader]:
    return (
        DataWriter(Sealer(suite, None if suite is CipherSuite.PLAIN else KEY), route),
        StreamedReader(StreamOpener(suite, None if suite is CipherSuite.PLAIN else key), limit, budget),
    )


@given(st.data(), st.lists(st.binary(max_size=50), max_size=8))
def test_frames_survive_any_cut_of_stream(data: st.DataObject, frames: list[bytes]) -> None:
    budget = Budget(1 << 20)
    reader = FrameReader(50, budget)
    stream = b"".join(pack_frame(frame) for frame in frames)
    out = [bytes(frame) for piece in data.draw(pieces(stream)) for frame in reader.feed(piece)]
    assert out == frames
    assert budget.held == 0


@given(st.data(), st.binary(max_size=200))
def test_garbage_keeps_no_more_than_frame(data: st.DataObject, garbage: bytes) -> None:
    budget = Budget(1 << 20)
    reader = FrameReader(50, budget)
    whole, words = 0, ""
    try:
        for piece in data.draw(pieces(garbage)):
            for frame in reader.feed(piece):
                assert len(frame) <= 50
                whole += 4 + len(frame)
            assert budget.held < 54
    except ProtocolError as error:
        words = str(error)
    if words:
        # Frames before it in the same piece are not handed out, so the length it names may be further on.
        assert says(words, Broken.FRAME_TOO_LONG, limit=50)
    else:
        assert whole + budget.held == len(garbage)


def test_a_length_is_refused_before_its_content_comes() -> None:
    reader = FrameReader(100)
    assert [bytes(frame) for frame in reader.feed(pack_frame(bytes(100)))] == [bytes(100)]
    assert reader.feed(b"\x00\x00\x00") == []
    with pytest.raises(ProtocolError, match=pattern(Broken.FRAME_TOO_LONG, length=101, limit=100)):
        reader.feed(b"\x65")
    with pytest.raises(ProtocolError, match=pattern(Broken.FRAME_TOO_LONG, length=2**32 - 1)):
        FrameReader(100).feed(b"\xff\xff\xff\xff")


def test_the_limit_can_be_changed() -> None:
    reader = FrameReader(10)
    reader.limit = 20
    assert len(reader.feed(pack_frame(bytes(20)))) == 1


def test_large_frame_in_small_pieces_takes_linear_time() -> None:
    size, piece = 32 << 20, bytes(1 << 14)
    reader = FrameReader(size)
    began = time.process_time()
    assert reader.feed(struct.pack(">I", size)) == []
    frames = [frame for _ in range(size // len(piece)) for frame in reader.feed(piece)]
    # Copying all again at each of the 2,048 pieces would be 32 GiB: well over this.
    assert time.process_time() - began < 2.0
    assert [len(frame) for frame in frames] == [size]


def test_a_data_frame_is_as_the_document_says() -> None:
    writer, _ = data_ends(CipherSuite.PLAIN)
    header = bytes((1, 1)) + struct.pack(">IQ", ROUTE, 1234)
    content = b"payload"
    tag = struct.pack(">I", zlib.crc32(bytes(8) + header + content))
    assert write_frame(writer, content, 1234, ZSTD) == struct.pack(">I", 14 + 7 + 4) + header + content + tag


@SUITES
@given(data=st.data(), sent=messages)
def test_messages_survive_any_cut_of_stream(suite: CipherSuite, data: st.DataObject, sent: list[Message]) -> None:
    writer, reader = data_ends(suite)
    stream = writer.write_many(sent[:4]) + b"".join(write_frame(writer, *message) for message in sent[4:])
    assert [message for piece in data.draw(pieces(stream)) for message in reader.receive_data(piece)] == sent


@SUITES
def test_message_may_have_limit_and_no_byte_more(suite: CipherSuite) -> None:
    writer, reader = data_ends(suite, limit=100)
    assert reader.receive_data(write_frame(writer, bytes(100), 0)) == [(bytes(100), 0, 0)]
    with pytest.raises(ProtocolError, match=pattern(Broken.FRAME_TOO_LONG)):
        reader.receive_data(write_frame(writer, bytes(101), 0))
    writer, reader = data_ends(suite, limit=100)
    assert reader.receive_data(b"".join(write_chunks(writer, bytes(100), 0, 0, 30))) == [(bytes(100), 0, 0)]
    with pytest.raises(ProtocolError, match=pattern(Broken.TOO_LONG_IN_CHUNKS, limit=100)):
        reader.receive_data(b"".join(write_chunks(writer, bytes(101), 0, 0, 30)))


@SUITES
@given(data=st.data(), sent=messages, chunk_size=st.integers(1, 100))
def test_held_bytes_are_those_of_unfinished(
    suite: CipherSuite, data: st.DataObject, sent: list[Message], chunk_size: int
) -> None:
    """Chunks and a frame that is cut; after any input, nothing is held once the reader is closed."""
    budget = Budget(1 << 20)
    writer, reader = data_ends(suite, budget=budget)
    stream = b"".join(frame for message in sent for frame in write_chunks(writer, *message, chunk_size))
    for piece in data.draw(pieces(stream))[: data.draw(st.integers(0, 10))]:
        reader.receive_data(piece)
        assert budget.held == held_by(reader.frames) + reader._chunks.held
    reader.close()
    assert budget.held == 0


@pytest.mark.parametrize("began", ["a frame", "chunks"])
def test_readers_hold_no_more_than_their_budget_together(began: str) -> None:
    budget = Budget(1000)
    ends = [data_ends(CipherSuite.AESGCM, route, budget=budget) for route in (1, 3)]
    if began == "a frame":
        begun = [write_frame(writer, bytes(700), 0)[:600] for writer, _ in ends]
    else:
        begun = [write_frame(writer, bytes(600), 0, MORE) for writer, _ in ends]
    (_, first), (_, second) = ends
    assert first.receive_data(begun[0]) == []
    with pytest.raises(ProtocolError, match=pattern(Broken.TOO_MUCH_INCOMPLETE, limit=1000)):
        second.receive_data(begun[1])
    second.close()
    assert budget.held == 600
    first.close()
    assert budget.held == 0


def test_message_that_comes_at_once_costs_budget_nothing() -> None:
    writer, reader = data_ends(CipherSuite.AESGCM, budget=Budget(0))
    assert reader.receive_data(write_frame(writer, bytes(5000), 0)) == [(bytes(5000), 0, 0)]


def test_empty_chunks_are_harmless() -> None:
    writer, reader = data_ends(CipherSuite.AESGCM)
    stream = write_frame(writer, b"", 0, MORE) + write_frame(writer, b"a", 0, MORE) + write_frame(writer, b"", 5)
    assert reader.receive_data(stream) == [(b"a", 5, 0)]


def test_frame_without_header_is_refused_in_words() -> None:
    _, reader = data_ends(CipherSuite.AESGCM)
    with pytest.raises(ProtocolError, match=pattern(Broken.DATA_FRAME_TOO_SHORT, length=13)):
        reader.receive_data(pack_frame(bytes(13)))


def test_replayed_missing_or_foreign_frame_does_not_open() -> None:
    writer, reader = data_ends(CipherSuite.AESGCM)
    first, second = write_frame(writer, b"1", 0), write_frame(writer, b"2", 0)
    reader.receive_data(first)
    _, new = data_ends(CipherSuite.AESGCM)
    _, stranger = data_ends(CipherSuite.AESGCM, key=bytes(32))
    for each, frame in ((reader, first), (new, second), (stranger, first)):
        with pytest.raises(SealError, match=pattern(InvalidSeal.FORGED)):
            each.receive_data(frame)


@SUITES
@given(data=st.data())
def test_damage_anywhere_is_never_delivered(suite: CipherSuite, data: st.DataObject) -> None:
    writer, reader = data_ends(suite)
    stream = bytearray(writer.write_many([(b"first", 1, 0), (b"second", 2, ZSTD)]))
    at = data.draw(st.integers(0, len(stream) - 1))
    stream[at] ^= data.draw(st.integers(1, 255))
    try:
        out = reader.receive_data(stream)
    except (ProtocolError, SealError):
        return
    # Only a length may be damaged without a word yet: then the frame is not whole.
    assert out in ([], [(b"first", 1, 0)])


def test_a_resumed_frame_is_as_the_document_says() -> None:
    writer, _ = data_ends(CipherSuite.PLAIN)
    writer.write_many([(b"a", 1, 0), (b"b", 2, 0)])
    header, content = bytes((3, 0)) + struct.pack(">IQ", ROUTE, 2), struct.pack(">Q", 2)
    tag = struct.pack(">I", zlib.crc32(struct.pack(">Q", 2) + header + content))
    assert writer.write_resumed() == struct.pack(">I", 14 + 8 + 4) + header + content + tag


@SUITES
@pytest.mark.parametrize("ahead", [0, 1 << EPOCH_BITS])
def test_messages_go_on_after_lost_stream(suite: CipherSuite, ahead: int) -> None:
    """Some come, then half a message, and some are lost; the half one comes whole. Then all of it again."""
    budget = Budget(1 << 20)
    sealer = Sealer(suite, None if suite is CipherSuite.PLAIN else KEY)
    writer = DataWriter(sealer, ROUTE)
    _, reader = data_ends(suite, budget=budget)
    for turn in (1, 2):
        assert reader.receive_data(write_frame(writer, b"came", 1)) == [(b"came", 1, 0)]
        begun, *_ = write_chunks(writer, bytes(100), 0, 0, 60)
        writer.messages -= 1  # its second half stays with the sender
        reader.receive_data(begun)
        assert budget.held
        writer.write_many([(b"lost", 1, 0)] * 5)
        sealer.sequence += ahead
        reader.open_resumed(writer.write_resumed()[4:])
        assert budget.held == 0
        assert reader.receive_data(write_frame(writer, bytes(100), 2)) == [(bytes(100), 2, 0)]
        assert (reader.messages, reader.lost) == (2 * turn, 5 * turn)


@SUITES
def test_what_is_sent_again_comes_once(suite: CipherSuite) -> None:
    """Four of five messages have arrived, and the sender knows of two. It is cut while it sends the others again."""
    writer, reader = data_ends(suite)
    messages = [(str(number).encode(), number, 0) for number in range(8)]
    come = writer.write_many(messages[:4])
    assert reader.receive_data(come) == messages[:4]
    writer.write_many(messages[4:5])
    reader.open_resumed(writer.write_resumed(again=3)[4:])
    assert reader.receive_data(writer.write_many(messages[2:3])) == []
    reader.open_resumed(writer.write_resumed(again=1)[4:])
    assert reader.receive_data(writer.write_many(messages[2:4])) == []
    assert reader.receive_data(writer.write_many(messages[4:6])) == messages[4:6]
    begun, *rest = write_chunks(writer, b"67", 6, 0, 1)
    assert [each for frame in (begun, *rest) for each in reader.receive_data(frame)] == [(b"67", 6, 0)]
    reader.open_resumed(writer.write_resumed(again=1)[4:])
    assert [each for frame in write_chunks(writer, b"67", 6, 0, 1) for each in reader.receive_data(frame)] == []
    assert (reader.messages, reader.lost) == (7, 0)


@SUITES
def test_route_resumes_under_other_keys(suite: CipherSuite) -> None:
    """The next connection has its own keys. Messages that have arrived are dropped, and incomplete ones discarded."""
    writer, reader = data_ends(suite)
    assert reader.receive_data(writer.write_many([(b"a", 1, 0), (b"b", 2, 0)])) == [(b"a", 1, 0), (b"b", 2, 0)]
    begun, *_ = write_chunks(writer, b"long", 3, 0, 2)
    reader.receive_data(begun)
    key = None if suite is CipherSuite.PLAIN else bytes(range(1, 33))
    writer.messages -= 1  # the long one is sent again in full
    writer.resume(Sealer(suite, key))
    reader.resume(StreamOpener(suite, key))
    reader.open_resumed(writer.write_resumed(again=1)[4:])
    assert reader.receive_data(writer.write_many([(b"b", 2, 0), (b"long", 3, 0)])) == [(b"long", 3, 0)]
    pieces = write_chunks(writer, b"longer", 4, 0, 3)
    assert [each for piece in pieces for each in reader.receive_data(piece)] == [(b"longer", 4, 0)]


def test_a_resumed_frame_that_cannot_be_is_refused() -> None:
    writer, reader = data_ends(CipherSuite.AESGCM)
    earlier = writer.write_resumed()[4:]
    reader.open_resumed(earlier)
    with pytest.raises(SealError, match=pattern(InvalidSeal.REPLAYED)):
        reader.open_resumed(earlier)
    for content in (b"short", struct.pack(">Q", 2**64 - 1)):
        sealer = Sealer(CipherSuite.AESGCM, KEY)
        sealer.sequence = 3
        header = HEADER.pack(RESUMED, 0, ROUTE, 3)
        with pytest.raises(ProtocolError, match=pattern(Broken.RESUMED_WRONG)):
            data_ends(CipherSuite.AESGCM)[1].open_resumed(header + sealer.seal(content, header))
    header = HEADER.pack(RESUMED, 0, ROUTE, 2 << EPOCH_BITS)
    with pytest.raises(SealError, match=pattern(InvalidSeal.EPOCH_TOO_FAR_AHEAD)):
        reader.open_resumed(header + bytes(24))

"""Large messages: sealed piece by piece in place, opened into their place."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.frames import StreamedReader, write_chunks, write_frame

from rsb_bridge.wire.framing import HEADER, MORE, ZSTD, Assembly, Budget, DataWriter, Message
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.sealing import CipherSuite, Sealer, SealError, StreamOpener

KEY = bytes(range(32))
ROUTE = 7
SUITES = pytest.mark.parametrize("suite", list(CipherSuite))


def ends(suite: CipherSuite, limit: int = 1 << 20, budget: Budget | None = None) -> tuple[DataWriter, StreamedReader]:
    key = None if suite is CipherSuite.PLAIN else KEY
    return DataWriter(Sealer(suite, key), ROUTE), StreamedReader(StreamOpener(suite, key), limit, budget)


def parts(message: Message, chunk: int) -> list[Message]:
    payload, stamp, flags = message
    found = [(payload[at : at + chunk], stamp, flags | MORE) for at in range(0, max(1, len(payload)), chunk)]
    return [*found[:-1], (found[-1][0], stamp, flags)]


@SUITES
@given(
    sent=st.lists(
        st.tuples(st.binary(max_size=300), st.integers(0, 2**64 - 1), st.sampled_from([0, ZSTD])), max_size=5
    ),
    chunk=st.integers(1, 100),
    data=st.data(),
)
def test_pieces_are_the_chunks_of_their_message(
    suite: CipherSuite, sent: list[Message], chunk: int, data: st.DataObject
) -> None:
    """Byte for byte what `write_many` makes of the parts, and put together however the stream is cut."""
    writer, reader = ends(suite)
    other, _ = ends(suite)
    stream = b"".join(frame for message in sent for frame in write_chunks(writer, *message, chunk))
    assert stream == b"".join(other.write_many(parts(message, chunk)) for message in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    pieces = [stream[a:b] for a, b in itertools.pairwise([0, *cuts, len(stream)])]
    assert [message for piece in pieces for message in reader.receive_data(piece)] == sent


@SUITES
@pytest.mark.parametrize("size", [0, 1, 65_535, 65_536, 65_537, 1 << 20, 6_000_000])
def test_large_messages_are_exact(suite: CipherSuite, size: int) -> None:
    """For any size of the one before, whose memory is reused."""
    writer, reader = ends(suite, limit=8 << 20)
    for length, fill in ((size, b"abc"), (100_000, b"x"), (size, b"cba")):
        payload = (fill * (length // len(fill) + 1))[:length]
        stream = b"".join(write_chunks(writer, payload, 5, 0, 1 << 16))
        assert reader.receive_data(stream) == [(payload, 5, 0)]
    assert reader.budget.held == 0


@SUITES
def test_damage_in_a_chunk_is_never_delivered(suite: CipherSuite) -> None:
    for at in (5, 20, 60, -1):
        writer, reader = ends(suite)
        stream = bytearray(b"".join(write_chunks(writer, bytes(60), 0, 0, 30)))
        stream[at] ^= 1
        with pytest.raises((SealError, ProtocolError)):
            reader.receive_data(stream + bytes(200))


@SUITES
@given(garbage=st.binary(max_size=40))
def test_garbage_does_not_open_into_its_place(suite: CipherSuite, garbage: bytes) -> None:
    _, reader = ends(suite)
    header = HEADER.pack(1, MORE, ROUTE, 0)
    with pytest.raises(SealError):
        reader.open_frames((header + garbage,))
    reader.close()
    assert reader.budget.held == 0


def test_memory_follows_last_message_within_budget() -> None:
    budget = Budget(1000)
    writer, reader = ends(CipherSuite.AESGCM, budget=budget)
    first = write_chunks(writer, bytes(600), 0, 0, 100)
    for frame, held in zip(first, (100, 200, 400, 400, 800), strict=False):
        reader.receive_data(frame)
        assert budget.held == held
    assert reader.receive_data(first[-1]) == [(bytes(600), 0, 0)]
    second = write_chunks(writer, bytes(600), 0, 0, 100)
    reader.receive_data(second[0])
    assert budget.held == 600
    reader.close()
    budget.take(880)  # others' messages leave room for this one only
    writer, reader = ends(CipherSuite.AESGCM, budget=budget)
    frames = write_chunks(writer, bytes(110), 0, 0, 50)
    for frame, held in zip(frames, (930, 980), strict=False):
        reader.receive_data(frame)
        assert budget.held == held
    assert reader.receive_data(frames[-1]) == [(bytes(110), 0, 0)]
    assert budget.held == 880
    with pytest.raises(ProtocolError):
        reader.receive_data(write_frame(writer, bytes(121), 0, MORE))


def test_an_assembly_refuses_more_than_its_limit() -> None:
    budget = Budget(1000)
    sealer, opener = Sealer(CipherSuite.AESGCM, KEY), StreamOpener(CipherSuite.AESGCM, KEY)
    assembly = Assembly(opener, 100, budget)
    assembly.add(sealer.seal(bytes(60), b"a"), b"a")
    assert assembly.begun
    with pytest.raises(ProtocolError):
        assembly.add(sealer.seal(bytes(60), b"a"), b"a")
    assembly.close()
    assert not assembly.begun
    assert budget.held == 0

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.wording import pattern

from rsb_bridge.wire.datagram import (
    FRAGMENTS_LIMIT,
    Arrived,
    DatagramReader,
    DatagramWriter,
    Probe,
    Receipt,
    Urgent,
    by_addressee,
    receipts,
    unpack_probe,
)
from rsb_bridge.wire.framing import LEASED, SOURCE_FLAGS, SOURCE_SHIFT, ZSTD, Budget
from rsb_bridge.wire.protocol_error import Broken, Misuse, ProtocolError
from rsb_bridge.wire.sealing import PROBE_ROUTE, CipherSuite, DatagramOpener, Sealer

KEY = bytes(range(32))
LINK = b"linklink"
ROUTE = 7
OVERHEAD = 38 + 16
HEADER = struct.Struct(">BBHHI8sQIQ")
SUITES = pytest.mark.parametrize("suite", list(CipherSuite))

FLAGS = [0, ZSTD, SOURCE_FLAGS, ZSTD | 1 << SOURCE_SHIFT]


def ends(
    suite: CipherSuite = CipherSuite.AESGCM, key: bytes = KEY, **limits: Any
) -> tuple[DatagramWriter, DatagramReader]:
    plain = suite is CipherSuite.PLAIN
    return (
        DatagramWriter(Sealer(suite, None if plain else KEY), LINK, ROUTE),
        DatagramReader(DatagramOpener(suite, None if plain else key), ROUTE, **limits),
    )


class Peer:
    def __init__(self) -> None:
        self.sealer = Sealer(CipherSuite.AESGCM, KEY)

    def datagram(
        self,
        content: bytes = b"x",
        *,
        magic: int = 0xB5,
        flags: int = 0,
        index: int = 0,
        count: int = 1,
        route: int = ROUTE,
        number: int = 1,
    ) -> bytes:
        header = HEADER.pack(magic, flags, index, count, route, LINK, self.sealer.sequence, number, 0)
        return header + self.sealer.seal(content, header)


def test_a_datagram_is_as_the_document_says() -> None:
    writer, _ = ends()
    writer.number = 4
    first, second = writer.write(b"abc", 1234, ZSTD, OVERHEAD + 2)
    assert first[:38] == bytes((0xB5, 1)) + struct.pack(">HHI", 0, 2, ROUTE) + LINK + struct.pack(">QIQ", 0, 5, 1234)
    assert second[:38] == bytes((0xB5, 1)) + struct.pack(">HHI", 1, 2, ROUTE) + LINK + struct.pack(">QIQ", 1, 5, 1234)
    sealer = Sealer(CipherSuite.AESGCM, KEY)
    assert first[38:] == sealer.seal(b"ab", first[:38])
    assert second[38:] == sealer.seal(b"c", second[:38])
    assert by_addressee([(second, 1)]) == {(ROUTE, LINK, 1): [second]}


@SUITES
@given(
    data=st.data(),
    sent=st.lists(st.tuples(st.binary(max_size=300), st.integers(0, 2**64 - 1), st.sampled_from(FLAGS)), max_size=6),
    room=st.integers(2, 120),  # so that disorder stays within the replay window
)
def test_messages_come_whole_and_once_in_whatever_order(
    suite: CipherSuite, data: st.DataObject, sent: list[tuple[bytes, int, int]], room: int
) -> None:
    writer, reader = ends(suite)
    size = 38 + suite.tag_length + room
    datagrams = [datagram for message in sent for datagram in writer.write(*message, size)]
    assert all(len(datagram) <= size for datagram in datagrams)
    shuffled = data.draw(st.permutations(datagrams))
    repeated = data.draw(st.lists(st.sampled_from(shuffled), max_size=5)) if shuffled else []
    out = [message for datagram in shuffled + repeated if (message := reader.receive(datagram, 0.0)) is not None]
    assert sorted(out) == sorted(sent)
    assert (reader.newest, reader.pending, reader.expired) == (len(sent), 0, 0)


@pytest.mark.parametrize(("flags", "out"), [(LEASED, [2, 3]), (LEASED | ZSTD, [2, 3]), (0, [2, 3, 0, 1])])
@pytest.mark.parametrize("size", [1, 20], ids=["one datagram", "two datagrams"])
def test_no_leased_message_comes_after_a_later_one(size: int, flags: int, out: list[int]) -> None:
    """The later one may be the stop of its motion, and nothing else may follow."""
    writer, reader = ends()
    writer.number = reader.newest = 2**32 - 2
    sent = [writer.write(bytes(size), stamp, flags, OVERHEAD + 10) for stamp in range(4)]
    found = [reader.receive(each, 0.0) for at in (2, 3, 0, 1) for each in sent[at]]
    assert [message[1] for message in found if message is not None] == out
    assert (reader.pending, reader.expired) == (0, 0)


@given(data=st.data(), sizes=st.lists(st.integers(0, 60), min_size=1, max_size=12))
def test_every_message_is_accounted_for_whatever_is_lost(data: st.DataObject, sizes: list[int]) -> None:
    budget = Budget(1 << 20)
    writer, reader = ends(budget=budget)
    datagrams = [datagram for size in sizes for datagram in writer.write(bytes(size), 0, 0, OVERHEAD + 10)]
    arriving = data.draw(st.lists(st.sampled_from(range(len(datagrams))), unique=True))
    numbers = [number for number, size in enumerate(sizes, 1) for _ in range(max(1, -(-size // 10)))]
    seen, whole = set(), 0
    for at in arriving:
        whole += reader.receive(datagrams[at], data.draw(st.sampled_from([0.0, 1.0]))) is not None
        if data.draw(st.booleans()):
            reader.expire(1.5)
        seen.add(numbers[at])
        assert reader.newest == max(seen)
        assert whole + reader.expired + reader.pending <= len(seen)  # a late fragment of a message given up adds none
    reader.expire(10.0)
    assert reader.pending == 0
    assert budget.held == 0


def test_incomplete_messages_are_given_up_for_good() -> None:
    writer, reader = ends()
    old, new = (writer.write(bytes(20), 0, 0, OVERHEAD + 10) for _ in range(2))
    assert reader.receive(old[0], 10.0) is None
    assert reader.receive(new[0], 10.5) is None
    reader.expire(11.0)
    assert (reader.pending, reader.expired) == (2, 0)
    reader.expire(11.1)
    assert (reader.pending, reader.expired) == (1, 1)
    assert reader.receive(old[1], 11.2) is None
    assert (reader.pending, reader.expired) == (1, 1)
    assert reader.receive(new[1], 11.3) == (bytes(20), 0, 0)
    reader.expire(99.0)
    assert (reader.pending, reader.expired) == (0, 1)


def test_message_that_continues_is_not_given_up() -> None:
    """One of many MB on a slow path may take longer; messages in between do not matter."""
    writer, reader = ends()
    slow, other = (writer.write(bytes(40), 0, 0, OVERHEAD + 10) for _ in range(2))
    (newest,) = writer.write(b"", 0, 0, OVERHEAD + 10)
    assert reader.receive(newest, 0.0) is not None
    assert reader.receive(other[0], 0.0) is None
    for index, fragment in enumerate(slow):
        reader.expire(index * 0.9)
        message = reader.receive(fragment, index * 0.9)
    assert message == (bytes(40), 0, 0)
    assert (reader.pending, reader.expired) == (0, 1)


def test_message_given_up_early_is_not_kept() -> None:
    writer, reader = ends()
    first, second = (writer.write(bytes(20), 0, 0, OVERHEAD + 10) for _ in range(2))
    assert reader.receive(second[0], 0.0) is None
    assert reader.receive(first[0], 0.0) is None
    reader.expire(5.1)
    assert (reader.pending, reader.expired) == (0, 2)
    assert reader.receive(second[1], 6.0) is None
    assert reader.pending == 0


def test_kept_fragments_are_bounded_oldest_go() -> None:
    writer, reader = ends(budget=Budget(3 * 1400))
    messages = [writer.write(bytes(2000), 0, 0, OVERHEAD + 1000) for _ in range(4)]
    for fragments in messages:
        assert reader.receive(fragments[0], 0.0) is None
    assert (reader.pending, reader.expired) == (3, 1)
    assert reader.receive(messages[0][1], 0.0) is None
    assert reader.receive(messages[1][1], 0.0) == (bytes(2000), 0, 0)


def test_tiny_fragments_cost_what_they_take() -> None:
    peer, (_, reader) = Peer(), ends(budget=Budget(20_000))
    for number in range(1, 200):
        assert reader.receive(peer.datagram(b"", index=0, count=2, number=number), 0.0) is None
    assert reader.pending == 50
    assert reader.expired == 149


def test_share_of_other_routes_is_reserved() -> None:
    """Then the newest message is the oldest too, and is given up; a whole one still passes, and so does all again."""
    budget = Budget(2000)
    writer, reader = ends(budget=budget)
    messages = [writer.write(bytes(2000), 0, 0, OVERHEAD + 1000) for _ in range(3)]
    assert budget.take(1000)
    assert reader.receive(messages[0][0], 0.0) is None
    assert (reader.pending, reader.expired, budget.held) == (0, 1, 1000)
    assert reader.receive(writer.write(b"whole", 0, 0, 1400)[0], 0.0) == (b"whole", 0, 0)
    budget.give(1000)
    assert reader.receive(messages[1][0], 0.0) is None
    assert budget.held == 1400
    assert reader.receive(messages[1][1], 0.0) == (bytes(2000), 0, 0)
    assert reader.receive(messages[2][0], 0.0) is None
    reader.close()
    assert (reader.pending, reader.expired, budget.held) == (0, 1, 0)


def test_a_message_too_long_is_given_up() -> None:
    writer, reader = ends(max_message=25)
    assert reader.receive(writer.write(bytes(25), 0, 0, OVERHEAD + 10)[0], 0.0) is None
    for datagram in writer.write(bytes(26), 0, 0, OVERHEAD + 10):
        assert reader.receive(datagram, 0.0) is None
    assert (reader.pending, reader.expired) == (1, 1)  # the first message still waits


@pytest.mark.parametrize("second", [{"index": 1, "count": 3}, {"index": 0, "count": 2}])
def test_contradicting_fragments_give_message_up(second: dict[str, Any]) -> None:
    peer, (_, reader) = Peer(), ends()
    assert reader.receive(peer.datagram(index=0, count=2), 0.0) is None
    assert reader.receive(peer.datagram(**second), 0.0) is None
    assert (reader.pending, reader.expired) == (0, 1)


@pytest.mark.parametrize("fields", [{"magic": 0xB6}, {"index": 1}, {"index": 0, "count": 0}, {"route": 9}])
def test_a_datagram_against_the_format_is_ignored(fields: dict[str, Any]) -> None:
    peer, (_, reader) = Peer(), ends()
    assert reader.receive(peer.datagram(**fields), 0.0) is None
    assert (reader.newest, reader.pending) == (0, 0)
    assert reader.receive(peer.datagram(), 0.0) == (b"x", 0, 0)


@SUITES
@given(garbage=st.binary(max_size=100))
def test_garbage_is_ignored(suite: CipherSuite, garbage: bytes) -> None:
    _, reader = ends(suite)
    for datagram in (garbage, b"\xb5" + garbage, HEADER.pack(0xB5, 0, 0, 1, ROUTE, LINK, 0, 1, 0) + garbage):
        assert reader.receive(datagram, 0.0) is None
    assert (reader.newest, reader.pending) == (0, 0)


def test_only_our_own_datagrams_have_a_header() -> None:
    datagram = Peer().datagram()
    assert by_addressee([(datagram, None)]) == {(ROUTE, LINK, None): [datagram]}
    for foreign in (datagram[:37], b"\xb6" + datagram[1:], b""):
        assert by_addressee([(foreign, None)]) == {}


def test_datagrams_are_sorted_by_route_in_order() -> None:
    peer = Peer()
    first, second, other_route, third = peer.datagram(), peer.datagram(), peer.datagram(route=8), peer.datagram()
    other_link = first.replace(LINK, b"LINKlink")
    origins = [(first, 1), (other_route, 1), (second, 1), (other_link, 1), (b"foreign", 1), (third, 2), (first, 1)]
    assert by_addressee(origins) == {
        (ROUTE, LINK, 1): [first, second, first],
        (8, LINK, 1): [other_route],
        (ROUTE, b"LINKlink", 1): [other_link],
        (ROUTE, LINK, 2): [third],
    }


def test_another_key_or_another_link_does_not_open() -> None:
    writer, _ = ends()
    (datagram,) = writer.write(b"x", 0, 0, 1400)
    _, stranger = ends(key=bytes(32))
    assert stranger.receive(datagram, 0.0) is None
    _, reader = ends()
    assert reader.receive(datagram.replace(LINK, b"LINKlink"), 0.0) is None
    assert (stranger.newest, reader.newest) == (0, 0)


def test_message_numbers_are_counted_on_past_their_wrap() -> None:
    writer, reader = ends()
    writer.number = reader.newest = 2**32 - 2
    datagrams = [writer.write(bytes(20), n, 0, OVERHEAD + 10) for n in range(4)]
    whole = [reader.receive(datagrams[n][fragment], 0.0) for fragment in (1, 0) for n in (2, 0, 3, 1)]
    assert [message[1] for message in whole if message] == [2, 0, 3, 1]
    assert reader.newest == 2**32 + 2


def test_message_of_too_many_datagrams_costs_nothing() -> None:
    writer, reader = ends()
    assert len(writer.write(bytes(FRAGMENTS_LIMIT), 0, 0, OVERHEAD + 1)) == FRAGMENTS_LIMIT
    with pytest.raises(
        ValueError, match=pattern(Misuse.TOO_MANY_DATAGRAMS, length=FRAGMENTS_LIMIT + 1, limit=FRAGMENTS_LIMIT)
    ):
        writer.write(bytes(FRAGMENTS_LIMIT + 1), 0, 0, OVERHEAD + 1)
    assert writer.number == 1
    assert reader.receive(writer.write(b"next", 0, 0, 1400)[0], 0.0) == (b"next", 0, 0)


@given(st.booleans(), st.integers(0, 2**64 - 1))
def test_probes_travel_on_their_own_route(pong: bool, opaque: int) -> None:
    probe = Probe(pong, opaque)
    writer = DatagramWriter(Sealer(CipherSuite.AESGCM, KEY), LINK, PROBE_ROUTE)
    (datagram,) = writer.write(probe.pack(), 0, 0, 1400)
    assert list(by_addressee([(datagram, 0)])) == [(PROBE_ROUTE, LINK, 0)]
    message = DatagramReader(DatagramOpener(CipherSuite.AESGCM, KEY), PROBE_ROUTE).receive(datagram, 0.0)
    assert message is not None
    assert unpack_probe(message[0]) == probe


ARRIVED = st.builds(
    Arrived,
    st.integers(1, 2**32 - 1),
    st.integers(0, 2**64 - 1),
    st.integers(0, 2**64 - 1),
    st.one_of(st.just(0), st.integers(0, 2**1024 - 1)),
)


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1), st.lists(ARRIVED, min_size=1, max_size=60))
def test_receipts_are_as_the_document_says(buffer: int, at: int, routes: list[Arrived]) -> None:
    expected = []
    for each in routes:
        missing = each.missing.to_bytes(128).lstrip(b"\0")
        expected.append(struct.pack(">IQQB", each.route, each.newest, each.opened, len(missing)) + missing)
    receipt = Receipt(buffer, at, tuple(routes))
    assert receipt.pack() == struct.pack(">BIQ", 2, buffer, at) + b"".join(expected)
    assert unpack_probe(receipt.pack()) == receipt
    with pytest.raises(ProtocolError, match=pattern(Broken.PROBE_INVALID, length=len(receipt.pack()))):
        unpack_probe(b"\4" + receipt.pack()[1:])
    with pytest.raises(ProtocolError, match=pattern(Broken.RECEIPT_INVALID, length=len(receipt.pack()) - 1)):
        unpack_probe(receipt.pack()[:-1])
    parts = [*receipts(buffer, at, routes)]
    assert [each for part in parts for each in part.arrived] == routes
    assert all(len(part.pack()) <= 1100 and part[:2] == receipt[:2] for part in parts)


def test_no_receipt_is_of_nothing() -> None:
    assert [*receipts(1, 2, ())] == []
    with pytest.raises(ProtocolError, match=pattern(Broken.RECEIPT_INVALID, length=5)):
        unpack_probe(b"\2" + bytes(4))


@given(st.binary(max_size=40))
def test_an_urgent_message_is_as_the_document_says(content: bytes) -> None:
    assert Urgent(content).pack() == b"\3" + content
    assert unpack_probe(b"\3" + content) == Urgent(content)


def test_datagram_asks_for_receipt_beside_its_message() -> None:
    writer, reader = ends()
    (first, *others) = writer.write_many([(bytes(25), 1, ZSTD), (b"x", 2, 0)], OVERHEAD + 10, asks=True)
    reader.receive(others[0], 0.0)
    assert not reader.asked
    reader.receive(first, 0.0)
    assert reader.asked
    assert [message for each in others[1:] if (message := reader.receive(each, 0.0))] == [
        (bytes(25), 1, ZSTD),
        (b"x", 2, 0),
    ]


def test_a_message_is_written_piece_by_piece() -> None:
    (whole, _), (cut, reader) = ends(), ends()
    pieces = cut.cut((bytes(95), 7, ZSTD), OVERHEAD + 10)
    datagrams = [each for begin in range(0, 10, 3) for each in cut.write_pieces(pieces, begin, begin + 3)]
    assert datagrams == whole.write(bytes(95), 7, ZSTD, OVERHEAD + 10)
    assert (cut.number, cut.largest, cut.room(OVERHEAD + 10)) == (whole.number, whole.largest, 10)
    for each in datagrams[:-1]:
        assert reader.receive(each, 0.0) is None
    reader.expire(4.9)
    assert reader.receive(datagrams[-1], 5.0) == (bytes(95), 7, ZSTD)


@pytest.mark.parametrize("order", [1, -1], ids=["in order", "reordered"])
def test_newest_message_may_take_longer_to_become_whole(order: int) -> None:
    writer, reader = ends()
    for datagrams in [writer.write(bytes(30), 0, 0, OVERHEAD + 10) for _ in range(2)][::order]:
        reader.receive(datagrams[0], 0.0)
    reader.expire(1.1)
    assert (reader.expired, reader.pending) == (1, 1)
    reader.expire(5.1)
    assert (reader.expired, reader.pending) == (2, 0)


def test_many_messages_are_written_as_one_by_one() -> None:
    (many, _), (one, reader) = ends(), ends()
    messages = [(bytes([index]) * size, index, ZSTD) for index, size in enumerate((0, 5, 25, 10, 11))]
    together = many.write_many(messages, OVERHEAD + 10)
    assert together == [datagram for message in messages for datagram in one.write(*message, OVERHEAD + 10)]
    assert (many.number, many.sequence, many.largest) == (one.number, one.sequence, one.largest) == (5, 8, 25)
    assert [message for each in together if (message := reader.receive(each, 0.0)) is not None] == messages


def test_a_reader_counts_what_it_opens() -> None:
    writer, reader = ends()
    datagrams = writer.write(bytes(30), 0, 0, OVERHEAD + 10)
    assert (reader.opened, reader.newest_sequence, writer.sequence) == (0, -1, 3)
    for index in (2, 0, 0):
        reader.receive(datagrams[index], 0.0)
    assert (reader.opened, reader.newest_sequence) == (2, 2)


@given(st.integers(0, 5000), st.integers(1, 300))
def test_fragments_have_equal_size_where_possible(size: int, room: int) -> None:
    writer, reader = ends()
    datagrams = writer.write(bytes(size), 0, 0, OVERHEAD + room)
    sizes = [len(datagram) - OVERHEAD for datagram in datagrams]
    assert len(sizes) == max(1, -(-size // room)) == writer.datagrams(size, OVERHEAD + room)
    assert max(sizes) <= room
    assert len(set(sizes[:-1])) <= 1
    assert min(sizes) == sizes[-1] > 0 or not size
    if len(sizes) < 1000:
        assert [reader.receive(datagram, 0.0) for datagram in datagrams][-1] == (bytes(size), 0, 0)


@given(st.binary(max_size=20).filter(lambda payload: len(payload) != 9))
def test_what_is_no_probe_is_refused_in_words(payload: bytes) -> None:
    with pytest.raises(ProtocolError, match=pattern(Broken.PROBE_INVALID, length=len(payload))):
        Probe.unpack(payload)

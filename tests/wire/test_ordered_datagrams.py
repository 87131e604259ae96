"""Datagrams of reliable topics: sent again, opened once, and their messages in order (PROTOCOL.md, 2)."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_bridge.wire.datagram import DatagramWriter, OrderedReader
from rsb_bridge.wire.framing import Budget, Message
from rsb_bridge.wire.sealing import CipherSuite, DatagramOpener, Sealer

KEY, LINK, ROUTE = bytes(range(32)), b"linklink", 7
OVERHEAD = 38 + 16


def ends(**limits: Any) -> tuple[DatagramWriter, OrderedReader]:
    return (
        DatagramWriter(Sealer(CipherSuite.AESGCM, KEY), LINK, ROUTE),
        OrderedReader(DatagramOpener(CipherSuite.AESGCM, KEY), ROUTE, **limits),
    )


def received(reader: OrderedReader, *datagrams: bytes) -> list[bytes]:
    """Return the messages that come out."""
    out: list[bytes] = []
    for datagram in datagrams:
        if (message := reader.receive(datagram, 0.0)) is not None:
            following, reader.following = reader.following, []
            out += [each[0] for each in (message, *following)]
        assert not reader.following
    return out


@given(data=st.data(), sizes=st.lists(st.integers(0, 60), min_size=1, max_size=12))
def test_messages_come_once_and_in_order_once_all_is_sent_again(data: st.DataObject, sizes: list[int]) -> None:
    budget = Budget(1 << 20)
    writer, reader = ends(budget=budget)
    messages: list[Message] = [(bytes([number]) * size, 0, 0) for number, size in enumerate(sizes)]
    cuts = [writer.cut(message, OVERHEAD + 10) for message in messages]
    first = [datagram for cut in cuts for datagram in writer.write_pieces(cut, 0, len(cut.pieces))]
    again = [datagram for cut in cuts for datagram in writer.write_pieces(cut, 0, len(cut.pieces))]
    passing = data.draw(st.lists(st.sampled_from(first), max_size=30))
    out = received(reader, *passing)
    assert out == [each[0] for each in messages[: len(out)]]
    assert reader.has_gap or reader.newest <= len(out) + 1
    out += received(reader, *data.draw(st.permutations(again)), *first)
    assert out == [each[0] for each in messages]
    assert (reader.expired, reader.pending, reader.has_gap, budget.held) == (0, 0, False, 0)


def test_receipt_tells_what_is_missing() -> None:
    writer, reader = ends()
    datagrams = [writer.write(b"x", 0, 0, 100)[0] for _ in range(2_000)]
    received(reader, datagrams[0], datagrams[3], datagrams[5])
    assert reader.missing == 0b11010
    received(reader, datagrams[1])
    assert reader.missing == 0b01010
    received(reader, datagrams[1_999])
    assert reader.missing == (1 << 1024) - 2  # the window has no room for earlier ones


def test_nothing_expires() -> None:
    writer, reader = ends()
    one, other = writer.write(bytes(20), 0, 0, OVERHEAD + 10)
    assert received(reader, one) == []
    reader.expire(1_000.0)
    assert received(reader, other) == [bytes(20)]


def test_a_message_may_come_in_other_pieces() -> None:
    """The path takes only smaller datagrams than before. Fragments of the old cut may still come, and go nowhere."""
    writer, reader = ends()
    message = bytes(range(40)), 0, 0
    old = writer.write_pieces(writer.cut(message, OVERHEAD + 20), 0, 2)
    cut = writer.cut_again(1, message, OVERHEAD + 10)
    new = writer.write_pieces(cut, 0, 4)
    assert received(reader, old[0], *new[:3], old[1], new[3]) == [message[0]]
    assert received(reader, *writer.write_pieces(cut, 0, 4)) == []


def test_what_has_no_room_is_not_opened() -> None:
    """No receipt covers it, so it is sent again. The next message may exceed the budget."""
    budget = Budget(1_000)
    writer, reader = ends(budget=budget)
    late = writer.write(bytes(300), 0, 0, OVERHEAD + 200)
    later = [writer.write(bytes([number]) * 400, 0, 0, 1_000)[0] for number in range(4)]
    assert received(reader, *later) == []
    assert (reader.opened, reader.missing) == (2, 0b1100)
    assert received(reader, b"too short") == []
    assert received(reader, *late) == [bytes(300), bytes([0]) * 400, bytes([1]) * 400]
    assert budget.held == 0
    assert received(reader, *later) == [bytes([2]) * 400, bytes([3]) * 400]


def test_resumes_with_other_keys() -> None:
    """Incomplete messages are sent again in full, and a message that waits for an earlier one stays."""
    budget = Budget(1 << 20)
    writer, reader = ends(budget=budget)
    messages = [bytes([number]) * 15 for number in range(4)]
    datagrams = [writer.write(each, 0, 0, OVERHEAD + 10) for each in messages]
    assert received(reader, *datagrams[0], datagrams[1][0], *datagrams[2]) == messages[:1]
    other = bytes(reversed(KEY))
    writer.resume(Sealer(CipherSuite.AESGCM, other), b"another!")
    reader.resume(DatagramOpener(CipherSuite.AESGCM, other))
    assert (writer.sequence, reader.opened, reader.newest_sequence, reader.pending) == (0, 0, -1, 0)
    again = [
        writer.write_pieces(writer.cut_again(number, (messages[number - 1], 0, 0), 200), 0, 1) for number in (2, 3)
    ]
    assert received(reader, *again[1], *again[0]) == messages[1:3]
    assert received(reader, *writer.write(messages[3], 0, 0, 200)) == []  # number 5: the fourth is to come again
    assert received(reader, *writer.write_pieces(writer.cut_again(4, (b"4", 0, 0), 200), 0, 1)) == [b"4", messages[3]]
    assert budget.held == 0


@pytest.mark.parametrize("closes", [False, True])
def test_gives_back_what_it_holds(closes: bool) -> None:
    """At its end, or once its meter refuses more."""
    budget = Budget(1 << 20)
    passes = [True, True, False]
    writer, reader = ends(budget=budget, meter=None if closes else lambda _: passes.pop(0))
    datagrams = [writer.write(bytes(15), 0, 0, OVERHEAD + 10) for _ in range(3)]
    assert received(reader, datagrams[1][0], datagrams[1][1]) == []
    assert budget.held
    if closes:
        reader.close()
    else:
        assert received(reader, *datagrams[0], *datagrams[2]) == []
        assert not passes
    assert budget.held == 0

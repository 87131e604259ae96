"""A stream over Zenoh by itself: order, loss, windows and the end, through a network that the test owns."""

from __future__ import annotations

import asyncio
import random
import weakref
from typing import TYPE_CHECKING

import pytest

from rsb_bridge.wire.framing import STRANGER_LIMIT
from rsb_extras.zenoh.outbox import OWN_COST
from rsb_extras.zenoh.pipe import SAMPLE, WINDOW, Pipe, PipeProblem
from rsb_extras.zenoh.sample_header import Header, SampleKind
from rsb_extras.zenoh.tests.zenoh_pipes import Pair, Sent, Side

if TYPE_CHECKING:
    from tests.support.virtual_time import VirtualLoop

pytestmark = pytest.mark.usefixtures("loop")
UNDER_WAY = WINDOW + SAMPLE
"""Bytes at most that a receiver has to hold."""


@pytest.fixture
def pair(loop: VirtualLoop) -> Pair:
    async def made() -> Pair:
        return Pair()

    return loop.run_until_complete(made())


def held(pipe: Pipe) -> int:
    return len(pipe._held)


async def test_what_is_written_arrives_in_order_and_whole() -> None:
    pair, sent = Pair(), random.Random(1)
    written = [sent.randbytes(sent.choice([1, 100, 70_000, SAMPLE + 1])) for _ in range(60)]
    for each in written:
        pair.near.pipe.write(each)
    await pair.settle()
    assert pair.far.told.data == b"".join(written)
    assert pair.near.pipe.get_write_buffer_size() == 0


@pytest.mark.parametrize("size", [1, SAMPLE - 1, SAMPLE, SAMPLE + 1, SAMPLE * 2 + SAMPLE // 2])
async def test_long_write_is_split_into_samples(pair: Pair, size: int) -> None:
    data = random.Random(size).randbytes(size)
    pair.near.pipe.write(memoryview(data))
    pieces = [each.payload for each in pair.near.sent(SampleKind.DATA)]
    assert max(map(len, pieces)) <= SAMPLE
    assert len(pieces) == -(-size // SAMPLE)
    assert b"".join(pieces) == data


async def test_a_buffer_may_be_used_again_at_once(pair: Pair) -> None:
    buffer = bytearray(b"first")
    pair.near.pipe.write(memoryview(buffer))
    buffer[:] = b"other"
    await pair.settle()
    assert pair.far.told.data == b"first"


async def test_bytes_under_way_are_bounded_told_once(pair: Pair) -> None:
    pair.near.pipe.set_write_buffer_limits(high=SAMPLE)
    for _ in range(20):
        pair.near.pipe.write(bytes(SAMPLE // 2))
    under_way = sum(len(each.payload) for each in pair.near.sent(SampleKind.DATA))
    assert WINDOW <= under_way <= UNDER_WAY
    assert pair.near.told.calls == ["made", "pause"]
    await pair.settle()
    assert pair.near.told.calls == ["made", "pause", "resume"]
    assert len(pair.far.told.data) == 10 * SAMPLE


async def test_pausing_receiver_holds_sender_without_loss(pair: Pair) -> None:
    pair.far.pipe.pause_reading()
    data = random.Random(2).randbytes(12 * SAMPLE)
    pair.near.pipe.write(data)
    await pair.settle()
    assert pair.far.told.data == b""
    assert pair.near.pipe.get_write_buffer_size() == len(data) - WINDOW
    pair.far.pipe.resume_reading()
    await asyncio.sleep(0)
    assert 0 < len(pair.far.told.data) < SAMPLE  # a turn of the loop for each piece, and not all at once
    for _ in range(100):
        await pair.settle()
    assert pair.far.told.data == data


async def test_resumed_reading_during_take_keeps_order(pair: Pair) -> None:
    """The reader pauses when it has enough, and resumes from within: it must not be called recursively."""
    inside = False

    def take(data: bytes) -> None:
        nonlocal inside
        assert not inside
        inside = True
        pair.far.told.pieces.append(data)
        pair.far.pipe.pause_reading()
        pair.far.pipe.resume_reading()
        inside = False

    pair.far.told.data_received = take  # type: ignore[method-assign]
    pair.far.pipe.pause_reading()
    data = random.Random(3).randbytes(2 * SAMPLE)
    pair.near.pipe.write(data)
    await pair.settle()
    pair.far.pipe.resume_reading()
    for _ in range(50):
        await pair.settle()
    assert pair.far.told.data == data


async def test_reading_that_is_paused_again_stops_at_once(pair: Pair) -> None:
    pair.far.pipe.pause_reading()
    pair.near.pipe.write(bytes(3 * SAMPLE))
    await pair.settle()
    pair.far.told.pause_after = 1
    pair.far.pipe.resume_reading()
    for _ in range(20):
        await pair.settle()
    assert len(pair.far.told.pieces) == 1


async def test_paused_receiver_holds_what_came_only(pair: Pair) -> None:
    """A sample of nothing, too, would take memory if each were kept."""
    pair.far.pipe.pause_reading()
    for number in range(100_000):
        pair.far.arrive(SampleKind.DATA, number)
    assert held(pair.far.pipe) == 0
    assert not pair.far.pipe.is_closing()


async def test_stream_that_misses_sample_ends_on_both_sides(pair: Pair) -> None:
    for number in range(4):
        pair.near.pipe.write(bytes([number]))
    del pair.near.network.on_its_way[1:3]
    await pair.settle()
    assert pair.far.told.data == b"\0"
    for side in (pair.near, pair.far):
        assert side.told.calls[-1] == "lost"
        assert str(side.told.error) == PipeProblem.SAMPLES_LOST(count=2)
        assert side.network.end is None


async def test_a_sample_that_comes_again_changes_nothing(pair: Pair) -> None:
    for number in range(3):
        pair.far.arrive(SampleKind.DATA, number, bytes([number]))
    for number in (0, 2, 1):
        pair.far.arrive(SampleKind.DATA, number, b"again")
    pair.far.arrive(SampleKind.DATA, 3, b"\3")
    assert pair.far.told.data == b"\0\1\2\3"
    assert not pair.far.pipe.is_closing()


async def test_peer_that_ignores_window_is_cut_off(pair: Pair) -> None:
    pair.far.pipe.pause_reading()
    for number in range(2 * UNDER_WAY // SAMPLE):
        pair.far.arrive(SampleKind.DATA, number, bytes(SAMPLE))
        assert held(pair.far.pipe) <= UNDER_WAY
    await pair.settle()
    assert pair.far.told.calls[-1] == "lost"
    assert str(pair.far.told.error) == PipeProblem.WINDOW_IGNORED(limit=WINDOW)
    assert str(pair.near.told.error) == str(pair.far.told.error)
    assert held(pair.far.pipe) == 0


async def test_window_counts_what_zenoh_was_given(pair: Pair) -> None:
    """Anyone in the network can claim that all has come, while the router takes nothing."""
    network = pair.near.network
    for _ in range(10):
        pair.near.pipe.write(bytes(WINDOW))
        network.backlog = sum(len(each.payload) for each in pair.near.sent(SampleKind.DATA))
        pair.near.arrive(SampleKind.WINDOW, 2**63)
    assert network.backlog <= UNDER_WAY


async def test_an_older_window_closes_nothing(pair: Pair) -> None:
    pair.near.pipe.write(bytes(WINDOW + 2 * SAMPLE))
    pair.near.arrive(SampleKind.WINDOW, 2 * SAMPLE)
    pair.near.arrive(SampleKind.WINDOW, SAMPLE)
    assert pair.near.pipe.get_write_buffer_size() == 0


async def test_unreported_bytes_are_in_flight() -> None:
    """With each sample's own cost, and still where the stream has ended: Zenoh may have it for a while."""
    client = Side("a", "b")
    for _ in range(4):
        client.pipe.write(bytes(1000))
    assert client.network.in_flight == 4 * (1000 + OWN_COST)
    client.arrive(SampleKind.WINDOW, 1000)
    assert client.network.in_flight == 3 * (1000 + OWN_COST)
    client.arrive(SampleKind.WINDOW, 1000)
    client.arrive(SampleKind.WINDOW, 500)
    assert client.network.in_flight == 3 * (1000 + OWN_COST)
    client.arrive(SampleKind.WINDOW, 4000)
    assert client.network.in_flight == 0
    client.pipe.write(bytes(1000))
    client.pipe.abort()
    assert client.network.in_flight == 1000 + OWN_COST
    await asyncio.sleep(10)
    assert client.network.in_flight == 0


async def test_a_window_that_is_lost_is_asked_for(pair: Pair) -> None:
    """Else the stream would stand still for good, with nothing that shows it."""
    data = random.Random(3).randbytes(3 * WINDOW)
    pair.near.pipe.write(data)
    for each in pair.near.network.on_its_way:
        pair.far.pipe.arrived(*each)
    pair.near.network.on_its_way.clear()
    lost = pair.far.sent(SampleKind.WINDOW)
    pair.far.network.on_its_way.clear()
    assert len(lost) > 1
    await pair.settle()
    assert len(pair.far.told.data) < len(data)
    await asyncio.sleep(4.1)
    await pair.settle()
    assert pair.far.told.data == data


async def test_many_questions_have_one_answer(pair: Pair) -> None:
    """A stranger may ask as often as they like."""
    for number in range(100):
        pair.far.arrive(SampleKind.DATA, number, b"")
    await asyncio.sleep(0)
    assert len(pair.far.sent(SampleKind.WINDOW)) == 1
    pair.far.arrive(SampleKind.DATA, 100, b"")
    await asyncio.sleep(0)
    assert len(pair.far.sent(SampleKind.WINDOW)) == 2
    pair.far.arrive(SampleKind.DATA, 101, b"")
    pair.far.pipe.abort()
    await asyncio.sleep(0)
    assert len(pair.far.sent(SampleKind.WINDOW)) == 2


async def test_loss_of_last_sample_shows_though_nothing_follows(pair: Pair) -> None:
    pair.near.pipe.write(b"a map, once")
    pair.near.network.on_its_way.clear()
    await asyncio.sleep(2.1)
    await pair.settle()
    assert [side.told.calls[-1] for side in (pair.near, pair.far)] == ["lost", "lost"]
    assert str(pair.near.told.error) == PipeProblem.SAMPLE_LOST()


async def test_resting_stream_says_its_end_once() -> None:
    pair, said = Pair(), 0
    pair.near.pipe.write(b"one")
    await pair.settle()
    for _ in range(60):
        await asyncio.sleep(1.0)
        said += len(pair.near.network.on_its_way)
        await pair.settle()
    assert said == 1


async def test_waiting_reader_is_asked_now_and_then(pair: Pair) -> None:
    pair.far.pipe.pause_reading()
    pair.near.pipe.write(bytes(3 * WINDOW))
    asked = 0
    for _ in range(60):
        await pair.settle()
        await asyncio.sleep(1.0)
        asked += pair.near.sent(SampleKind.DATA).count(Sent(Header(SampleKind.DATA, 1, 4 + asked), b""))
    assert 20 <= asked <= 30
    pair.near.pipe.abort()
    await pair.settle()
    await asyncio.sleep(10.0)
    assert pair.near.network.on_its_way == []


async def test_closing_sends_what_waits_and_then_ends(pair: Pair) -> None:
    data = random.Random(4).randbytes(7 * SAMPLE)
    pair.near.pipe.write(data)
    pair.near.pipe.close()
    pair.near.pipe.write(b"too late")
    assert pair.near.told.calls[-1] != "lost"
    await pair.settle()
    assert pair.far.told.data == data
    assert pair.far.told.calls == ["made", "eof", "lost"]
    assert pair.near.told.calls[-1] == "lost"
    assert pair.near.told.error is None
    assert pair.far.told.error is None


async def test_aborting_waits_for_nothing(pair: Pair) -> None:
    pair.far.pipe.pause_reading()
    pair.near.pipe.write(bytes(7 * SAMPLE))
    pair.near.pipe.close()
    pair.near.pipe.abort()
    pair.near.pipe.abort()
    await asyncio.sleep(0)
    assert pair.near.told.calls.count("lost") == 1
    assert pair.near.pipe.get_write_buffer_size() == 0
    assert len(pair.near.sent(SampleKind.END)) == 1


async def test_data_before_end_arrives_despite_paused_reading(pair: Pair) -> None:
    pair.far.pipe.pause_reading()
    data = random.Random(5).randbytes(SAMPLE)
    pair.near.pipe.write(data)
    pair.near.pipe.close()
    await pair.settle()
    assert pair.far.told.calls == ["made"]
    pair.far.pipe.resume_reading()
    for _ in range(20):
        await pair.settle()
    assert pair.far.told.data == data
    assert pair.far.told.calls == ["made", "eof", "lost"]


async def test_end_that_counts_more_than_came_says_so(pair: Pair) -> None:
    pair.near.pipe.write(b"lost")
    pair.near.network.on_its_way.clear()
    pair.near.pipe.close()
    await pair.settle()
    assert str(pair.far.told.error) == PipeProblem.SAMPLE_LOST()


async def test_end_with_much_to_send_ends_it(pair: Pair) -> None:
    """Its window will never open again."""
    pair.far.pipe.pause_reading()
    pair.near.pipe.write(bytes(9 * SAMPLE))
    pair.near.pipe.close()
    await pair.settle()
    pair.far.pipe.abort()
    await pair.settle()
    assert pair.near.told.calls[-1] == "lost"
    assert pair.near.network.end is None


async def test_nothing_is_delivered_once_this_side_closes(pair: Pair) -> None:
    pair.near.pipe.write(bytes(WINDOW + SAMPLE))
    pair.near.pipe.close()
    pair.near.arrive(SampleKind.DATA, 0, b"late")
    assert pair.near.told.data == b""
    assert pair.near.told.calls == ["made", "pause"]


async def test_a_reason_from_afar_is_short_and_harmless(pair: Pair) -> None:
    pair.far.arrive(SampleKind.END, 0, b"\x1b[2J\xff" + b"x" * 100_000)
    await pair.settle()
    words = str(pair.far.told.error)
    assert words.isprintable()
    assert len(words) <= 200


async def test_kinds_of_later_versions_are_skipped(pair: Pair) -> None:
    pair.far.arrive(200, 7, b"?")
    await pair.settle()
    assert pair.far.told.calls == ["made"]
    assert pair.far.network.on_its_way == []


async def test_cut_off_tells_both_sides(pair: Pair) -> None:
    pair.near.pipe.cut_off("the router is lost")
    await pair.settle()
    assert str(pair.near.told.error) == "the router is lost"
    assert pair.far.told.calls[-1] == "lost"


@pytest.mark.parametrize("pieces", [[4101], [4000, 101], [1] * 4101], ids=["at once", "in two", "in many"])
@pytest.mark.parametrize("paused", [False, True])
async def test_stranger_has_4_kib_until_it_is_answered(pieces: list[int], paused: bool) -> None:
    side = Side("a" * 16, "b" * 16, stranger=True)
    if paused:
        side.pipe.pause_reading()
    for number, size in enumerate(pieces):
        side.arrive(SampleKind.DATA, number, bytes(size))
    await asyncio.sleep(0)
    assert isinstance(side.told.error, OSError)
    assert sum(map(len, side.told.pieces)) + held(side.pipe) <= STRANGER_LIMIT


async def test_answered_stranger_may_send_behind_proof() -> None:
    side = Side("a" * 16, "b" * 16, stranger=True)
    assert side.pipe.longest == STRANGER_LIMIT
    side.arrive(SampleKind.DATA, 0, bytes(100))
    side.pipe.write(b"answer")
    assert side.pipe.longest >= SAMPLE
    assert not side.pipe.trusted
    side.arrive(SampleKind.DATA, 1, bytes(SAMPLE))
    side.pipe.trust()
    assert side.pipe.trusted
    side.arrive(SampleKind.DATA, 2, bytes(SAMPLE))
    assert len(side.told.data) == 100 + 2 * SAMPLE


@pytest.mark.usefixtures("no_collector")
async def test_ended_pipe_reaches_no_protocol() -> None:
    side = Side("a" * 16, "b" * 16, stranger=True)
    side.arrive(SampleKind.DATA, 0, bytes(100))
    gone = [weakref.ref(each) for each in (side.pipe, side.told)]
    side.pipe.abort()
    del side
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert [each() for each in gone] == [None, None]


# --- strangers

FORGED = [
    (SampleKind.END, 0, b""),
    (SampleKind.END, 2**60, b"gone"),
    (SampleKind.DATA, 0, b"another first"),
    (SampleKind.DATA, 1, b"the next"),
    (SampleKind.DATA, 1, b""),
    (SampleKind.DATA, 2**63, b"far ahead"),
    (SampleKind.WINDOW, 2**63, b""),
]


@pytest.mark.parametrize("tag", [b"", bytes(16)], ids=["untagged", "tagged"])
@pytest.mark.parametrize("forged", FORGED, ids=str)
async def test_forged_sample_changes_nothing_while_stream_lives(
    pair: Pair, forged: tuple[SampleKind, int, bytes], tag: bytes
) -> None:
    pair.near.pipe.write(b"0")
    await pair.settle()
    for number in range(20):
        for side in (pair.near, pair.far):
            side.forge(*forged, tag=tag)
        pair.near.pipe.write(b"1")
        await pair.settle()
        await asyncio.sleep(0.5)
        assert len(pair.far.told.data) == 2 + number
    assert set(pair.near.told.calls + pair.far.told.calls) == {"made"}


async def test_samples_replayed_to_other_side_change_nothing(pair: Pair) -> None:
    pair.near.pipe.write(b"0")
    captured = list(pair.near.network.on_its_way)
    await pair.settle()
    for sample in captured:
        pair.near.pipe.arrived(*sample)
    assert pair.near.told.data == b""


async def test_unproven_end_is_believed_after_silence(pair: Pair) -> None:
    """A peer that was started again knows no key of the stream."""
    pair.near.pipe.write(b"0")
    await pair.settle()
    pair.near.forge(SampleKind.END, 0, b"there is no such stream any more")
    await asyncio.sleep(2.5)
    assert pair.near.told.calls == ["made"]
    await asyncio.sleep(1.0)
    assert pair.near.told.calls == ["made", "lost"]


async def test_resting_stream_outlives_forged_ends() -> None:
    pair, asked = Pair(), 0
    pair.near.pipe.write(b"0")
    await pair.settle()
    for _ in range(1000):
        pair.near.forge(SampleKind.END, 0)
        asked += len(pair.near.sent(SampleKind.DATA))
        await pair.settle()
        await asyncio.sleep(0.01)
    assert pair.near.told.calls == ["made"]
    assert asked <= 10  # within 10 s


async def test_vanished_token_ends_stream_of_departed_owner(pair: Pair) -> None:
    pair.near.pipe.write(b"0")
    await pair.settle()
    pair.near.pipe.doubt("it has left")
    for _ in range(8):
        await asyncio.sleep(0.5)
        await pair.settle()
    assert pair.near.told.calls == ["made"]
    pair.near.pipe.doubt("it has left")
    await asyncio.sleep(4.0)
    assert pair.near.told.calls == ["made", "lost"]
    assert str(pair.near.told.error) == "it has left"


@pytest.mark.parametrize("how", ["end", "token"])
async def test_a_doubt_is_known_at_once(how: str) -> None:
    """Whether the other end has gone takes seconds to find out; what it has armed does not stay armed so long."""
    pair, doubts = Pair(), list[str]()
    pair.near.pipe.when_doubted = lambda: doubts.append(how)
    pair.near.pipe.write(b"0")
    await pair.settle()
    assert not doubts
    if how == "end":
        pair.near.forge(SampleKind.END, 0)
    else:
        pair.near.pipe.doubt("it has left")
    assert doubts == [how]
    await pair.settle()
    assert pair.near.told.calls == ["made"]


async def test_bytes_under_way_do_not_hide_death(pair: Pair) -> None:
    pair.near.pipe.write(b"0")
    await pair.settle()
    pair.far.pipe.write(b"last words")
    pair.near.pipe.doubt("it has left")
    await asyncio.sleep(0.2)
    pair.carry()
    pair.near.network.on_its_way.clear()
    pair.far.network.on_its_way.clear()
    await asyncio.sleep(7.0)
    assert pair.near.told.calls == ["made", "lost"]


@pytest.mark.parametrize("kind", [SampleKind.END, SampleKind.WINDOW])
async def test_client_takes_further_answers_until_one_is_adopted(kind: SampleKind) -> None:
    pair = Pair(authenticated=False)
    near = pair.near
    near.pipe.begin_trial()
    near.pipe.write(b"first")
    near.forge(kind, 2**60)
    near.forge(SampleKind.DATA, 0, b"forged")
    near.forge(SampleKind.DATA, 7, b"forged too")
    near.told.pieces.clear()

    def take(data: bytes) -> None:
        near.pipe.adopt()

    deliver = near.told.data_received
    near.told.data_received = take  # type: ignore[method-assign]
    near.arrive(SampleKind.DATA, 0, b"answer")
    near.told.data_received = deliver  # type: ignore[method-assign]
    near.authenticate(opener=True)
    pair.far.authenticate(opener=False)
    near.arrive(SampleKind.DATA, 0, b"again")
    near.arrive(SampleKind.DATA, 1, b"second")
    assert near.told.data == b"second"
    assert near.told.calls == ["made"]


async def test_answers_of_strangers_are_bounded() -> None:
    pair = Pair(authenticated=False)
    pair.near.pipe.begin_trial()
    for _ in range(10_000):
        pair.near.forge(SampleKind.DATA, 0, b"forged")
    assert len(pair.near.told.pieces) <= 64


async def test_without_tags_end_is_believed_once_nothing_comes() -> None:
    """A link without encryption has none."""
    pair = Pair(authenticated=False)
    pair.near.pipe.write(b"0")
    await pair.settle()
    for _ in range(10):
        pair.far.forge(SampleKind.END, 1)
        pair.near.pipe.write(b"1")
        await pair.settle()
        await asyncio.sleep(1.0)
    assert pair.far.told.calls == ["made"]
    pair.near.pipe.close()
    await pair.settle()
    await asyncio.sleep(4.0)
    assert pair.far.told.calls == ["made", "eof", "lost"]

"""Messages of two recordings are found to be the same, or missing, whatever their contents and times are."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest

from rsb_extras.courier.completed_recording import ClockSource, CompletedName
from rsb_extras.courier.courier_records import LATEST, MOST_SPANS, Wanted
from rsb_extras.courier.message_index import AbsentMessages, MessageIndex
from rsb_extras.courier.picking import head_of, picked
from rsb_extras.courier.pieces import PieceError
from rsb_extras.courier.tests.bags import BEGAN, SECOND, channel, write_bag
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.stored_message import StoredMessage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    Compared = Callable[..., MessageIndex]

MS = 1_000_000
HEADS = Wanted("0" * 16, "0" * 16, ("/scan",), heads=True)


def _room() -> None:
    pass


@pytest.fixture
def compared(tmp_path: Path) -> Iterator[Compared]:
    made: list[MessageIndex] = []

    def compare(
        there: Iterable[StoredMessage], live: Iterable[StoredMessage], ahead: float | None = None, *, comes: bool = True
    ) -> MessageIndex:
        topics = sorted({each.channel.topic for each in (*there, *live)})
        index = MessageIndex(tmp_path / f"{len(made)}.db", [CompletedName(each, each, comes) for each in topics], _room)
        made.append(index)
        index.add_there(map(head_of, there))
        index.add_live(enumerate(live, 1))
        index.compare(ahead)
        return index

    yield compare
    for each in made:
        each.close()


def at(ms: float, content: bytes = b"same", topic: str = "/scan", number: int = 0) -> StoredMessage:
    time = BEGAN + int(ms * MS)
    return StoredMessage(channel(topic), time, time, number, memoryview(b"\0\1\0\0" + content))


def every(period: float, count: int, content: bytes | None = None) -> list[StoredMessage]:
    return [at(n * period, b"%d" % n if content is None else content, number=n + 1) for n in range(count)]


def figures(index: MessageIndex) -> tuple[int, int, int]:
    """Return how many are in both, only live, and missing here."""
    (found,) = index.figures(0, LATEST)
    return found.live - found.only_live, found.only_live, 0 if found.absent is None else found.absent.messages


def test_equal_messages_are_the_same_in_order(compared: Compared) -> None:
    """Of the same content all the time, of which the way lost some, and another gave the offset."""
    there = every(100, 100, b"empty")
    live = [each._replace(time=each.time + 7 * MS) for n, each in enumerate(there) if n % 3]
    marks = [at(n * 1000 + 50, b"mark %d" % n, "/scan") for n in range(10)]
    there, late = (
        sorted([*there, *marks], key=lambda each: each.time),
        [each._replace(time=each.time + 7 * MS) for each in marks],
    )
    index = compared(there, sorted([*live, *late], key=lambda each: each.time))
    assert index.clock.offset == 7 * MS
    assert figures(index) == (76, 0, 34)


@pytest.mark.parametrize("early", [0, 3])
def test_what_the_other_side_began_to_record_later_came_live_only(compared: Compared, early: int) -> None:
    """Though all is equal: by their times, which the offset of the fastest tenth does not tell exactly."""
    whole, marks = every(100, 200, b"empty"), [at(n * 1000 + 51, b"mark %d" % n) for n in range(10, 20)]
    live = [
        each._replace(time=each.time + (9 + n % 4 - (early if n == 150 else 0)) * MS) for n, each in enumerate(whole)
    ]
    live += [each._replace(time=each.time + 9 * MS) for each in marks]
    index = compared(
        sorted([*whole[100:], *marks], key=lambda each: each.time), sorted(live, key=lambda each: each.time)
    )
    assert figures(index) == (110, 100, 0)


def test_equal_messages_that_come_at_once_are_each_one(compared: Compared) -> None:
    """As of an outbox behind an outage, with those that are sent right behind it: taken together, all have come."""
    there = [at(n, b"x") for n in (0, 1, 2, *range(900, 960), *range(2600, 2620))] + [at(9000, b"mark")]
    live = [at(n, b"x") for n in (3, 4, 5, *range(2560, 2600, 2), *range(2605, 2725, 2))] + [at(9000, b"mark")]
    assert figures(compared(there, live)) == (84, 0, 0)


def test_the_offset_is_that_of_messages_that_were_not_late(compared: Compared) -> None:
    """Of 100, 85 waited for the end of an outage; one that the robot lost looks 20 s early."""
    there = every(100, 100)
    live = [each._replace(time=max(each.time, BEGAN + 8500 * MS) + 4 * MS) for each in there]
    live.append(at(0, b"once")._replace(time=BEGAN))
    index = compared(sorted([*there, at(20_000, b"once")], key=lambda each: each.time), live)
    assert (index.clock.source, index.clock.offset, index.clock.matched) == (ClockSource.MESSAGES, 4 * MS, 101)
    assert figures(index) == (100, 1, 1)


def test_what_goes_there_is_there_later(compared: Compared) -> None:
    live = every(100, 50)
    there = [each._replace(time=each.time + 6 * MS) for each in live if each.number % 2]
    index = compared(there, live, 0.0, comes=False)
    assert index.clock.source is ClockSource.LINK
    assert figures(index) == (25, 25, 0)


def test_without_any_measurement_times_stay(compared: Compared) -> None:
    index = compared(every(100, 3), [at(0, b"other")])
    assert (index.clock.source, index.clock.offset, index.here(BEGAN)) == (ClockSource.NONE, 0, BEGAN)
    assert figures(index) == (0, 1, 3)


def test_messages_of_one_time_are_each_one(compared: Compared) -> None:
    """A batch has one time; the same message in two recordings of this side is one."""
    there = [at(n, b"x") for n in (0, 1, 2)]
    live = [at(5, b"x")] * 3
    index = compared(there, live, 0.0)
    index.add_live(enumerate(live, 4))
    assert figures(index) == (3, 0, 0)


def test_gaps_in_numbers_are_lost_ones(compared: Compared) -> None:
    """Of two publishers, whom the recording does not tell apart, one of which begins anew."""
    first = [at(n * 10, b"a%d" % n, number=1000 + n) for n in range(100) if not 20 <= n < 25]
    second = [at(n * 10 + 5, b"b%d" % n, number=n + 1) for n in range(100) if n != 50]
    index = compared(sorted([*first, *second], key=lambda each: each.time), [at(510, b"b50")])
    assert index.lost(0) == (5, [AbsentMessages(5, BEGAN + 190 * MS, BEGAN + 250 * MS)])


def test_missing_messages_are_ordered_by_spans(compared: Compared, tmp_path: Path) -> None:
    """Also where there are more than one order has, and of several topics at once."""
    there = [at(n * 10, b"%d" % n, f"/topic{n % 3}", number=n // 3 + 1) for n in range(6 * MOST_SPANS)]
    there.append(there[-1]._replace(time=there[-1].time + 3600 * SECOND, content=memoryview(b"\0\1\0\0last")))
    live = [each for n, each in enumerate(there[:-1]) if not (n % 2 or 2000 < n < 2500)]
    index = compared(there, live)
    write_bag(tmp_path / "drive.mcap", there)
    recording, got = OpenRecording(tmp_path / "drive.mcap"), []
    for number in range(index.orders):
        wanted = index.order(number, HEADS)
        assert len(wanted.spans) <= MOST_SPANS
        found = [*picked(recording, wanted, wanted.topics, 0)]
        middle = found[len(found) // 2].time
        assert [*picked(recording, wanted, wanted.topics, middle)] == [each for each in found if each.time >= middle]
        got += found
    assert index.orders > 1
    had = {each.time for each in live}
    assert sorted(each.time for each in got) == [each.time for each in there if each.time not in had]


def test_what_is_no_head_is_refused(tmp_path: Path) -> None:
    index = MessageIndex(tmp_path / "one.db", [CompletedName("/scan", "/scan")], _room)
    with pytest.raises(PieceError):
        index.add_there([at(0)])
    index.close()


def test_equal_messages_of_one_time_take_no_longer(compared: Compared) -> None:
    """As a robot may say that it has 20 million of them: each was looked for behind all before it."""
    same = at(0)
    index = compared([same] * 20_000, [])
    began = time.monotonic()
    index.begin_fetched()
    places = [index.fetched_place(same) for _ in range(20_001)]
    assert time.monotonic() - began < 20
    assert [place is not None and place.id for place in places] == [*range(1, 20_001), False]


def test_a_topic_of_there_does_not_take_what_another_one_has_here(tmp_path: Path) -> None:
    """The robot's /scan is /robot/scan here, and it has a topic of that name, too, which no link carries."""
    names = [CompletedName("/scan", "/robot/scan"), CompletedName("/robot/scan", "/robot/scan")]
    index = MessageIndex(tmp_path / "one.db", names, _room)
    index.add_there([head_of(at(0, b"one", "/scan")), head_of(at(1, b"two", "/robot/scan"))])
    index.add_live([(1, at(5, b"one", "/robot/scan"))])
    index.compare(None)
    assert [(each.live, each.only_live) for each in index.figures(0, LATEST)] == [(1, 0), (0, 0)]
    index.close()


def test_figures_of_a_clock_that_was_set_have_bounds(compared: Compared) -> None:
    """A console refuses more than 2^53."""
    live = every(100, 100)
    index = compared([each._replace(time=n if n % 9 else each.time) for n, each in enumerate(live)], live)
    assert 0 < index.clock.spread <= 2**53

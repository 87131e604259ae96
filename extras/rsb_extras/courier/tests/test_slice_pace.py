"""How much a fetch has in transit, alone and beside topics; the second on virtual time."""

from __future__ import annotations

from collections import deque
from random import Random
from typing import TYPE_CHECKING

import pytest

from rsb_extras.courier.slices import Pace
from rsb_extras.courier.tests.bags import messages, write_bag
from rsb_extras.courier.tests.fetch_cost import LINES, topic_beside

if TYPE_CHECKING:
    from pathlib import Path


def cross(pace: Pace, *took: float) -> int:
    """Have slices cross one after the other, each in so many s; return the size of the next one."""
    for number, seconds in enumerate(took, 1):
        pace.sent(0.0)
        pace.heard(number, seconds)
    return pace.size


def under_way(pace: Pace) -> int:
    """Return how many slices are under way once no more may be."""
    count = 0
    while pace.is_open:
        pace.sent(0.0)
        count += 1
    return count


def test_slices_beside_topics_are_fewer_and_smaller() -> None:
    alone, beside = Pace(), Pace()
    beside.has_others = True
    took = (0.1, 0.145, 0.145)
    assert cross(alone, *took) > cross(Pace(), 0.1) > cross(beside, *took)
    assert (under_way(alone), under_way(beside)) == (2, 1)


def test_large_slices_beside_topics_are_two() -> None:
    """Else a long line would be empty while an answer comes back."""
    pace = Pace()
    pace.has_others = True
    cross(pace, *[0.1] * 5)
    assert under_way(pace) == 2


def test_topic_beside_a_fetch_hardly_waits(bags: Path) -> None:
    """20 Hz of 1,000 B behind 1 Mbit/s, whose p99 is 20 ms alone, and was 140 ms with two slices under way."""
    write_bag(bags / "drive.mcap", messages(120, 5000))
    beside = topic_beside(1, 1_000, bags, fetches=True)
    assert beside.p99 < 0.06
    assert beside.fetched > 80_000


def test_topic_beside_a_fetch_on_the_tunnel(bags: Path) -> None:
    """20 Hz of 60 B, whose p99 is 65 ms alone, and was 1 s behind slices of 2 KiB; a fetch had 2.4 kB/s."""
    write_bag(bags / "drive.mcap", messages(40, 5000))
    beside = topic_beside(1, 60, bags, fetches=True, line=LINES["tunnel"])
    assert beside.p99 < 0.215
    assert beside.fetched > 1_900


def crossing(seconds: float, there: float, jitter: float, *rates: float, calm: int = 99) -> list[int]:
    """Return the sizes of slices beside topics on a line that is `there` to `there` + `jitter` s long.

    Args:
        rates: bytes/s, for so many seconds each.
        calm: rates before the jitter ends.
    """
    pace = Pace()
    random, come, sizes = Random(1), deque[float](), list[int]()
    pace.has_others = True
    now = line = last = 0.0
    while now < seconds * len(rates):
        while pace.is_open:
            line = max(line, now) + pace.size / rates[int(now / seconds)]
            last = max(line + there + random.uniform(0.0, jitter if now / seconds < calm else 0.01), last)
            sizes.append(pace.size)
            pace.sent(now)
            come.append(last)
        now = come.popleft()
        pace.heard(len(sizes) - len(come), now)
    return sizes


def test_long_line_has_no_tiny_slices() -> None:
    """They come as late there, and would carry a sixteenth."""
    sizes = crossing(300.0, 0.6, 0.3, 2.5e6)
    assert min(sizes) < 200, "they are tried"
    assert min(sizes[-100:]) >= 2 << 10


def test_line_that_was_thin_has_large_slices() -> None:
    assert max(crossing(600.0, 0.01, 0.0, 5_000.0)[-50:]) < 500
    assert crossing(600.0, 0.01, 0.0, 5_000.0, 2.5e6)[-1] > 50_000


def test_jitter_is_no_full_line() -> None:
    """Behind 20 Mbit/s, 50 ms and up to 0.1 s of jitter, a fetch beside topics does not stay at the smallest slices."""
    assert sum(crossing(60.0, 0.05, 0.1, 2.5e6)) / 60.0 > 200_000  # B/s


@pytest.mark.parametrize("jitter", [0.2, 0.5])
def test_fetch_outruns_jitter_of_a_radio(jitter: float) -> None:
    """A fetch had 15 kB/s behind 20 Mbit/s, 50 ms and up to 0.2 s of jitter: each slice looked late."""
    sizes = crossing(300.0, 0.05, jitter, 2.5e6)
    assert sum(sizes) / 300.0 > 150_000  # B/s


def test_line_that_gets_thin_under_jitter() -> None:
    """Slices get small within seconds, although those of a radio with jitter are judged together."""
    sizes = crossing(120.0, 0.05, 0.2, 2.5e6, 125e3)
    assert sum(1 for size in sizes if size > 30_000) > 20, "they were large"
    assert max(sizes[-20:]) < 16 << 10


def test_line_that_gets_steady_and_then_thin() -> None:
    """The size of before the jitter ended was kept for later, so that slices below 2 KiB were never tried again."""
    sizes = crossing(140.0, 0.05, 0.2, 2.5e6, 2.5e6, *[5_000.0] * 4, calm=1)
    assert max(sizes[-100:]) < 1 << 10


def test_topic_beside_a_fetch_on_a_line_with_jitter(bags: Path) -> None:
    """20 Hz of 1,000 B behind 20 Mbit/s and 20 to 220 ms each way, whose p99 is 220 ms alone; a fetch had 7.6 kB/s."""
    write_bag(bags / "drive.mcap", messages(120, 500_000))
    beside = topic_beside(1, 1_000, bags, fetches=True, line=LINES["jitter"])
    assert beside.p99 < 0.3
    assert beside.fetched > 100_000

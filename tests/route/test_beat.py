"""Topics of one beat: messages of one stamp pass or fall together, at the rate of the limit."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import pytest

from rsb_bridge.ros.ros_interface import RawMessage
from rsb_bridge.route.beat import Beat, TopicInBeat
from rsb_bridge.route.rate_limit import Throttle

if TYPE_CHECKING:
    from collections.abc import Iterable

RATE, PUBLISHED_AT = 10.0, 30.0  # Hz
SECONDS = 17
PERIOD = int(1e9 / PUBLISHED_AT)
START = 1_000_000 * PERIOD


class Bench:
    """Topics of one beat, and the stamps that pass of each."""

    def __init__(self, *topics: str) -> None:
        beat = Beat()
        self._topics = {topic: TopicInBeat(beat, Throttle(RATE)) for topic in topics}
        self.passed: dict[str, list[int]] = {topic: [] for topic in topics}

    def come(self, topic: str, stamp: int, at: int) -> None:
        payload = b"\x00\x01\x00\x00" + stamp.to_bytes(8, "little") + b"content"
        if self._topics[topic].passes(RawMessage(payload, at)):
            self.passed[topic].append(stamp)


def stamps(seconds: float = SECONDS) -> Iterable[int]:
    return (START + number * PERIOD for number in range(int(seconds * PUBLISHED_AT)))


@pytest.mark.parametrize(("info_first", "begins"), product([False, True], [0.0, 2.3]))
def test_pairs_cross_whole_though_one_begins_later(info_first: bool, begins: float) -> None:
    bench = Bench("image", "info")
    for stamp in stamps():
        info_at, image_at = (stamp, stamp + 3_000_000) if info_first else (stamp + 3_000_000, stamp)
        comes = [(image_at, "image")]
        if stamp >= START + begins * 1e9:
            comes.append((info_at, "info"))
        for at, topic in sorted(comes):
            bench.come(topic, stamp, at)
    since = [each for each in bench.passed["image"] if each >= START + begins * 1e9]
    assert since == bench.passed["info"]
    assert len(bench.passed["image"]) == pytest.approx(RATE * SECONDS, abs=2)


def test_order_that_changes_parts_no_pair() -> None:
    bench = Bench("image", "info")
    for number, stamp in enumerate(stamps()):
        for topic in ("image", "info")[:: 1 if number % 3 else -1]:
            bench.come(topic, stamp, stamp + number % 7 * 1_000_000)
    assert bench.passed["image"] == bench.passed["info"]
    assert len(bench.passed["image"]) == pytest.approx(RATE * SECONDS, abs=2)


def test_lost_message_costs_its_own_pair_only() -> None:
    bench = Bench("image", "info")
    for number, stamp in enumerate(stamps()):
        if number % 10:
            bench.come("image", stamp, stamp)
        bench.come("info", stamp, stamp + 1_000_000)
    image, info = (set(bench.passed[each]) for each in ("image", "info"))
    assert image <= info
    lost = {stamp for number, stamp in enumerate(stamps()) if not number % 10}
    assert info - image <= lost


@pytest.mark.parametrize("stamp", [0, 7], ids=["unset", "always the same"])
def test_stamp_that_tells_nothing_keeps_rate(stamp: int) -> None:
    bench = Bench("image", "info")
    for at in stamps():
        for topic in ("image", "info"):
            bench.come(topic, stamp, at)
    for topic in ("image", "info"):
        assert len(bench.passed[topic]) == pytest.approx(RATE * SECONDS, abs=2)


def test_topics_of_other_stamps_keep_their_own_rate() -> None:
    """Two cameras that are not in step: neither waits for the other."""
    bench = Bench("left", "right")
    for stamp in stamps():
        bench.come("left", stamp, stamp)
        bench.come("right", stamp + PERIOD // 2, stamp + PERIOD // 2)
    for topic in ("left", "right"):
        assert len(bench.passed[topic]) == pytest.approx(RATE * SECONDS, abs=2)


def test_recording_that_is_played_again_and_faster_keeps_rate() -> None:
    """The stamps come again and ten times as fast; what crosses is bounded by the time in which they come."""
    bench = Bench("image", "info")
    at = START
    for _ in range(3):
        for stamp in stamps():
            at += PERIOD // 10
            for topic in ("image", "info"):
                bench.come(topic, stamp, at)
    seconds = (at - START) / 1e9
    for topic in ("image", "info"):
        assert len(bench.passed[topic]) <= RATE * seconds + 2

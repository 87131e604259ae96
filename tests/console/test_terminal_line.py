"""How fast the operator's line is, and how late its terminal: in simulated time, over a line of a known rate."""

from __future__ import annotations

import heapq
import itertools

import pytest

from rsb_console.terminal.terminal_line import FRAME, TerminalLine

STEP = 0.01


class Way:
    """A line of a rate and a round trip, with a terminal that answers questions or does not.

    Args:
        rate: bytes/s.
        trip: s.
        buffer: bytes that the kernel takes before a write waits, or None for a network, whose buffers take all.
        saved: s of the line that it makes up for after a rest.
    """

    def __init__(
        self, rate: float, trip: float = 0.0, *, answers: bool = True, buffer: int | None = None, saved: float = 0.0
    ) -> None:
        self.now, self.rate, self.trip, self.answers, self.buffer = 100.0, rate, trip, answers, buffer
        self.saved = saved
        self.line = TerminalLine(lambda: self.now)
        self.carries_until = self.now
        self._answers: list[tuple[float, int, float]] = []
        self._order = itertools.count()

    @property
    def under_way(self) -> float:
        """Bytes."""
        return max(0.0, self.carries_until - self.now) * self.rate

    @property
    def late(self) -> float:
        """Seconds by which the terminal is late in truth."""
        return max(0.0, self.carries_until - self.now)

    def write(self, size: int) -> None:
        self.line.wrote(size)
        self.carries_until = max(self.now - self.saved, self.carries_until) + size / self.rate
        if self.buffer is not None and (waits := (self.under_way - self.buffer) / self.rate) > 0.02:
            self.now += waits
            self.line.waited(size, waits)
        if self.line.is_to_be_asked:
            self.line.asked(self.now)
            if self.answers:
                arrives = max(self.now, self.carries_until) + self.trip
                heapq.heappush(self._answers, (arrives, next(self._order), self.now))

    def change_to(self, rate: float) -> None:
        """Carry what is under way and all after it at another rate."""
        times = self.rate / rate

        def later(at: float) -> float:
            return self.now + max(0.0, at - self.now) * times

        self.carries_until, self.rate = later(self.carries_until), rate
        self._answers = [(later(at - self.trip) + self.trip, *rest) for at, *rest in self._answers]  # type: ignore[misc]

    def go_on(self, seconds: float) -> None:
        until = self.now + seconds
        while self.now < until:
            self.now += STEP
            while self._answers and self._answers[0][0] <= self.now:
                self.line.answered(heapq.heappop(self._answers)[2])

    def play(self, seconds: float, wanted: float) -> tuple[float, float]:
        """Write what a screen with some bytes/s has; return the bytes/s that were, and by how many s it was late."""
        began, owed, written, latest = self.now, 0.0, 0, 0.0
        while self.now < began + seconds:
            self.go_on(STEP)
            owed = min(owed + wanted * STEP, 10_000.0)  # only the newest picture waits
            if owed >= 1 and self.line.is_free:
                size = int(min(owed, self.line.most))
                self.write(size)
                owed, written = owed - size, written + size
            latest = max(latest, self.late)
        return written / (self.now - began), latest


@pytest.mark.parametrize("trip", [0.0, 0.06, 0.7])
@pytest.mark.parametrize("rate", [960, 1_920, 11_520, 1_000_000])
def test_rate_is_learned_from_answers(rate: int, trip: float) -> None:
    way = Way(rate, trip)
    way.play(20.0, 2.0 * rate)
    carried, latest = way.play(20.0, 2.0 * rate)
    assert carried > 0.6 * rate
    assert latest < 2.5 * FRAME


@pytest.mark.parametrize("rate", [960, 1_920, 11_520])
def test_little_that_passes_at_once_proves_no_fast_line(rate: int) -> None:
    """As behind a queue or on a radio link: after a rest, what waits is sent at once."""
    way = Way(rate, saved=0.1)
    way.play(10.0, 2.0 * rate)
    for _ in range(100):
        way.write(int(0.09 * rate))
        way.go_on(0.25)
    way.go_on(1.0)
    _, latest = way.play(3.0, 10.0 * rate)
    assert latest < 2.5 * FRAME


def test_answers_that_wait_together_prove_no_fast_line() -> None:
    """As while this process gets no processor."""
    way = Way(1_920)
    way.play(10.0, 4_000)
    for _ in range(5):
        way.go_on(1.0)
        for _ in range(2):
            way.write(290)
            way.now += 0.3
        way.go_on(STEP)
    assert way.line.rate < 1.2 * 1_920


@pytest.mark.parametrize("trip", [0.0, 0.06, 0.3])
def test_line_that_became_slower_at_rest_is_noticed_by_the_first_frame(trip: float) -> None:
    way = Way(150_000, trip)
    way.play(10.0, 300_000)
    way.rate = 1_920
    for _ in range(40):
        way.write(80)
        way.go_on(0.25)
    _, latest = way.play(3.0, 300_000)
    assert latest < 2.5 * FRAME


def test_line_is_free_after_an_image_that_no_question_follows() -> None:
    """Frames alone are followed by one, and none comes while the line is not free."""
    way = Way(150_000)
    way.play(10.0, 300_000)
    way.go_on(10.0)
    way.line.wrote(20_000)
    way.go_on(1.0)
    assert way.line.is_free


@pytest.mark.parametrize("rate", [960, 1_920])
def test_rate_is_learned_where_nothing_answers(rate: int) -> None:
    """Only when the kernel's buffer is full, which then empties first."""
    way = Way(rate, answers=False, buffer=4096)
    way.play(40.0, 2.0 * rate)
    assert 0.5 * rate < way.line.rate < 1.5 * rate
    carried, _ = way.play(20.0, 2.0 * rate)
    assert carried > 0.6 * rate


def test_questions_without_answers_take_no_memory() -> None:
    way = Way(1_000_000, answers=False)
    for _ in range(1000):
        way.write(1_000)
        way.go_on(2.0)
    assert len(way.line._asked) < 20


def test_fast_line_that_gives_no_answers_is_used() -> None:
    way = Way(1_000_000, answers=False, buffer=4096)
    way.play(60.0, 100_000)
    carried, _ = way.play(10.0, 100_000)
    assert carried > 50_000


@pytest.mark.parametrize("trip", [0.0, 0.5])
def test_line_that_hangs_is_late_and_gets_little(trip: float) -> None:
    way = Way(100_000, trip)
    way.play(10.0, 2_000)
    assert way.line.late < 0.1
    way.carries_until = way.now + 10.0
    carried, _ = way.play(9.0, 50_000)
    assert way.line.late > 5.0
    assert carried < 10_000
    way.play(5.0, 2_000)
    assert way.line.late < 0.1


def test_line_that_becomes_faster_is_used() -> None:
    way = Way(1_920, 0.05)
    way.play(20.0, 4_000)
    way.rate = 100_000
    way.play(5.0, 200_000)
    carried, _ = way.play(10.0, 200_000)
    assert carried > 60_000


@pytest.mark.parametrize("trip", [0.0, 0.06, 0.3])
def test_line_that_becomes_much_slower_is_late_until_it_is_empty(trip: float) -> None:
    way = Way(150_000, trip)
    way.play(10.0, 300_000)
    way.change_to(1_920)
    way.play(1.0, 300_000)
    way.play(way.late + 3.0, 300_000)
    assert way.late < 2.0 * FRAME
    carried, latest = way.play(10.0, 300_000)
    assert latest < 2.5 * FRAME
    assert carried > 0.6 * way.rate


def test_terminal_that_answers_no_longer_is_one_without_answers() -> None:
    """As where dtach is attached from another one."""
    way = Way(10_000)
    way.play(5.0, 5_000)
    way.answers = False
    way.play(40.0, 5_000)
    assert not way.line.answers
    assert way.line.late < 1.0
    carried, _ = way.play(10.0, 5_000)
    assert carried > 4_000


@pytest.mark.parametrize("trip", [0.0, 0.06, 0.3])
def test_answer_after_it_is_given_up_tells_rate_and_no_round_trip(trip: float) -> None:
    """As where dtach is attached from a slow line, whose first screen takes longer than an answer is waited for."""
    way = Way(80_000, trip)
    way.play(10.0, 160_000)
    way.go_on(1.0)
    way.change_to(1_920)
    way.write(12_000)
    way.go_on(5.0)
    way.line.expect_no_answers()
    way.go_on(2.0)
    assert way.line.rate == pytest.approx(way.rate, rel=0.1)
    _, latest = way.play(10.0, 4_000)
    assert latest < 2.5 * FRAME


def test_what_a_terminal_never_answered_proves_no_fast_line() -> None:
    way = Way(1_920)
    way.play(10.0, 4_000)
    way.answers = False
    for _ in range(10):
        way.write(290)
        way.go_on(0.2)
    way.line.expect_no_answers()
    way.answers = True
    _, latest = way.play(10.0, 4_000)
    assert latest < 2.5 * FRAME


def test_bytes_a_second_are_those_of_some_seconds() -> None:
    way = Way(10_000)
    way.play(20.0, 1_000)
    assert way.line.per_second == pytest.approx(1_000, rel=0.2)

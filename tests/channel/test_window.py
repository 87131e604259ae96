"""The window of a stream channel, on a simulated path with unlimited buffers."""

from __future__ import annotations

from collections import deque

import pytest
from tests.channel.window_helpers import QUEUES_MUCH
from tests.support.held import held_by

from rsb_bridge.channel.window import FIRST, FIRST_RECEIPT, LEAST, ReceiptCounter, Window
from rsb_bridge.model.transport_traits import QUEUES_LITTLE, Ages

STEP = 0.001
AGES = [pytest.param(QUEUES_LITTLE, id="tcp"), pytest.param(QUEUES_MUCH, id="much queues")]


class Path:
    """A path with endless buffers, in steps of time; the queue in front of the window keeps the newest messages.

    Attributes:
        time: s.
        speed: bytes/s that it carries, or 0 to stall.
        delay: s, each way.
        behind: s that receipts wait behind data that goes the other way.
        credit: part of the receipts' way back that the sender is certain of.
        ages: s, of the messages when they arrived, on their way only.
        arrived: bytes.
        receipts: how many were sent.
    """

    def __init__(self, speed: float, delay: float = 0.0005, ages: Ages = QUEUES_LITTLE) -> None:
        self.time = 0.0
        self.speed, self.delay = speed, delay
        self.behind = 0.0
        self.credit = 1.0
        self.ages: list[float] = []
        self.arrived = self.sent = self.receipts = 0
        self.window = Window(ages)
        self.counter = ReceiptCounter()
        self._asked = FIRST_RECEIPT
        self._looked = 0.0
        self._on_the_way: deque[list[float]] = deque()  # when it may arrive, bytes that are left, when written
        self._back: deque[tuple[float, int]] = deque()
        self._credit = self._offered = 0.0
        self.most_under_way = 0

    @property
    def _way_back(self) -> float:
        return self.credit * (self.delay + self.behind)

    @property
    def under_way(self) -> int:
        return self.sent - self.arrived

    def carries(self, seconds: float, rate: float, size: int) -> float:
        """Run, and return the bytes/s that arrive; `ages` are of that time only."""
        self.ages.clear()
        before = self.arrived
        self.run(seconds, rate, size)
        return (self.arrived - before) / seconds

    def run(self, seconds: float, rate: float, size: int) -> int:
        """Offer messages of `size` bytes, `rate` a second; what the window does not take is dropped.

        Returns:
            The bytes that it took.
        """
        until, before = self.time + seconds, self.sent
        while self.time < until:
            self.time += STEP
            self._offered += rate * STEP
            while self._offered >= 1:
                self._offered -= 1
                if self.sent < self.window.limit:
                    self._send(size)
            self._carry()
            if self.time - self._looked >= 1.0:
                self._looked = self.time
                if self.counter.has_news:
                    self._give()
                self.window.check(self.sent, self.time, self._way_back)
            self.most_under_way = max(self.most_under_way, self.under_way)
        return self.sent - before

    def _send(self, size: int) -> None:
        self.window.wrote(self.sent, self.time)
        self.sent += size
        self._on_the_way.append([self.time + self.delay, size, self.time])

    def _carry(self) -> None:
        self._credit = min(self._credit, 1.0) + self.speed * STEP if self._on_the_way else 0.0
        while self._on_the_way and self._on_the_way[0][0] <= self.time and self._credit >= 1:
            first = self._on_the_way[0]
            piece = int(min(first[1], self._credit))
            first[1] -= piece
            self._credit -= piece
            self.arrived += piece
            self.counter.count += piece
            if self.counter.count >= self.counter.due:
                self._give()
            if not first[1]:
                self.ages.append(self.time - first[2])
                self._on_the_way.popleft()
        while self._back and self._back[0][0] <= self.time:
            self.window.acknowledge(self._back.popleft()[1], self.sent, self.time, self._way_back)
            every = self.window.every
            if every >= 2 * self._asked or 2 * every <= self._asked:
                self._asked = every
                self.counter.set_interval(every)

    def _give(self) -> None:
        self.receipts += 1
        self._back.append((self.time + self.delay + self.behind, self.counter.next_receipt()))


@pytest.mark.parametrize("ages", AGES)
@pytest.mark.parametrize(("rate", "size"), [(14, 1000), (1000, 1000), (5, 3000), (300, 60)])
def test_tunnel_of_5_kb_stays_short_and_full(rate: float, size: int, ages: Ages) -> None:
    path = Path(5_000, ages=ages)
    path.run(5.0, rate, size)
    assert max(path.ages) < 2.0
    assert path.carries(30.0, rate, size) > 0.9 * 5_000
    assert max(path.ages) < 1.3
    assert path.window.slow


@pytest.mark.parametrize("ages", AGES)
@pytest.mark.parametrize("delay", [0.0005, 0.3])
@pytest.mark.parametrize(("rate", "size"), [(10, 100_000), (1000, 1000)])
def test_fast_path_is_not_throttled(delay: float, rate: float, size: int, ages: Ages) -> None:
    path = Path(100e6, delay, ages)
    path.run(6.0, rate, size)  # eight round trips of 0.6 s; TCP itself begins with three times as much
    path.run(1.0, 0, 0)
    arrived = len(path.ages)
    path.run(10.0, rate, size)
    path.run(1.0, 0, 0)
    assert len(path.ages) - arrived >= 10 * rate - 1
    assert not path.window.slow


def test_window_of_young_bytes_keeps_less_underway() -> None:
    """20 Mbit/s, 20 ms: a message that is published now waits for a third of a second at most, as all is one queue."""
    path = Path(2.5e6, 0.02, QUEUES_MUCH)
    path.run(5.0, 5_000, 1_000)
    assert path.carries(20.0, 5_000, 1_000) > 0.9 * 2.5e6
    assert max(path.ages) < 0.35


def test_ramp_up_takes_tens_of_milliseconds() -> None:
    """50 MB/s over a LAN; messages that are not taken by then would wait in the queue."""
    path = Path(1e9)
    path.run(0.05, 20_000, 2500)
    assert path.run(0.5, 20_000, 2500) >= 0.99 * 0.5 * 20_000 * 2500


def test_receipts_are_few() -> None:
    """A small topic on a good link costs one a second, and a large one hardly more."""
    for rate, size in ((10, 100), (10, 1000), (500, 20_000)):
        path = Path(1e9)
        path.run(5.0, rate, size)
        before = path.receipts
        path.run(20.0, rate, size)
        assert path.receipts - before <= 60


def test_path_that_becomes_slow() -> None:
    """No rate that was measured before keeps the sender from noticing."""
    path = Path(10e6)
    path.run(20.0, 14, 1000)
    path.speed = 5_000
    path.ages.clear()
    path.run(20.0, 14, 1000)
    assert max(path.ages) < 4.0
    assert max(path.ages[-50:]) < 1.3
    path.speed = 10e6
    path.run(3.0, 14, 1000)
    assert path.run(5.0, 14, 1000) >= 69_000
    assert not path.window.slow


@pytest.mark.parametrize("behind", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("rate", "size"), [(20, 130), (25, 1000), (100, 1000)])
def test_what_waits_in_other_direction_takes_no_room(behind: float, rate: float, size: int) -> None:
    """Commands to a robot whose uplink is full of video: the receipts for the commands wait behind the video."""
    path = Path(1e6, 0.01)
    path.run(5.0, rate, size)
    path.behind = behind
    path.run(10.0, rate, size)
    assert path.run(20.0, rate, size) >= 0.99 * 20 * rate * size


@pytest.mark.parametrize("delay", [0.5, 1.0, 1.5])
@pytest.mark.parametrize(("rate", "size"), [(20, 130), (25, 1000), (100, 1000)])
def test_long_path_that_is_not_full_carries_everything(delay: float, rate: float, size: int) -> None:
    """After roaming, or behind somebody else's data: less in transit would not make it faster."""
    path = Path(1e6, 0.01)
    path.run(5.0, rate, size)
    path.delay = delay
    path.run(10.0 + 30.0 * delay, rate, size)
    assert path.run(20.0, rate, size) >= 0.98 * 20 * rate * size
    path.delay = 0.01
    path.run(10.0, rate, size)
    path.speed = rate * size / 3
    path.run(20.0, rate, size)
    path.ages.clear()
    path.run(20.0, rate, size)
    assert max(path.ages) < 2.0 + 2 * LEAST / path.speed, "that it took longer before is forgotten"


@pytest.mark.parametrize("delay", [0.5, 1.0, 1.5])
@pytest.mark.parametrize("pinged_first", [True, False])
def test_path_that_takes_seconds_from_beginning_on(delay: float, pinged_first: bool) -> None:
    """Its pings measure the delay, and receipts cannot distinguish that from a queue: no clock gives the direction."""
    path = Path(1e6, delay)
    path.window.expect(2 * delay if pinged_first else 0.0)
    path.credit = 0.0
    path.run(15.0, 20, 1000)
    carries = path.run(20.0, 20, 1000) >= 0.98 * 20 * 20 * 1000
    assert carries == (pinged_first or delay < 1.5)
    assert not (pinged_first and path.window.slow)


def test_slow_path_behind_long_pings_is_kept_short() -> None:
    path = Path(5_000, 1.5)
    path.window.expect(3.0)
    path.credit = 0.0
    path.run(20.0, 14, 1000)
    assert path.carries(30.0, 14, 1000) > 0.9 * 5_000
    assert max(path.ages) < 1.5 + 2.0


def test_what_waits_in_its_own_direction_still_counts() -> None:
    path = Path(5_000)
    path.behind = 1.0
    path.run(20.0, 14, 1000)
    assert path.carries(30.0, 14, 1000) > 0.9 * 5_000
    assert max(path.ages) < 2.3


def test_stall() -> None:
    """Nothing arrives for 3 s: little more is sent, and then all goes on."""
    path = Path(10e6)
    path.run(10.0, 1000, 1000)
    path.speed = 0.0
    path.run(3.0, 1000, 1000)
    assert path.under_way < 2_500_000
    path.speed = 10e6
    path.run(1.0, 1000, 1000)
    assert path.run(3.0, 1000, 1000) >= 2_990_000


def test_large_messages_go_whole() -> None:
    """One that takes 20 s is not torn, and the next one follows at once, not after a way there and back."""
    path = Path(5_000, 0.1)
    path.run(90.0, 1, 100_000)
    assert len(path.ages) >= 4
    assert path.most_under_way <= 100_000 + FIRST


def test_lies_change_nothing_for_the_worse() -> None:
    window = Window()
    window.wrote(0, 0.0)
    window.acknowledge(10**12, 5_000, 0.1)  # more than was sent
    assert window.limit <= 5_000 + FIRST + 5_000
    limit = window.limit
    window.acknowledge(0, 5_000, 0.2)
    window.acknowledge(50, 5_000, 0.3)  # takes something back
    assert window.limit == limit
    silent = Window()
    silent.wrote(0, 0.0)
    for second in range(1, 100):
        silent.check(1_000, float(second))
    assert LEAST <= silent.limit <= FIRST


def test_nothing_grows_without_end() -> None:
    window = Window()
    for number in range(5_000):
        window.wrote(number * 1000, number * 0.1)
    assert held_by(window) <= 1024 + 1
    for number in range(5_000):
        window.acknowledge(number * 1000, 10**9, 1e4 + number * 1e-4)
    assert held_by(window) <= 64 + 1

"""The pace of a route's datagrams, on a simulated path to a receiver that reads when it comes to it."""

from __future__ import annotations

import random
from collections import deque

import pytest

from rsb_bridge.channel.pacing import WINDOW, Pacer

DATAGRAM = 1400
STEP = 0.0002
OTHER_CLOCK = -1234.5
"""s by which the receiver's clock is ahead."""


class Path:
    """A path and a receiver, in steps of time.

    Attributes:
        time: s.
        delay: s, each way.
        speed: bytes/s that the path carries; what is more waits in its queue.
        queue_limit: bytes that wait on the path at most.
        buffer: bytes of the receiver's buffer.
        held_up: s, from and until when the receiver does not read.
        receipts: whether the receiver sends any.
        losing: the share of datagrams that gets lost on the way, by chance.
        waited: s that each one waited in the path's queue.
        arrived: datagrams read so far.
    """

    def __init__(self, *, speed: float = 1e9, delay: float = 0.0002, buffer: int = 8 << 20) -> None:
        self.time = 0.0
        self.delay, self.speed, self.buffer = delay, speed, buffer
        self.queue_limit = 1 << 30
        self.held_up = (-1.0, -1.0)
        self.receipts = True
        self.losing = 0.0
        self.waited: list[float] = []
        self._chance = random.Random(1)
        self.arrived = self.lost = 0
        self.pacer = Pacer()
        self._sequence = 0
        self._carried = 0.0
        self._on_path: deque[tuple[float, int]] = deque()
        self._in_buffer: deque[tuple[int, float]] = deque()
        self._answers: deque[tuple[float, int, int, float]] = deque()
        self._since = WINDOW * buffer
        self._newest = -1
        self._told_at = 0.0

    def send(self, size: int, within: float) -> bool:
        """Send a message; whether all of it has left in time."""
        until, left = self.time + within, size // DATAGRAM
        while (left or self._on_path or self._in_buffer) and self.time < until:
            left -= self._send(left)
            if self.pacer.gives_up(self.time):
                self.pacer.write_off()
            self.step()
        return not left

    def publish(self, rate: float, seconds: float) -> float:
        """Send a datagram now and then; return for how long (s) some waited for the pace or the path."""
        until, due, held = self.time + seconds, self.time, 0.0
        while self.time < until:
            due += self._send(int((self.time - due) * rate)) / rate
            held += STEP if (self.time - due) * rate >= 1 else 0.0
            if self.pacer.gives_up(self.time):
                self.pacer.write_off()
            self.step()
        return held

    def _send(self, most: int) -> int:
        """Send like `DatagramSender`, until no room is left."""
        sent = 0
        while sent < most and (room := self.pacer.room(self.time)) > 0:
            count = min(-(-room // DATAGRAM), most - sent)
            for _ in range(count):
                self._put()
            self.pacer.sent(count * DATAGRAM, self._sequence - 1, self.time)
            sent += count
        return sent

    def _put(self) -> None:
        carried = max(self._carried, self.time) + DATAGRAM / self.speed
        if (carried - self.time) * self.speed > self.queue_limit or self._chance.random() < self.losing:
            self.lost += 1
        else:
            self._carried = carried
            self.waited.append(carried - self.time)
            self._on_path.append((carried + self.delay, self._sequence))
        self._sequence += 1

    def step(self) -> None:
        self.time += STEP
        while self._on_path and self._on_path[0][0] <= self.time:
            arrived_at, sequence = self._on_path.popleft()
            if len(self._in_buffer) * DATAGRAM + DATAGRAM <= self.buffer:
                self._in_buffer.append((sequence, arrived_at + OTHER_CLOCK))
            else:
                self.lost += 1
        if not self.held_up[0] <= self.time < self.held_up[1]:
            while self._in_buffer:
                self._newest, arrived_at = self._in_buffer.popleft()
                self.arrived += 1
                self._since += DATAGRAM
                if self.receipts and (self._since * 4 >= self.pacer.limit or self.time - self._told_at > 0.25):
                    self._since, self._told_at = 0, self.time
                    self._answers.append((self.time + self.delay, self._newest, self.arrived, arrived_at))
        while self._answers and self._answers[0][0] <= self.time:
            _, newest, opened, arrived_at = self._answers.popleft()
            self.pacer.receipt(newest, opened, self.buffer, arrived_at, self.time)


def test_lossless_path_is_soon_used_fully() -> None:
    path = Path()
    assert path.send(60_000_000, 1.0)
    began = path.time
    assert path.send(60_000_000, 1.0)
    assert path.lost == 0
    assert 60e6 / (path.time - began) > 400e6


@pytest.mark.parametrize("buffer", [212_992, 1 << 20, 8 << 20])
@pytest.mark.parametrize("pause", [0.01, 0.05, 0.2])
def test_a_receiver_that_is_held_up_loses_nothing(buffer: int, pause: float) -> None:
    path = Path(buffer=buffer)
    path.send(buffer, 5.0)
    lost = path.lost
    for _ in range(3):
        path.held_up = (path.time + 0.002, path.time + 0.002 + pause)
        assert path.send(3 * buffer, 5.0)
    assert path.lost == lost == 0


def test_late_receiver_slows_no_small_topic() -> None:
    """It gets no processor for 0.2 s, each second: what is not sent then proves no slow path."""
    path = Path()
    path.publish(200, 2.0)
    for _ in range(20):
        path.held_up = (path.time + 0.1, path.time + 0.3)
        path.publish(200, 1.0)
    assert path.pacer.path.pace > 100 * 200 * DATAGRAM
    path.held_up = (path.time + 0.1, path.time + 0.3)
    assert path.publish(200, 1.0) < 0.01


def test_small_buffer_far_away_keeps_path_full() -> None:
    path = Path(buffer=212_992, delay=0.015, speed=50e6)
    path.queue_limit = 2 << 20
    path.send(20_000_000, 5.0)
    began = path.time
    path.send(20_000_000, 5.0)
    assert 20e6 / (path.time - began) > 20e6


def test_a_narrow_path_is_found_and_kept_to() -> None:
    """Beyond its 40 MB/s a switch drops: the pace shrinks, and then hardly anything is lost."""
    path = Path(speed=40e6)
    path.queue_limit = 256 << 10
    for _ in range(20):
        path.send(6_000_000, 1.0)
    began, lost, arrived = path.time, path.lost, path.arrived
    for _ in range(20):
        path.send(6_000_000, 1.0)
    assert path.lost - lost < 0.03 * (path.arrived - arrived)
    assert 120e6 / (path.time - began) > 36e6


@pytest.mark.parametrize("chance", [0.02, 0.3])
def test_radio_is_filled_without_queue_whatever_it_loses(chance: float) -> None:
    """20 Mbit/s, 20 ms, and a queue of 0.16 s."""
    path = Path(speed=2.5e6, delay=0.02)
    path.queue_limit, path.losing = 400_000, chance
    path.send(10_000_000, 8.0)
    path.waited.clear()
    began, arrived = path.time, path.arrived
    path.send(10_000_000, 8.0)
    assert sorted(path.waited)[len(path.waited) // 2] < 0.03
    assert sorted(path.waited)[len(path.waited) * 99 // 100] < 0.09
    assert (path.arrived - arrived) * DATAGRAM / (path.time - began) > 0.85 * 2.5e6 * (1 - chance)


@pytest.mark.parametrize(("speed", "delay"), [(100e6, 0.0002), (12.5e6, 0.02), (2.5e6, 0.02)])
def test_images_are_not_spread_over_pauses(speed: float, delay: float) -> None:
    """60 kB at 25 Hz, which the path carries: each arrives as soon as it can, however long it goes on."""
    path = Path(speed=speed, delay=delay)
    took = []
    for _ in range(250):
        began = path.time
        assert path.send(60_000, 1.0)
        took.append(path.time - began)
        while path.time < began + 0.04:
            path.step()
    assert sorted(took[50:])[100] < delay + 60_000 / speed + 0.005
    assert max(took[50:]) < 2 * delay + 60_000 / speed + 0.01


def test_late_receipt_of_written_off_gives_no_rtt() -> None:
    pacer = Pacer()
    pacer.sent(2000, 1, 0.0)
    pacer.receipt(0, 1, 8 << 20, 0.5, 0.5)
    pacer.sent(2000, 3, 0.5)
    pacer.write_off()
    pacer.sent(2000, 5, 1.0)
    pacer.receipt(3, 4, 8 << 20, 1.001, 1.001)
    assert pacer.patience == 1.0


def test_a_path_that_becomes_wider_is_soon_filled() -> None:
    path = Path(speed=2.5e6, delay=0.02)
    path.queue_limit = 400_000
    path.send(10_000_000, 8.0)
    path.speed = 25e6
    path.send(25_000_000, 3.0)
    arrived = path.arrived
    path.send(50_000_000, 1.0)
    assert (path.arrived - arrived) * DATAGRAM > 20e6


def test_path_that_becomes_narrow_is_soon_followed() -> None:
    path = Path(speed=25e6, delay=0.005)
    path.queue_limit = 400_000
    path.send(50_000_000, 3.0)
    path.speed, path.delay = 250e3, 0.1
    path.send(5_000_000, 20.0)
    arrived, lost = path.arrived, path.lost
    path.send(4_000_000, 10.0)
    assert (path.arrived - arrived) * DATAGRAM > 0.85 * 10 * 250e3
    assert path.lost - lost < 0.05 * (path.arrived - arrived)


def test_what_overtakes_is_not_lost() -> None:
    """Each receipt misses a datagram that is still in flight."""
    overtaken, in_order = Pacer(), Pacer()
    for number in range(1, 50):
        for pacer, missing in ((overtaken, 1), (in_order, 0)):
            pacer.sent(100_000, number * 10, number * 0.01)
            now = number * 0.01 + 0.001
            pacer.receipt(number * 10, number * 10 + 1 - missing, 8 << 20, now, now)
    assert overtaken.limit == pytest.approx(in_order.limit, rel=0.01)


def test_receipts_that_were_overtaken_count_for_nothing() -> None:
    pacer = Pacer()
    pacer.sent(1000, 9, 0.0)
    pacer.receipt(9, 10, 8 << 20, 0.1, 0.1)
    pacer.receipt(4, 5, 100, 0.2, 0.2)
    assert pacer.window == (8 << 20) // WINDOW


def test_lost_receipts_hold_up_nothing_for_long() -> None:
    path = Path(buffer=212_992)
    assert path.send(212_992, 1.0)
    path.receipts = False
    assert path.send(10 * 212_992, 20.0)


@pytest.mark.parametrize(("newest", "opened", "buffer"), [(2**64 - 1, 0, 0), (0, 2**64 - 1, 2**32 - 1), (5, 0, 1)])
def test_lying_peer_stops_only_its_own_traffic(newest: int, opened: int, buffer: int) -> None:
    pacer = Pacer()
    pacer.sent(1000, 0, 0.0)
    pacer.receipt(newest, opened, buffer, 0.0, 0.0)
    pacer.sent(200_000, 3, 0.1)
    assert pacer.room(0.1) <= 8 << 20
    if pacer.room(10.0) <= 0:
        assert pacer.gives_up(10.0)
        pacer.write_off()
    assert pacer.room(10.0) > 0

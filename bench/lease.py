"""Computes how often a bad link disarms, and how many armed messages are too old, with the lease itself.

``python -m bench.lease`` prints a line for each link and limit. The streams lose packets as TCP does: a packet that is
lost comes a retransmission later, and everything behind it waits. Datagrams that are lost do not count.
"""

from __future__ import annotations

import heapq
import itertools
import random
from typing import TYPE_CHECKING, NamedTuple
from unittest.mock import patch

from rsb_bridge.ros.ros_thread import RosTurns
from rsb_bridge.route import lease
from rsb_bridge.route.lease import BEAT, LeaseHalf

if TYPE_CHECKING:
    from collections.abc import Callable

SECONDS = 3600.0
RATE = 20.0
LINKS = ((0.05, 0.0), (0.1, 0.02), (0.3, 0.0), (0.3, 0.01), (0.3, 0.05), (0.5, 0.01))
"""Round trips (s), and the part of packets that is lost."""
LIMITS = (1.0, 2.0, 3.0)
_SHORTEST_RETRANSMISSION = 0.2  # s, as Linux waits at least (TCP_RTO_MIN)


class Result(NamedTuple):
    """One hour of a link.

    Attributes:
        disarmed: times.
        too_old: part of the messages that arrived.
        silent: part of the time in which nothing was sent.
    """

    disarmed: float
    too_old: float
    silent: float


class Hour:
    """An hour of a link.

    Args:
        loss: part of the packets.
        datagrams: whether messages go as datagrams.
    """

    def __init__(self, round_trip: float, loss: float, *, datagrams: bool) -> None:
        self._round_trip = round_trip
        self._loss = loss
        self._datagrams = datagrams
        self._random = random.Random(1)
        self._now = 0.0
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._arrived: dict[str, float] = {}
        self._ended = self._sent = self._young = self._old = 0
        self._here, self._there = (LeaseHalf(lambda: self._now, RosTurns(), self._end) for _ in range(2))

    def live(self) -> Result:
        self._begin()
        self._beat(self._here, self._there, "there")
        self._beat(self._there, self._here, "here")
        self._at(1.0, self._publish)
        while self._events[0][0] < SECONDS:
            self._now, _, work = heapq.heappop(self._events)
            work()
        arrived = max(1, self._old + self._young)
        # Both sides end the same lease.
        return Result(self._ended / 2, self._old / arrived, 1 - self._sent / (RATE * (SECONDS - 1)))

    def _at(self, delay: float, work: Callable[[], None]) -> None:
        heapq.heappush(self._events, (self._now + delay, next(self._order), work))

    def _begin(self) -> None:
        for side in (self._here, self._there):
            side.end()
            side.begin()

    def _end(self) -> None:
        self._ended += 1
        self._at(0.0, self._begin)

    def _send(self, stream: str, work: Callable[[], None]) -> None:
        delay = self._round_trip / 2 * self._random.uniform(1.0, 1.1)
        again = self._round_trip + max(_SHORTEST_RETRANSMISSION, self._round_trip / 2)
        while self._random.random() < self._loss:
            if not stream:
                return
            delay, again = delay + again, 2 * again
        arrives = self._now + delay
        if stream:
            arrives = self._arrived[stream] = max(arrives, self._arrived.get(stream, 0.0))
        self._at(arrives - self._now, work)

    def _beat(self, side: LeaseHalf, other: LeaseHalf, stream: str) -> None:
        number, echo = side.beat()
        self._send(stream, lambda: other.hear(number, echo))
        self._at(BEAT, lambda: self._beat(side, other, stream))

    def _publish(self) -> None:
        self._at(1 / RATE, self._publish)
        if self._here.alive:
            self._sent += 1
            number = self._here.newest_before(self._now)
            self._send("" if self._datagrams else "data", lambda: self._arrive(number))

    def _arrive(self, number: int) -> None:
        if self._there.passes(number):
            self._young += 1
        else:
            self._old += 1


def main() -> None:
    for (round_trip, loss), limit in itertools.product(LINKS, LIMITS):
        with patch.object(lease, "GIVEN_UP_AFTER", limit):
            udp, tcp = (Hour(round_trip, loss, datagrams=datagrams).live() for datagrams in (True, False))
        print(
            f"{round_trip:4.2f} s, {loss:3.0%} lost, given up after {limit:g} s: disarmed {udp.disarmed:5.1f} times an "
            f"hour, too old {udp.too_old:5.1%} (UDP) {tcp.too_old:5.1%} (TCP), silent {udp.silent:5.1%} of the time"
        )


if __name__ == "__main__":
    main()

"""A link without a network, on a clock of its own."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from rsb_extras.bench.results import BenchEnds, BenchError, Many, Run, Side, StoppedError, Way


class SimulatedLink:
    """Carries so many bytes and messages a second, and loses what is more.

    Attributes:
        time: s that the runs have taken so far.
    """

    def __init__(
        self,
        bytes_per_second: float = 10e6,
        most_messages: float = 20_000.0,
        *,
        sender: float = 1e9,
        leave: float = 1e9,
    ) -> None:
        self.time = 0.0
        self._bytes = bytes_per_second
        self._messages = most_messages
        self._sender = sender
        self._leave = leave
        self.tried: list[float] = []

    def capacity(self, size: int) -> float:
        return min(self._messages, self._bytes / size)

    def send(self, rate: float, seconds: float, size: int, _: str = "") -> Run:
        self.tried.append(rate)
        self.time += seconds + 0.1
        reached = min(rate, self._sender)
        sent = max(1, int(reached * seconds))
        come = min(sent - 1, int(self.capacity(size) * seconds)) if reached > self.capacity(size) else sent
        return Run(size, sent, come, reached, 1.0, 2.0, 3.0, (sent * 20e-6, sent * 30e-6))

    def wire(self, rate: float, seconds: float, size: int) -> Run:
        run = self.send(rate, seconds, size)
        return Run(size, run.sent, run.received, run.rate, 1.0, 2.0, 3.0, run.sides, run.sent * (size + 25))

    def most(self, _: int) -> float:
        return self._leave

    def sides(self, idle: float) -> tuple[Side, Side]:
        self.time += idle
        return Side(50.0, 0.1, first=0.8), Side(51.0, 0.2, 0.5, 0.8)


class SimulatedPlace:
    """Has such links.

    Args:
        fails: transports that cannot be opened.
        stops: transports at which the peer ends it all.
    """

    def __init__(self, links: dict[str, SimulatedLink], *, fails: tuple[str, ...] = (), stops: tuple[str, ...] = ()):
        self._links = links
        self._fails = fails
        self._stops = stops

    @property
    def time(self) -> float:
        return sum(link.time for link in self._links.values())

    @property
    def ways(self) -> list[Way]:
        return [Way(name, "transmit") for name in self._links]

    @contextlib.contextmanager
    def baseline(self, _: list[int]) -> Iterator[BenchEnds]:
        yield SimulatedLink()

    @contextlib.contextmanager
    def open(self, way: Way, _: list[int]) -> Iterator[BenchEnds]:
        if way.transport in self._fails:
            raise BenchError("cannot be opened")
        if way.transport in self._stops:
            raise StoppedError("the peer has had enough")
        yield self._links[way.transport]

    def many(self, count: int) -> Many:
        return Many(count, 0.5, (60.0, 61.0), (1.0, 2.0))

"""Legitimate service as a server's clients have it, measured all the time: how fast they link, and are answered."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import TYPE_CHECKING, NamedTuple

from tests.support.rogue import Rogue

from rsb_bridge.wire.messages import Neighbours, Ping, Pong

if TYPE_CHECKING:
    from collections.abc import Mapping

PINGING = 4
"""Links that ping; a server answers each four times a second."""
_PING_EVERY = 0.26  # s; a server answers four pings a second (docs/budgets.md)
_LINK_EVERY = 0.75
_GIVEN_UP_AFTER = 3.0
"""s, as a client gives an attempt to connect up."""
CLIENTS = ("second", *(f"pinging{number}" for number in range(PINGING)))


class Service(NamedTuple):
    """The service to clients in a span of time; times in ms.

    Attributes:
        link: the longest time until another client was linked; a lower bound if `linked` is false.
        linked: whether another client was linked at all.
        p50: median round trip of a link's control connection.
        p99: 99th percentile of that round trip.
        lost: number of links that ended.
    """

    link: float
    linked: bool
    p50: float
    p99: float
    lost: int


class _Samples:
    """Durations of an operation, with the time when each ended."""

    def __init__(self) -> None:
        self._taken: list[tuple[float, float]] = []
        self._began: float | None = None

    def begin(self) -> None:
        """Begin, or go on after an attempt that failed."""
        if self._began is None:
            self._began = time.monotonic()

    def end(self) -> None:
        assert self._began is not None
        now = time.monotonic()
        self._taken.append((now, now - self._began))
        self._began = None

    def since(self, moment: float) -> tuple[list[float], float]:
        """Return the durations in ms that ended since then, and the present one's so far."""
        began = self._began
        pending = time.monotonic() - began if began is not None else 0.0
        return [1000 * took for ended, took in tuple(self._taken) if ended >= moment], 1000 * pending


class Clients:
    """Some that are linked and ping, and one that links again and again; made by hand, so that they cost little."""

    def __init__(self, host: str, port: int, keys: Mapping[str, bytes]) -> None:
        self._address = host, port
        self._keys = keys
        self._over = threading.Event()
        self._links, self._pings = _Samples(), [_Samples() for _ in range(PINGING)]
        self._lost: list[float] = []
        self._threads = [threading.Thread(target=self._link_again_and_again)]
        self._threads += [threading.Thread(target=self._ping, args=(number,)) for number in range(PINGING)]
        for thread in self._threads:
            thread.start()

    def since(self, moment: float) -> Service:
        links, linking = self._links.since(moment)
        pings: list[float] = []
        for each in self._pings:
            ended, pending = each.since(moment)
            # A ping that still waits counts once it is late, or a server that hangs would have no slow pings.
            pings += [*ended, *([pending] if pending > 100 or not ended else [])]
        pings.sort()
        lost = sum(1 for at in self._lost if at >= moment)
        return Service(
            max([*links, linking]), bool(links), pings[len(pings) // 2], pings[len(pings) * 99 // 100], lost
        )  # fmt: skip

    def close(self) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()

    def _client(self, name: str) -> Rogue:
        host, port = self._address
        made = Rogue(port, self._keys[name], name, host=host, timeout=_GIVEN_UP_AFTER)
        made.wait_for(Neighbours)  # the server sends it to linked clients
        return made

    def _link_again_and_again(self) -> None:
        while not self._over.is_set():
            self._links.begin()
            try:
                with self._client(CLIENTS[0]):
                    self._links.end()
            except (OSError, AssertionError):
                self._over.wait(0.1)
                continue
            self._over.wait(_LINK_EVERY)

    def _ping(self, number: int) -> None:
        while not self._over.is_set():
            with contextlib.suppress(OSError, AssertionError), self._client(f"pinging{number}") as client:
                self._ping_on(client, self._pings[number])
            if not self._over.is_set():
                self._lost.append(time.monotonic())
                self._over.wait(0.1)

    def _ping_on(self, client: Rogue, samples: _Samples) -> None:
        number = 0
        while not self._over.wait(_PING_EVERY):
            number += 1
            samples.begin()
            client.say(Ping(number, 0))
            while client.wait_for(Pong).n != number:
                pass
            samples.end()

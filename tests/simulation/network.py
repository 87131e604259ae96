"""The network between the machines: addresses, names, delay and loss.

A `Path` is one direction between two machines. It has no connections: it decides whether and when a packet arrives, and
the sender (`tests.simulation.sockets`) acts as a kernel would. A cut path drops everything silently, as a pulled cable
or a firewall does.
"""

from __future__ import annotations

import socket
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    from tests.simulation.loop import SimulatedLoop
    from tests.simulation.machine import Machine


_GOOD = (0.0005, 0.005)


@dataclass(slots=True, eq=False)
class Path:
    """One direction between two machines.

    Attributes:
        latency: s, between which each packet takes; datagrams overtake each other within it.
        loss: part of the datagrams that are lost; a stream's bytes come 0.2 s later instead.
        bandwidth: bytes/s, or None for no limit.
    """

    latency: tuple[float, float] = _GOOD
    loss: float = 0.0
    duplicates: float = 0.0
    bandwidth: float | None = None
    mtu: int = 1500
    cut_at: float | None = None
    _busy_until: float = 0.0
    _when_healed: dict[Callable[[], None], None] = field(default_factory=dict)

    def delay(self, size: int, now: float, random: Random) -> float:
        latency = random.uniform(*self.latency)
        if self.bandwidth is None:
            return latency
        self._busy_until = max(self._busy_until, now) + size / self.bandwidth
        return self._busy_until - now + latency

    def on_healed(self, call: Callable[[], None]) -> None:
        self._when_healed[call] = None

    def forget(self, call: Callable[[], None]) -> None:
        self._when_healed.pop(call, None)

    def mend(self) -> None:
        """Be a good network again; whether it is cut is another matter."""
        self.latency, self.loss, self.duplicates, self.bandwidth, self.mtu = _GOOD, 0.0, 0.0, None, 1500

    def healed(self) -> None:
        waiting, self._when_healed = self._when_healed, {}
        for call in waiting:
            call()


class Network:
    """All machines, the paths between them, and the names that they have.

    Attributes:
        names: the addresses that name servers give, or None if they do not answer. They do not know names that are
            missing.
    """

    def __init__(self, loop: SimulatedLoop, random: Random) -> None:
        self.loop = loop
        self.random = random
        self.names: dict[str, list[str] | None] = {}
        self._machines: dict[str, Machine] = {}
        self._paths: dict[tuple[Machine, Machine], Path] = {}

    def join(self, machine: Machine, address: str) -> None:
        assert address not in self._machines, f"{address} is {self._machines[address].name}'s"
        self._machines[address] = machine

    def leave(self, address: str) -> None:
        del self._machines[address]

    def machine_at(self, address: str) -> Machine | None:
        return self._machines.get(address)

    def look_up(self, host: str) -> list[str] | None:
        """Return the addresses of a host, or None if no name server answers. A numeric address needs none.

        Raises:
            socket.gaierror: the name is not known.
        """
        if is_numeric(host):
            return [host]
        if host not in self.names:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return self.names[host]

    def path(self, source: Machine, destination: Machine) -> Path:
        path = self._paths.get((source, destination))
        if path is None:
            path = self._paths[source, destination] = Path()
        return path

    def both_ways(self, one: Machine, other: Machine) -> tuple[Path, Path]:
        return self.path(one, other), self.path(other, one)

    def cut(self, one: Machine, other: Machine) -> None:
        self.cut_one_way(one, other)
        self.cut_one_way(other, one)

    def cut_one_way(self, source: Machine, destination: Machine) -> None:
        self.path(source, destination).cut_at = self.loop.time()

    def heal(self, one: Machine, other: Machine) -> None:
        for path in self.both_ways(one, other):
            path.cut_at = None
            path.healed()

    def passes(self, source: Machine, destination: Machine) -> bool:
        return source.up and destination.up and self.path(source, destination).cut_at is None

    def woke(self, machine: Machine) -> None:
        """A machine is on again: packets in flight to it may arrive."""
        for ends, path in tuple(self._paths.items()):
            if machine in ends:
                path.healed()


def is_numeric(host: str) -> bool:
    return host.replace(".", "").isdecimal()

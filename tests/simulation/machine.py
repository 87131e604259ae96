"""Computers and the programs that run on them, as their kernels know them."""

from __future__ import annotations

import contextvars
import errno
import os
from typing import TYPE_CHECKING, Any, Protocol

from tests.simulation.loop import PROGRAM

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from tests.simulation.loop import SimulatedLoop
    from tests.simulation.network import Network
    from tests.simulation.sockets import Socket

ANY = "0.0.0.0"
_STREAM_BUFFERS = (4_000, 32_000, 200_000)
_FIRST_EPHEMERAL, _EPHEMERAL_PORTS = 32_768, 28_000


class Descriptor(Protocol):
    def killed(self) -> None: ...

    def vanished(self) -> None:
        """Its machine lost its power: nobody closes it."""


class Machine:
    """A computer: its address, its ports, and whether it is switched on.

    Attributes:
        off_at: s, when it was switched off, or None while it is on.
        stream_buffer: bytes of a stream that its kernel takes before the peer's has acknowledged them.
        receive_buffer: bytes of datagrams that its kernel keeps for a socket (net.core.rmem_max).
    """

    def __init__(self, name: str, network: Network, address: str) -> None:
        self.name = name
        self.network = network
        self.address = address
        self.off_at: float | None = None
        self.refuses = False
        self.receive_buffer = 8 << 20
        self.stream_buffer = network.random.choice(_STREAM_BUFFERS)
        self.bound: dict[tuple[int, int], Socket] = {}
        self.processes: list[Process] = []
        self._last_port = 0
        network.join(self, address)

    @property
    def up(self) -> bool:
        return self.off_at is None

    def __repr__(self) -> str:
        return f"<{self.name} {self.address}>"

    def free_port(self, kind: int) -> int:
        while True:
            self._last_port = (self._last_port + 1) % _EPHEMERAL_PORTS
            port = _FIRST_EPHEMERAL + self._last_port
            if (kind, port) not in self.bound:
                return port

    def move(self, address: str) -> None:
        self.network.leave(self.address)
        self.address = address
        self.network.join(self, address)

    def power_off(self) -> None:
        """Lose everything, without a word to anybody."""
        self.off_at = self.network.loop.time()
        for process in tuple(self.processes):
            process.end(lambda descriptor: descriptor.vanished())

    def power_on(self) -> None:
        self.off_at = None
        self.network.woke(self)


class Process:
    """One run of a program, as its kernel knows it.

    Attributes:
        context: to run its code in; tasks and timers inherit it.
        failed: tasks that raised an exception, and when (s).
        alive: whether it has not been killed. Tasks of a killed process may still run, but reach nobody.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.network = machine.network
        self.loop: SimulatedLoop = machine.network.loop
        self.descriptors: dict[Descriptor, None] = {}
        self.tasks: dict[asyncio.Task[Any], None] = {}
        self.failed: list[tuple[float, asyncio.Task[Any]]] = []
        self.most_descriptors = 1024
        self.alive = True
        self.context = contextvars.copy_context()
        self.context.run(PROGRAM.set, self)
        machine.processes.append(self)

    def kill(self) -> None:
        self.end(lambda descriptor: descriptor.killed())

    def exit(self) -> list[Descriptor]:
        """End in good order, and return the descriptors that the kernel had to close."""
        left = list(self.descriptors)
        self.kill()
        return left

    def end(self, free: Callable[[Descriptor], None]) -> None:
        if self.alive:
            self.alive = False
            self.machine.processes.remove(self)
            for descriptor in tuple(self.descriptors):
                free(descriptor)
            self.descriptors.clear()

    def add_task(self, task: asyncio.Task[Any]) -> None:
        self.tasks[task] = None
        task.add_done_callback(self._task_ended)

    def _task_ended(self, task: asyncio.Task[Any]) -> None:
        del self.tasks[task]
        if not task.cancelled() and task._exception is not None:  # without asking for it, which would make it seen
            self.failed.append((self.loop.time(), task))

    def check_own(self, host: str) -> None:
        """Raise OSError where an address is not this machine's."""
        if not self.alive:
            raise os_error(errno.ENETDOWN)
        if host not in (self.machine.address, ANY):
            raise os_error(errno.EADDRNOTAVAIL)


def os_error(number: int) -> OSError:
    return OSError(number, os.strerror(number))

"""A computer that runs an engine in a ROS domain: a robot, or the PC that controls robots."""

from __future__ import annotations

import asyncio
from random import Random
from typing import TYPE_CHECKING, TypeVar

from tests.simulation.machine import Machine, Process
from tests.simulation.node import Node
from tests.simulation.ros import Domain

from rsb_bridge.api import EngineError
from rsb_bridge.context import Context
from rsb_bridge.engine.bridge import Bridge
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.commands import acting, on_console
from rsb_bridge.model.snapshot import Snapshot
from rsb_bridge.ros.ros_thread import BatchReceiver, RosToLoopQueue
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.telemetry.snapshot_publisher import ShownBridge, SnapshotPublisher

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Sequence

    from tests.simulation.loop import SimulatedLoop
    from tests.simulation.machine import Descriptor
    from tests.simulation.network import Network

    from rsb_bridge.config.keys import Key
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import Event, Level

_EPOCH = 1_700_000_000
_SNAPSHOT_EVERY = 60.0
T = TypeVar("T")


class WallClock(Clock):
    """A machine's wall clock: it may be wrong, drift, and be set.

    Attributes:
        offset: s ahead of the truth at time 0.
        drift: s that it gains a second.
    """

    def __init__(self, loop: SimulatedLoop, random: Random) -> None:
        self.offset = random.uniform(-5.0, 5.0)
        self.drift = random.uniform(-50e-6, 50e-6)
        self._loop = loop

    def time_ns(self) -> int:
        return int((_EPOCH + self.offset + self._loop.time() * (1 + self.drift)) * 1e9)

    def steady(self) -> float:
        return self._loop.time()


class _Queue(RosToLoopQueue):
    """Messages from the ROS side, whose thread never has to wait: it is the loop's own. A turn brings several."""

    def put(self, receiver: BatchReceiver[T], batch: Sequence[T], *, express: bool = False) -> None:
        self._batches.append((receiver, batch, express))
        if not self._scheduled:
            self._scheduled = True
            self._loop.call_later(1e-9, self._drain)  # behind all that is taken at this moment


class _Events(EventLog):
    def __init__(self, clock: Clock, told: Callable[[Level, str, str, str], None]) -> None:
        super().__init__(clock)
        self._told = told

    def append(self, event: Event) -> None:
        super().append(event)
        self._told(event.level, event.code, event.text, event.link)


class _Snapshots(SnapshotPublisher):
    """A snapshot without readers; it is refreshed now and then all the same, for its side effects."""

    async def run(self, bridge: ShownBridge) -> None:
        while True:
            await self.refresh(bridge)
            await asyncio.sleep(_SNAPSHOT_EVERY)


class EngineHost:
    """A computer, its ROS domain, and the session that its engine runs.

    Attributes:
        session: what the next engine will run.
    """

    def __init__(self, network: Network, name: str, address: str, random: Random) -> None:
        self.name = name
        self.machine = Machine(name, network, address)
        self.clock = WallClock(network.loop, random)
        self.domain = Domain(network.loop, Random(random.random()), self.clock.time_ns)
        self.session: Session
        self.keys: dict[str, tuple[Key, ...]] = {}
        self.run: Run | None = None
        self.on_run: Callable[[Run], None] = _ignore
        self.on_end: Callable[[Run], None] = _ignore
        self.on_event: Callable[[EngineHost, Level, str, str, str], None] = _ignore
        self.on_leak: Callable[[EngineHost, list[Descriptor]], None] = _ignore
        self.random = random

    def start(self) -> Run:
        assert self.run is None, f"{self.name} runs one"
        run = self.run = Run(self)
        self.on_run(run)
        run.begin()
        return run

    async def stop(self) -> None:
        run = self._ending()
        if run is not None:
            await run.stop()

    def kill(self) -> None:
        run = self._ending()
        if run is not None:
            run.process.kill()
            run.die()

    def power_off(self) -> None:
        run = self._ending()
        self.machine.power_off()
        if run is not None:
            run.die()

    def _ending(self) -> Run | None:
        if self.run is not None:
            self.on_end(self.run)
        run, self.run = self.run, None
        return run


class Run:
    def __init__(self, host: EngineHost) -> None:
        self.host = host
        self.process = Process(host.machine)
        self.loop = self.process.loop
        self.node = Node(host.domain, host.session.name, f"{host.random.getrandbits(32):08x}")
        self.events = _Events(host.clock, lambda *event: host.on_event(host, *event))
        self.began = self.loop.time()
        self.over = False
        self.bridge = self.process.context.run(self._make)
        self._task: asyncio.Task[None] | None = None

    def _make(self) -> Bridge:
        host = self.host
        context = Context(
            host.session,
            host.session.domain_id or 0,
            self.node,
            self.events,
            _Queue(self.loop),
            self.loop,
            host.clock,
            Random(host.random.random()),
        )
        session = host.session
        blank = Snapshot(0.0, session.name, session.role, "", session.domain_id or 0, running=False)
        return Bridge(context, host.keys, _Snapshots(blank, self.events, host.clock))

    def begin(self) -> None:
        self._task = self.loop.create_task(self._main(), context=self.process.context)

    async def _main(self) -> None:
        try:
            await self.bridge.start()
            await self.bridge.run()
        finally:
            self.bridge.context.transports.close()

    def links(self) -> list[Link]:
        return self.bridge.role.links()

    async def command(self, work: Coroutine[None, None, T], who: str = "") -> T | None:
        """Carry out an operator's command in the engine's process. Return None if the process died before the end of
        it.

        Args:
            who: the name of the operator's console, or an empty string for the bridge's own.

        Raises:
            EngineError: it cannot be carried out.
        """

        async def carry_out() -> T | EngineError:
            try:
                if not who:
                    return await work
                with on_console(who), acting(who):
                    return await work
            except EngineError as error:
                return error

        # A task's context is its own, as others of the process have other operators at the same time.
        task = self.loop.create_task(carry_out(), context=self.process.context.copy())
        await asyncio.wait([task])
        if task.cancelled():
            return None
        result = task.result()
        if isinstance(result, EngineError):
            raise result
        return result

    async def stop(self) -> None:
        self.over = True
        assert self._task is not None
        self.bridge.stop()
        await self._task
        while tasks := tuple(self.process.tasks):  # as asyncio.run does
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
        self.node.stop()
        if left := self.process.exit():
            self.host.on_leak(self.host, left)

    def die(self) -> None:
        """End the process as a kill does: its tasks are cancelled, and reach nobody any more."""
        self.over = True
        self.node.die()
        for task in tuple(self.process.tasks):
            task.cancel()


def _ignore(*_: object) -> None:
    """Nobody wants to know."""

"""A robot that is driven, the operators at consoles of both sides, and what befalls them."""

from __future__ import annotations

import asyncio
import contextlib
import struct
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import msgspec
from tests.simulation.conditions import STILL
from tests.simulation.ros import Reader, hash_of
from tests.simulation.world import World

from rsb_bridge.api import EngineError
from rsb_bridge.model.commands import KeepArmed
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Sequence

    from tests.simulation.engine_host import EngineHost, Run

    from rsb_bridge.model.calls import Fields
    from rsb_bridge.model.commands import Command
    from rsb_bridge.model.transports import Protocol
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.route import Route

SECONDS = 240.0
TWIST = "geometry_msgs/msg/Twist"
_CDR = b"\0\1\0\0"
LAYOUT = struct.Struct("<6d")
RATE = 10.0
"""Hz of a driver's commands."""
SIGN_OF_LIFE_EVERY = 0.5


def written(fields: Fields) -> bytes:
    linear = fields.get("linear", {}) if isinstance(fields, dict) else {}
    return _CDR + LAYOUT.pack(float(linear.get("x", 0)), *(0.0,) * 5)  # type: ignore[union-attr, arg-type]


@dataclass(eq=False)
class Driver:
    name: str
    host: EngineHost
    speed: float
    stands_still: bool = False


class Drivers:
    """A robot, a server, and their operators.

    Attributes:
        changes: how often the motors heard another driver than before.
    """

    def __init__(self, seed: int, protocol: Protocol) -> None:
        self.world = world = World(seed, replace(STILL, topics=(0,)))
        world.invariants.check = lambda: None  # type: ignore[method-assign]  # they count the world's own flows
        self.random = world.random("drivers")
        self.heard: Counter[str] = Counter()
        self.changes = 0
        (robot,) = world.robots
        self.robot, self.server = robot.host, world.server
        entry = Topic("/cmd", "receive", protocol=protocol, type=TWIST, arm=True, deadman=20.0, remote_topic="/cmd")
        self.robot.session = msgspec.structs.replace(self.robot.session, topics=(entry,))
        for host in (self.robot, self.server):
            host.domain.installed[TWIST] = hash_of(TWIST)
            host.domain.written[TWIST] = written
            host.on_run = lambda _: None  # its messages are no flow's
        self.drivers = (
            Driver("anna", self.server, 0.1),
            Driver("bert", self.server, 0.2),
            Driver("carol", self.robot, 0.3),
        )
        self._by_speed = {each.speed: each for each in self.drivers}
        self._last = self._driver = ""  # whose message the motors heard last, and whose that moved
        Reader(self.robot.domain, "/motors", "/cmd", TWIST, hash_of(TWIST), Qos(depth=1000), self._hear)

    # --- what must never be

    def _hear(self, batch: Sequence[RawMessage]) -> None:
        for message in batch:
            speed = LAYOUT.unpack_from(message.payload, len(_CDR))[0]
            name = self._by_speed[speed].name if speed else ""
            if name and self._last not in ("", name):
                self.world.wrong(f"{name} drives right after {self._last}: no rest in between")
            if name and self._driver != name:
                self.changes += bool(self._driver)
                self._driver = name
            self._last = name
            self.heard[name] += 1

    # --- what operators do

    def _route(self, host: EngineHost) -> Route | None:
        links = host.run.links() if host.run is not None else []
        return next((route for link in links for route in link.routes.values()), None)

    async def do(self, driver: Driver, make: Callable[[Route], Command[Any]]) -> Any:
        """Give a command about the topic; None if it is refused."""
        run, route = driver.host.run, self._route(driver.host)
        if run is None or route is None:
            return None
        with contextlib.suppress(EngineError):
            return await run.command(run.bridge.do(make(route)), driver.name)

    def _holds(self, driver: Driver) -> bool:
        route = self._route(driver.host)
        return route is not None and route.arming.console == driver.name

    def is_asked(self, driver: Driver) -> bool:
        route = self._route(driver.host)
        return route is not None and route.arming.question is not None

    async def stay(self, driver: Driver) -> None:
        """Give signs of life."""
        while True:
            await asyncio.sleep(SIGN_OF_LIFE_EVERY)
            await self.do(driver, lambda _: KeepArmed(pressed=True))

    async def command(self, driver: Driver, command: Callable[[str], Command[Any]]) -> None:
        await self.do(driver, lambda route: command(route.key))

    def local_name(self, host: EngineHost) -> str:
        route = self._route(host)
        assert route is not None
        return route.local_topic

    # --- what befalls them

    async def befall(self) -> None:
        random, loop = self.random, self.world.loop
        ends = self.server.machine, self.robot.machine
        while True:
            await asyncio.sleep(random.uniform(3.0, 10.0))
            seconds = random.choice((0.4, 1.2, 2.5, 6.0))
            match random.choice(("console", "process", "network", "kill")):
                case "console":
                    driver = random.choice(self.drivers)
                    driver.stands_still = True
                    await asyncio.sleep(seconds)
                    driver.stands_still = False
                case "process":
                    run = self._run()
                    if run is not None:
                        loop.freeze(run.process)
                        try:
                            await asyncio.sleep(seconds)
                        finally:
                            loop.thaw(run.process, reads_first=random.random() < 0.5)
                case "network":
                    self.world.network.cut(*ends)
                    await asyncio.sleep(seconds)
                    self.world.network.heal(*ends)
                case _:
                    await self.end_a_bridge(seconds)

    async def end_a_bridge(self, seconds: float) -> None:
        """End a bridge for so long. A robot's own bridge that is killed leaves the robot moving, as documented."""
        self.server.kill()
        await asyncio.sleep(seconds)
        self.server.start()

    def _run(self) -> Run | None:
        return self.random.choice((self.server, self.robot)).run

    # --- lives

    def play(self, life: Callable[[Drivers], Coroutine[Any, Any, None]] | None = None) -> None:
        with self.world.trouble("operators", *self.world.robots):
            if life is None:
                self.world.play(SECONDS, self.live())
            else:
                self.world.play(life=life(self))

    async def live(self) -> None:
        """Drive, and let happen what happens."""
        raise NotImplementedError

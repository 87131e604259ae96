"""Beds: worlds without faults, in which nothing happens but what a test makes happen."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec
from tests.simulation.conditions import STILL
from tests.simulation.ros import STRING, Writer, hash_of
from tests.simulation.world import World

from rsb_bridge.model.qos import Qos

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from tests.simulation.engine_host import EngineHost

    from rsb_bridge.link.link import Link
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import PatternSnapshot
    from rsb_bridge.route.route import Route

_LINKED_AFTER = 10.0


async def until(condition: Callable[[], object], within: float) -> None:
    async with asyncio.timeout(within):
        while not condition():  # noqa: ASYNC110 — plain state of a simulated world
            await asyncio.sleep(0.02)


class Bed:
    """A world in which a test lives that is a coroutine."""

    world: World

    async def begin(self) -> None:
        await asyncio.sleep(_LINKED_AFTER)

    async def live(self, life: Coroutine[None, None, None]) -> None:
        await self.begin()
        await life


class Yard(Bed):
    """A robot and a server, on which topics come and go.

    Args:
        listed: the topics of the robot's session.
        outlive: s that the link outlives its connection.
    """

    def __init__(self, *listed: Topic, outlive: float = 0.0) -> None:
        self.world = World(1, replace(STILL, topics=(0,), outlive=outlive))
        self.robot: EngineHost = self.world.robots[0].host
        self.server: EngineHost = self.world.server
        self.robot.session = msgspec.structs.replace(self.robot.session, topics=listed)
        self._name = self.world.robots[0].name

    def list_on_server(self, *topics: Topic) -> None:
        clients = tuple(
            msgspec.structs.replace(each, topics=topics if each.name == self._name else ())
            for each in self.server.session.accepted_clients
        )
        self.server.session = msgspec.structs.replace(self.server.session, clients=clients)

    def publish(self, *topics: str, on_server: bool = False) -> list[Writer]:
        domain = (self.server if on_server else self.robot).domain
        return [Writer(domain, "/program", topic, STRING, hash_of(STRING), Qos()) for topic in topics]

    def link(self, *, on_server: bool = False) -> Link:
        run = (self.server if on_server else self.robot).run
        assert run is not None
        return next(link for link in run.links() if link.name == self._name)

    def routes(self, *, on_server: bool = False) -> dict[str, Route]:
        return {route.spec.topic: route for route in self.link(on_server=on_server).routes.values()}

    def patterns(self) -> list[PatternSnapshot]:
        return list(self.link().snapshot().patterns)

    def codes(self, *, on_server: bool = False) -> list[str]:
        run = (self.server if on_server else self.robot).run
        assert run is not None
        return [event.code for event in run.events.after(0)]

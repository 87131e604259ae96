"""People at the consoles: they add, edit, pause and remove topics, restart, and shut links down, on both sides."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

import msgspec
from tests.simulation.faults import duration
from tests.simulation.sessions import some_topic

from rsb_bridge.api import EngineError
from rsb_bridge.link.server_end import ServerEnd
from rsb_bridge.model.commands import (
    AddTopic,
    EditTopic,
    PauseTopics,
    RemoveTopic,
    Restart,
    Retry,
    ShutDownLinks,
    Topics,
)

if TYPE_CHECKING:
    from collections.abc import Coroutine, Iterator
    from random import Random

    from tests.simulation.engine_host import Run
    from tests.simulation.world import Robot, World

    from rsb_bridge.link.link import Link
    from rsb_bridge.route.route import Route

_MOST_TOPICS = 8
_LOOKS = 40
"""How often, once a second, an operator looks whether a link is to be opened again; a robot asks every 24 to 36 s."""


class Operator:
    """Somebody who works on one robot's link, at either end.

    What they ask for may be refused, because somebody else was faster or the link is down: that is no fault.
    """

    def __init__(self, world: World, robot: Robot) -> None:
        self._world = world
        self._robot = robot
        self._random: Random = world.random(f"operator of {robot.name}")

    async def work(self, pause: float) -> None:
        """Do one thing after another, with a pause (s, on average) between them."""
        doings = {
            self._add: 3,
            self._edit: 3,
            self._pause: 6,
            self._pause_crossing: 2,
            self._remove: 2,
            self._retry: 1,
            self._restart: 1,
            self._shut_down: 1,
            self._list: 1,
        }
        while True:
            await asyncio.sleep(self._random.expovariate(1 / pause))
            (doing,) = self._random.choices(tuple(doings), tuple(doings.values()))
            await doing()

    # --- what they do

    async def _add(self) -> None:
        run = self._some_run()
        if run is None or len(self._routes(run)) >= _MOST_TOPICS:
            return
        gone = [
            flow for flow in self._robot.topic_flows if not any(r.topic == flow.near_name for r in self._routes(run))
        ]
        calls = [
            each for each in self._robot.service_flows if not any(r.topic == each.near_name for r in self._routes(run))
        ]
        if calls and self._random.random() < 0.5:
            topic = self._random.choice(calls).topic
        elif gone and self._random.random() < 0.7:
            topic = self._random.choice(gone).topic
        elif len(self._robot.topic_flows) < _MOST_TOPICS:
            topic = some_topic(self._robot.name, len(self._robot.topic_flows), self._random)
            flow = self._world.add_topic_flow(self._robot, topic, self._random)
            flow.listen()
            flow.appear()
        else:
            return
        await self._command("add", run, run.bridge.do(AddTopic(topic, self._robot.name)))

    async def _edit(self) -> None:
        """Put another topic in a route's place: the same one, carried in another way."""
        run, route = self._some_route()
        if run is not None and route is not None:
            changes = {
                "max_rate": self._random.choice((None, 1.0, 5.0)),
                "compression": self._random.choice((None, "zstd", "none")),
            }
            topic = msgspec.structs.replace(route.spec, **changes)
            await self._command("edit", run, run.bridge.do(EditTopic(route.key, topic)))
            self._world.forget_route(route)

    async def _pause(self) -> None:
        run, route = self._some_route()
        if run is not None and route is not None:
            await self._command("pause", run, run.bridge.do(PauseTopics(route.key, paused=not route.pausing.paused)))

    async def _pause_crossing(self) -> None:
        """Two people at both ends, at the same time."""
        run, route = self._some_route()
        other = self._world.server.run if run is self._robot.host.run else self._robot.host.run
        if run is None or route is None or other is None:
            return
        one, another = self._random.choice(((True, False), (False, True), (True, True), (False, False)))
        await asyncio.gather(
            self._command("pause", run, run.bridge.do(PauseTopics(route.key, paused=one))),
            self._command("pause", other, other.bridge.do(PauseTopics(route.key, paused=another))),
        )

    async def _remove(self) -> None:
        run, route = self._some_route()
        if run is not None and route is not None:
            await self._command("remove", run, run.bridge.do(RemoveTopic(route.key)))
            self._world.forget_route(route)

    async def _retry(self) -> None:
        run = self._some_run()
        if run is not None:
            await self._command("retry", run, run.bridge.do(Retry()))

    async def _list(self) -> None:
        run = self._some_run()
        if run is not None:
            await self._command("list", run, run.bridge.do(Topics(self._random.choice((None, self._robot.name)))))

    async def _restart(self) -> None:
        """Close the links and open them again."""
        run = self._some_run()
        if run is not None:
            robots = [self._robot] if run is self._robot.host.run else self._world.robots
            with self._world.trouble("restart", *robots, fault=False):
                await self._command("restart", run, run.bridge.do(Restart()))

    async def _shut_down(self) -> None:
        """Close the links until somebody wants them again."""
        run = self._some_run()
        if run is None:
            return
        robots = [self._robot] if run is self._robot.host.run else self._world.robots
        with self._world.trouble("shut down", *robots, fault=False):
            await self._command("shut down", run, run.bridge.do(ShutDownLinks()))
            await asyncio.sleep(duration(self._random))
            for _ in range(_LOOKS):  # one may learn of it later, over a bad network
                for host in (self._world.server, *(robot.host for robot in robots)):
                    if (shut := host.run) is not None and any(is_shut_down(link) for link in shut.links()):
                        await self._command("retry", shut, shut.bridge.do(Retry()))
                await asyncio.sleep(1.0)

    # --- how

    def _some_run(self) -> Run | None:
        return self._random.choice((self._robot.host.run, self._world.server.run))

    def _routes(self, run: Run) -> list[Route]:
        return [route for link in run.links() if link.name == self._robot.name for route in link.routes.values()]

    def _some_route(self) -> tuple[Run | None, Route | None]:
        run = self._some_run()
        routes = self._routes(run) if run is not None else []
        return (run, self._random.choice(routes)) if routes else (None, None)

    async def _command(self, what: str, run: Run, work: Coroutine[None, None, object]) -> None:
        world, robot = self._world, self._robot
        world.log.commands[what] += 1
        world.log.tell(f"{run.host.name}: the operator's command is {what}")
        robot.commanded = world.loop.time()
        with contextlib.suppress(EngineError):
            await run.command(work)
        robot.commanded = world.loop.time()


def is_shut_down(link: Link) -> bool:
    return link.end.shut_down or (isinstance(link.end, ServerEnd) and link.end.shut_down_by is not None)


def of(world: World) -> Iterator[Coroutine[None, None, None]]:
    pause = world.conditions.commands
    if pause:
        for robot in world.robots:
            yield Operator(world, robot).work(pause)

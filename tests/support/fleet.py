"""A server that plays a script, and its robots."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
from tests.console.scripted import LINK, NOW, ScriptedEngine, route

from rsb_bridge.model.commands import Command, EditTopic, R
from rsb_bridge.model.robot_summary import RobotState, RobotSummary
from rsb_bridge.model.session import Client, Session, Topic
from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future


GROUPS = ("hall", "yard", None)


def robot(name: str, state: RobotState = RobotState.OK, **changes: Any) -> RobotSummary:
    """A robot that is well, with `changes`."""
    well = RobotSummary(
        name=name, state=state, since=NOW - 100.0, seen=NOW, host="10.0.0.20:49152", version="0.1.0", links_up=1,
        links=1, flowing=3, routes=3, messages_from_robot=30.0, bytes_from_robot=300_000.0, bytes_to_robot=4_000.0,
    )  # fmt: skip
    return msgspec.structs.replace(well, **changes)


def topics(name: str, *specs: Topic) -> tuple[RouteSnapshot, ...]:
    """A robot's topics, as its server has them."""
    return tuple(
        route(f"/{name}{spec.topic}", key=f"{name} {spec.topic}", link=name, spec=spec, since=NOW - 5.0)
        for spec in specs
    )


class ServerEngine(ScriptedEngine):
    """A server of some robots, which all have a camera and a scan; edits change what it shows.

    Args:
        edited: called after an edit with the route; may give another one.
    """

    def __init__(self, *names: str, edited: Callable[[RouteSnapshot], RouteSnapshot] = lambda route: route) -> None:
        clients = tuple(Client(name, group=GROUPS[at % 3]) for at, name in enumerate(names))
        session = Session(
            name="control", role="server", server_ip="0.0.0.0", server_port=7060, use_name=True, clients=clients
        )
        super().__init__(session)
        self.edited = edited
        specs = Topic("/scan", "transmit"), Topic("/camera", "transmit")
        routes = tuple(each for name in names for each in topics(name, *specs))
        links = tuple(replace(LINK, name=name, since=NOW - 300.0) for name in names)
        self.now = Snapshot(NOW, "control", "server", "0.0.0.0:7060", 1, True, links, routes, 0)

    def do(self, command: Command[R], step: Any = None) -> Future[R]:
        if isinstance(command, EditTopic):
            key, topic = command.key, command.topic
            routes = (self.edited(replace(each, spec=topic)) if each.key == key else each for each in self.now.routes)
            self.now = replace(self.now, time=self.now.time + 1, routes=tuple(routes))
        return super().do(command, step)

    def link(self, name: str, **changes: Any) -> None:
        """Change a robot's link, and what its topics are with it."""
        links = tuple(replace(link, **changes) if link.name == name else link for link in self.now.links)
        self.now = replace(self.now, time=self.now.time + 1, links=links)

"""Helpers of `test_robot_summary` and others."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tests.console.scripted import LINK, NOW, route

from rsb_bridge.model.robot_summary import (
    RobotSummary,
    of_clients,
)
from rsb_bridge.model.session import Client, Session, Topic
from rsb_bridge.model.snapshot import (
    LinkSnapshot,
    RouteSnapshot,
    Snapshot,
    State,
)

SERVER = Session(
    name="control", role="server", server_ip="0.0.0.0", server_port=7060,
    clients=(Client("robot1", group="hall"), Client("robot2")),
)  # fmt: skip


UP = replace(LINK, state=State.OK, since=NOW - 100.0, reason="", cause="", warning="")


def on_server(*routes: RouteSnapshot, link: LinkSnapshot = UP, running: bool = True) -> RobotSummary:
    links = (link, replace(UP, name="robot2"))
    now = Snapshot(NOW, "control", "server", "0.0.0.0", 1, running=running, links=links, routes=routes)
    first, second = of_clients(now, SERVER, {}, {})
    assert (first.name, first.group, second.name, second.group) == ("robot1", "hall", "robot2", "")
    return first


def a(topic: str, state: State = State.OK, **changes: Any) -> RouteSnapshot:
    """A topic of robot1, as its server sees it."""
    spec = Topic(topic, "receive" if changes.get("outgoing") else "transmit")
    return route(f"/robot1{topic}", state, spec=spec, since=NOW - 5.0, **changes)

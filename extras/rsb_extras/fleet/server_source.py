"""The clients of a server as a fleet, seen through the server's control socket."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import msgspec

from rsb_bridge.control.summaries import Batteries
from rsb_bridge.feature_api import EngineError, RemoteEngine
from rsb_bridge.model.commands import Reload, Restart, ShutDownLinks, Stop
from rsb_bridge.model.robot_summary import LossWindow, of_clients

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from rsb_bridge.feature_api import Command, Event, RobotSummary, Snapshot
    from rsb_bridge.model.commands import R
    from rsb_bridge.model.robot_summary import LostMessages


_CONCERNS_ALL: Final[dict[type, str]] = {
    ShutDownLinks: "shutting down",
    Restart: "restarting",
    Reload: "reading the session file again",
    Stop: "stopping",
}
"""The commands that would also concern the other robots of a server, in words."""


class ServerFleet:
    """Fulfils `rsb_extras.fleet.fleet.FleetSource`: one robot for each client of a server."""

    kind = "server"
    way = ""
    empty = "add one on the server with `rsb-console client add NAME`."

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        self.gone = f"it is no longer a robot of {name}"
        self._path = path
        self._engine = RemoteEngine(path, read_only=True)
        self._losses = LossWindow()
        self._batteries = Batteries(self._engine)
        self._shown: Snapshot | None = None
        self._robots: list[RobotSummary] = []
        self._loss: dict[str, LostMessages] = {}

    @property
    def problem(self) -> str:
        return self._engine.unreachable

    def start(self) -> None:
        self._engine.start()

    def wait(self) -> None:
        """Return at once: the server knows all robots."""

    def stop(self) -> None:
        self._engine.stop()

    def robots(self) -> list[RobotSummary]:
        now = self._engine.snapshot()
        if now is not self._shown:
            self._shown = now
            if now.running:
                self._loss = self._losses.add(now)
                self._batteries.update(now)
            self._robots = of_clients(now, self._engine.session, self._loss, self._batteries.known)
        return self._robots

    def open(self, robot: str, *, read_only: bool) -> RemoteEngine:
        engine = RobotEngine(self._path, robot, read_only=read_only)
        engine.start()
        return engine


class RobotEngine(RemoteEngine):
    """A server's engine as far as it concerns one of its clients: the others are neither seen nor changed.

    Args:
        read_only: have the bridge refuse what would change anything.
    """

    def __init__(self, path: Path, robot: str, *, read_only: bool = False) -> None:
        super().__init__(path, read_only=read_only)
        self._robot = robot
        self._whole: Snapshot | None = None
        self._part: Snapshot

    def snapshot(self) -> Snapshot:
        whole = super().snapshot()
        if whole is not self._whole:
            self._whole, robot = whole, self._robot
            self._part = replace(
                whole,
                name=f"{robot} at {whole.name}",
                links=tuple(link for link in whole.links if link.name == robot),
                routes=tuple(route for route in whole.routes if route.link == robot),
            )
        return self._part

    def events(self, after: int = 0) -> list[Event]:
        return self._own(super().events(after))

    def wait_for_events(self, after: int, timeout: float) -> list[Event]:
        return self._own(super().wait_for_events(after, timeout))

    def remembered_events(self, timeout: float) -> list[Event]:
        return self._own(super().remembered_events(timeout))

    def _own(self, events: list[Event]) -> list[Event]:
        return [event for event in events if event.link in ("", self._robot)]

    def do(self, command: Command[R], step: Callable[[str], None] | None = None) -> Future[R]:
        if what := _CONCERNS_ALL.get(type(command)):
            return self._concerns_all(what)
        if command.is_of_links and command.link == "":  # type: ignore[attr-defined]  # it has one then; None is this side
            command = msgspec.structs.replace(command, link=self._robot)
        return super().do(command, step)

    def _concerns_all(self, what: str) -> Future[Any]:
        refused: Future[Any] = Future()
        server = self.bridge.name
        refused.set_exception(
            EngineError(f"{what} concerns all robots of {server}, not only {self._robot}: rsb-console attach {server}")
        )
        return refused

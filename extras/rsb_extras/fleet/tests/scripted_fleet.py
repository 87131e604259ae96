"""A fleet that plays a script."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import msgspec
from tests.console.scripted import NOW, ScriptedEngine

from rsb_bridge.api import EngineError
from rsb_extras.fleet.fleet import Memory, RobotFleet

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.robot_summary import RobotSummary
    from rsb_bridge.model.snapshot import Snapshot
    from rsb_extras.fleet.server_source import ServerFleet


class SetClock:
    """A wall clock that stands still."""

    def __init__(self, now: float = NOW) -> None:
        self.now = now

    def time_ns(self) -> int:
        return int(self.now * 1e9)


class ScriptedSource:
    """A `FleetSource` that gives what it was given."""

    def __init__(self, *robots: RobotSummary, name: str = "control") -> None:
        self.name, self.kind, self.problem = name, "server", ""
        self.way, self.gone, self.empty = "", f"gone from {name}", "add one"
        self.given = list(robots)
        self.engines: dict[str, ScriptedEngine] = {}
        self.began = self.ended = 0
        self.fails = ""

    def start(self) -> None:
        if self.fails:
            raise EngineError(self.fails)
        self.began += 1

    def wait(self) -> None:
        pass

    def stop(self) -> None:
        self.ended += 1

    def robots(self) -> list[RobotSummary]:
        return self.given

    def put(self, name: str, **changes: Any) -> None:
        self.given = [msgspec.structs.replace(each, **changes) if each.name == name else each for each in self.given]

    def open(self, robot: str, *, read_only: bool) -> RemoteEngine:
        if robot not in self.engines:
            raise EngineError(f"{robot} does not answer")
        return cast("RemoteEngine", self.engines[robot])


def fleet_of(*sources: ScriptedSource, path: Path | None = None, clock: SetClock | None = None) -> RobotFleet:
    return RobotFleet(sources, Memory(path), cast("Any", clock or SetClock()))


def state_of(source: ServerFleet) -> Snapshot:
    """Return the state of the server that a source has last heard."""
    return source._engine.snapshot()

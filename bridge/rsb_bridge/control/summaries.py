"""An engine in a few figures, worked out once for all consoles that watch it."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.control.batteries import Batteries
from rsb_bridge.model.robot_summary import LossWindow, RobotSummary, encode, of_engine

if TYPE_CHECKING:
    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.robot_summary import Loss

_EVERY = 1.0


class SummedUp(NamedTuple):
    """A summary.

    Attributes:
        data: as `rsb_bridge.model.robot_summary.encode` has it.
        state: what a change of is worth telling at once.
        time: s, when it was worked out.
    """

    data: bytes
    state: tuple[object, ...]
    time: float


class Summaries:
    """Works a summary out once a second at most, while somebody asks.

    Args:
        engine: whose.
        version: of this rsb-console.
    """

    def __init__(self, engine: EngineApi, version: str) -> None:
        self._engine = engine
        self._version = version
        self._host = socket.gethostname()
        self._losses = LossWindow()
        self._loss: dict[str, Loss] = {}
        self._batteries = Batteries(engine, of_own_robot=True)
        self._newest: SummedUp | None = None

    def take(self, now: float) -> SummedUp:
        """The newest summary; `now` is in s, on a clock that nobody sets."""
        if self._newest is None or now - self._newest.time >= _EVERY:
            summary = self._sum_up()
            state = (summary.state, summary.why, summary.links_up, summary.links, summary.routes)
            self._newest = SummedUp(encode(summary), state, now)
        return self._newest

    def _sum_up(self) -> RobotSummary:
        snapshot = self._engine.snapshot()
        if snapshot.running:
            self._loss = self._losses.take(snapshot)
            self._batteries.tick(snapshot)
        known = self._batteries.known.values()
        battery = min(known, key=lambda each: each.charge, default=None)
        return of_engine(
            snapshot, self._engine.session, host=self._host, version=self._version, losses=self._loss, battery=battery
        )

"""An engine in a few figures, for consoles that watch it."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

from rsb_bridge.control.batteries import Batteries
from rsb_bridge.model.robot_summary import LossWindow, encode, of_engine

if TYPE_CHECKING:
    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.robot_summary import Loss


class Summaries:
    """What a `rsb_bridge.control.server.ControlServer` calls to sum its engine up.

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

    def __call__(self) -> bytes:
        """The engine as it is now, as `rsb_bridge.model.robot_summary.encode` has it."""
        snapshot = self._engine.snapshot()
        if snapshot.running:
            self._loss = self._losses.take(snapshot)
            self._batteries.tick(snapshot)
        battery = min(self._batteries.known.values(), key=lambda each: each.charge, default=None)
        summary = of_engine(
            snapshot, self._engine.session, host=self._host, version=self._version, losses=self._loss, battery=battery
        )
        return encode(summary)

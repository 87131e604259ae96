"""The console on a scripted engine with many topics whose figures move: ``python -m bench.console_alone TOPICS``."""

from __future__ import annotations

import random
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tests.console.scripted import NOW, SESSION, ScriptedEngine, route

from rsb_console.app import ConsoleApp

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot

COUNT = int(sys.argv[1])
CHANGING = 0.3  # share of the topics in a refresh


class MovingEngine(ScriptedEngine):
    """Rates, ages and latencies change from one snapshot to the next, histories every second."""

    def snapshot(self) -> Snapshot:
        """The next moment."""
        elapsed = time.monotonic() - self.began
        routes = tuple(self._moved(each, int(elapsed)) for each in self.now.routes)
        self.now = replace(self.now, time=NOW + elapsed, routes=routes)
        return self.now

    def start(self) -> None:
        """Begin with as many topics as were asked for."""
        self.began, self.second = time.monotonic(), 0
        self.now = replace(self.now, routes=tuple(route(f"/robot{i % 3}/topic_{i:03d}") for i in range(COUNT)))

    def _moved(self, before: RouteSnapshot, second: int) -> RouteSnapshot:
        if random.random() > CHANGING:
            return before
        return replace(
            before,
            rate=random.gauss(10, 0.3),
            bytes_per_second=random.gauss(41e3, 500),
            latency_p50=random.gauss(3e-3, 2e-4),
            age=random.uniform(0, 0.1),
            history=(*before.history[1:], random.choice((9, 10, 11))) if second % 2 else before.history,
        )


ConsoleApp(SESSION, None, theme="dark", config=Path("/nonexistent"), make_engine=MovingEngine).run()

"""The console on a scripted engine with many rows whose figures move: ``python -m bench.console_alone N [calls]``."""

from __future__ import annotations

import random
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tests.console.scripted import GOALS, NOW, SESSION, ScriptedEngine, call_route, route

from rsb_console.app import ConsoleApp

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot

COUNT, WITH_CALLS = int(sys.argv[1]), "calls" in sys.argv
CHANGING = 0.3  # share of the topics in a refresh


class MovingEngine(ScriptedEngine):
    """Rates, ages and latencies change from one snapshot to the next, histories every second."""

    def snapshot(self) -> Snapshot:
        """Return the snapshot of the next moment."""
        elapsed = time.monotonic() - self.began
        routes = tuple(self._moved(each, int(elapsed)) for each in self.now.routes)
        self.now = replace(self.now, time=NOW + elapsed, routes=routes)
        return self.now

    def start(self) -> None:
        """Begin with as many rows as were asked for: with calls, of 25 rows five are services, and one is an action."""
        self.began, self.second = time.monotonic(), 0
        self.now = replace(self.now, routes=tuple(_row(i) for i in range(COUNT)))

    def _moved(self, before: RouteSnapshot, second: int) -> RouteSnapshot:
        if random.random() > CHANGING:
            return before
        if before.calls is not None:
            before = replace(
                before,
                calls=replace(
                    before.calls,
                    asked=before.calls.asked + 1,
                    answered=before.calls.answered + 1,
                    in_flight=random.randint(0, 3),
                    node_p50=random.gauss(5e-3, 2e-4),
                    way_p50=random.gauss(3e-3, 2e-4),
                ),
            )
        return replace(
            before,
            rate=random.gauss(10, 0.3),
            bytes_per_second=random.gauss(41e3, 500),
            latency_p50=random.gauss(3e-3, 2e-4),
            last_at=time.time() - random.uniform(0, 0.1),
            history=(*before.history[1:], random.choice((9, 10, 11))) if second % 2 else before.history,
        )


def _row(index: int) -> RouteSnapshot:
    name, number = f"/robot{index % 3}/row_{index:03d}", index % 25
    if not WITH_CALLS or number > 5:
        return route(name)
    if number:
        return call_route("service", name)
    return call_route("action", name, type_name="nav2_msgs/action/NavigateToPose", goals=GOALS)


# Without a configuration, the user's own settings do not count.
ConsoleApp(SESSION, None, theme="dark", config=Path("/nonexistent"), make_engine=MovingEngine).run()

"""Prints what a scrape of the metrics of a large fleet's server costs."""

from __future__ import annotations

import gc
import sys
import time
from dataclasses import replace

from tests.console.scripted import LINK, NOW, route

from rsb_bridge.model.clock import Clock
from rsb_bridge.model.snapshot import Snapshot
from rsb_bridge.telemetry.event_log import EventLog
from rsb_extras.exporters.metrics import application

LINKS = int(sys.argv[1]) if len(sys.argv) > 1 else 200
ROUTES = int(sys.argv[2]) if len(sys.argv) > 2 else 3
_SCRAPES = 15


def main() -> None:
    robots = [f"robot{number}" for number in range(LINKS)]
    routes = tuple(
        route(f"/{robot}/topic{number}", link=robot, key=f"{robot} {number}")
        for robot in robots
        for number in range(ROUTES)
    )
    links = tuple(replace(LINK, name=robot) for robot in robots)
    snapshot = Snapshot(NOW, "hub", "server", "0.0.0.0:7060", 1, running=True, links=links, routes=routes)
    app = application(lambda: snapshot, EventLog(Clock()))
    took, answer = [], b""
    gc.collect()
    for _ in range(_SCRAPES):
        began = time.process_time()
        answer = b"".join(app({"REQUEST_METHOD": "GET", "PATH_INFO": "/metrics"}, lambda *_: lambda _: None))
        took.append(time.process_time() - began)
    samples = sum(not line.startswith(b"#") for line in answer.splitlines())
    print(f"{LINKS} links, {len(routes)} routes: {samples:,} samples, {len(answer) / 1e6:.2f} MB")
    print(
        f"a scrape takes {sorted(took)[len(took) // 2] * 1e3:.0f} ms of CPU (median), {max(took) * 1e3:.0f} ms at most"
    )


if __name__ == "__main__":
    main()

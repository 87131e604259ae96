"""Prints what 24 hours of history cost: memory, time a second, an answer, and the file."""

from __future__ import annotations

import gc
import random
import sys
import tempfile
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Event, Ledger, Level, LinkSnapshot, RouteSnapshot, Snapshot, State
from rsb_extras.history import history_files
from rsb_extras.history.history_data import KEPT_FOR
from rsb_extras.history.timeline import Timeline

TOPICS = int(sys.argv[1]) if len(sys.argv) > 1 else 500
STEP = 5.0
HOURS = 25  # more than are kept, so that the oldest are forgotten, too
_LOOKS = 200
_MB = 1e6


def main() -> None:
    chance = random.Random(1)
    tracemalloc.start()
    routes = [_route(f"/robot{number // 50}/topic_{number:03d}") for number in range(TOPICS)]
    links = tuple(_link(f"robot{number}") for number in range(max(1, TOPICS // 50)))
    gc.collect()
    before = tracemalloc.get_traced_memory()[0]
    timeline = Timeline("bench", "server")
    now = 1.7e9
    while now < 1.7e9 + HOURS * 3600:
        now += STEP
        for index in chance.sample(range(TOPICS), TOPICS // 100 or 1):
            state = chance.choice([State.OK, State.OK, State.STALE, State.DOWN])
            words = (
                "" if state is State.OK else f"no message of {routes[index].topic} for {now % 1000:.1f} s " + "x" * 80
            )
            routes[index] = replace(routes[index], state=state, reason=words)
        snapshot = Snapshot(now, "bench", "server", "", 3, True, links, tuple(routes))
        timeline.observe(snapshot, now)
        timeline.did(Event(0, now, Level.INFO, EventCode.ROUTE_PAUSED, "an operator did it", who="anna"), now)
    gc.collect()
    used = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    print(
        f"{TOPICS} topics, {HOURS} h, {sum(len(each.outages) for each in timeline.save(now).subjects):,} outages kept"
    )
    began = time.perf_counter()
    for _ in range(_LOOKS):
        now += 1.0
        timeline.observe(snapshot, now)
    took = (time.perf_counter() - began) / _LOOKS
    print(f"memory {used / _MB:.1f} MB; taking note {took * 1e3:.2f} ms, once a second")
    for hours in (1, 8, 24):
        began = time.perf_counter()
        report = timeline.report(now, hours * 3600.0, running=True)
        print(f"an answer for {hours} h: {len(report.outages)} outages, {(time.perf_counter() - began) * 1e3:.0f} ms")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.history"
        began = time.perf_counter()
        history_files.write_history(path, timeline.save(now))
        saved = time.perf_counter() - began
        began = time.perf_counter()
        Timeline.restore(history_files.read_history(path), "bench", "server")
        restored = time.perf_counter() - began
        print(
            f"the file: {path.stat().st_size / _MB:.1f} MB, {saved * 1e3:.0f} ms to write, {restored * 1e3:.0f} to read"
        )
    assert now - 1.7e9 > KEPT_FOR


def _route(topic: str) -> RouteSnapshot:
    return RouteSnapshot(
        key=topic, link=topic.split("/")[1], topic=topic, remote_topic=topic, outgoing=False,
        spec=Topic(topic, "receive"), state=State.OK, reason="", type_name="", type_hash="", qos=None,
        publisher_qos=None, subscriber_qos=None, transport="tcp", port=1, stages=(), ledger=Ledger(delivered=1),
        rate=1.0, expected_rate=None, bytes_per_second=1.0, bytes_total=1, latency_p50=None, latency_p99=None,
        latency_uncertainty=None, jitter=None, last_at=None, history=(), last_error="",
    )  # fmt: skip


def _link(name: str) -> LinkSnapshot:
    return LinkSnapshot(
        name=name, peer="", state=State.OK, reason="", since=0.0, retry_in=None, attempts=0, encrypted=True, cipher="",
        fingerprint="", rtt=None, clock_offset=None, clock_uncertainty=None, rx_bytes_per_second=1.0,
        tx_bytes_per_second=1.0, peer_version="", peer_domain=None,
    )  # fmt: skip


if __name__ == "__main__":
    main()

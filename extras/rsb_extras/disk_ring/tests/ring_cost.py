"""Prints what the ring on disk costs at a rate: the bridge a message, its own thread, and the disk."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import time
from pathlib import Path
from random import Random

from rsb_bridge.model.clock import Clock
from rsb_bridge.telemetry.event_log import EventLog
from rsb_extras.disk_ring.ring_files import RingClocks, RingPlace
from rsb_extras.disk_ring.ring_writer import RingWriter
from rsb_extras.disk_ring.tests.ring_bed import CHAT, recorded
from rsb_extras.recording import RecordLimits
from rsb_extras.recording.message_ring import RingMessage

_SECONDS = 20.0


def _cpu(thread: threading.Thread) -> float:
    """Return s of processor time of a thread."""
    fields = Path(f"/proc/self/task/{thread.native_id}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _measure(rate: float, size: int, folder: Path) -> str:
    limits = RecordLimits(disk=2.0, free=0.0)
    place, clocks = RingPlace(folder, "robot1", "client"), RingClocks(time.monotonic, time.time)
    writer = RingWriter(place, limits, clocks, EventLog(Clock()), lambda _: None)
    writer.described(CHAT, recorded(CHAT))
    writer.start()
    (thread,) = (each for each in threading.enumerate() if each.name == "rsb-ring")
    kinds = min(int(rate * _SECONDS), 48_000_000 // size)  # as many as memory has room for
    contents = [Random(number).randbytes(size // 2) + bytes(size - size // 2) for number in range(kinds)]
    took = 0.0
    count = int(rate * _SECONDS)
    began = time.monotonic()
    for number in range(count):
        now = time.time_ns()
        message = RingMessage(time.monotonic(), CHAT, contents[number % kinds], now, now, number, b"one")
        before = time.perf_counter()
        writer.put(message)
        took += time.perf_counter() - before
        time.sleep(max(0.0, began + (number + 1) / rate - time.monotonic()))
    seconds = time.monotonic() - began
    cpu = _cpu(thread)
    held = sum(each.stat().st_size for each in folder.rglob("*.mcap"))
    writer.stop()
    writer.join()
    return (
        f"{rate:g} Hz of {size:,} bytes, {seconds:.0f} s: {took / count * 1e6:.1f} µs a message for the bridge, thread "
        f"{cpu / count * 1e6:.0f} µs a message, {cpu / seconds:.1%} of a core; {held / 1e6:.1f} MB on disk of "
        f"{count * size / 1e6:.0f}; {writer.lost} lost"
    )


def main() -> None:
    where = sys.argv[1] if len(sys.argv) > 1 else None
    for rate, size in ((1000.0, 500), (30.0, 6_000_000)):
        with tempfile.TemporaryDirectory(dir=where) as folder:
            print(_measure(rate, size, Path(folder)))


if __name__ == "__main__":
    main()

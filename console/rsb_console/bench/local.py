"""On this machine: two bridges between two ROS domains, over loopback."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.control.control_sockets import ControlError
from rsb_bridge.control.remote_engine import RemoteEngine
from rsb_bridge.model.snapshot import State
from rsb_console.bench import beds
from rsb_console.bench.ends import BenchError, Way
from rsb_console.bench.processes import Process
from rsb_console.bench.results import Many

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from rsb_bridge.model.snapshot import Snapshot
    from rsb_console.bench.ends import Ends

_OPENED_WITHIN = 60.0
_WATCHED_FOR = 3.0
_LOOK_EVERY = 0.1


class Loopback:
    """Two domains of this machine.

    Args:
        transports: to measure.
        domains: which; nobody else should be in them.
    """

    def __init__(self, transports: tuple[str, ...], domains: tuple[int, int]) -> None:
        self._transports = transports
        self._near, self._far = domains

    @property
    def ways(self) -> list[Way]:
        return [Way(transport, "transmit") for transport in self._transports]

    def baseline(self, sizes: list[int]) -> AbstractContextManager[Ends]:
        return beds.direct(self._near, sizes)

    def open(self, way: Way, sizes: list[int]) -> AbstractContextManager[Ends]:
        return beds.bridged(way.transport, self._near, self._far, sizes)

    def many(self, count: int) -> Many:
        prefix = f"{beds.TOPIC}_{os.getpid()}/topic_"
        entries = [
            f"  - {{topic: {prefix}{number:03d}, direction: transmit, type: std_msgs/msg/String}}"
            for number in range(count)
        ]
        with contextlib.ExitStack() as resources:
            folder = Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="rsb-bench-")))
            port = beds.write_sessions(folder, self._near, self._far, entries)
            resources.enter_context(Process("-m", beds.TRAFFIC, "many", str(self._near), prefix, str(count)))
            receiving = resources.enter_context(beds.headless(folder / "server.yaml"))
            beds.listening(receiving, port)
            began = time.monotonic()
            sending = resources.enter_context(beds.headless(folder / "client.yaml"))
            opened = _all_carry(sending, folder / "client.sock", count, began)
            between, watched = (sending, receiving), time.monotonic()
            before = [process.cpu() for process in between]
            time.sleep(_WATCHED_FOR)
            passed = time.monotonic() - watched
            cpu = [100 * (process.cpu() - then) / passed for process, then in zip(between, before, strict=True)]
            return Many(count, opened, (sending.memory(), receiving.memory()), (cpu[0], cpu[1]))


def _all_carry(bridge: Process, socket: Path, count: int, began: float) -> float:
    """Wait until so many topics of a bridge carry messages; s since it was started."""
    deadline = began + _OPENED_WITHIN
    engine: RemoteEngine | None = None
    try:
        while time.monotonic() < deadline and bridge.running:
            if engine is None:
                engine = _attached(socket)
            elif _carrying(engine.snapshot()) >= count:
                return time.monotonic() - began
            time.sleep(_LOOK_EVERY)
    finally:
        if engine is not None:
            engine.stop()
    raise BenchError(f"{count} topics are not open within {_OPENED_WITHIN:.0f} s")


def _carrying(snapshot: Snapshot) -> int:
    return sum(1 for route in snapshot.routes if route.ledger.delivered and route.state is State.OK)


def _attached(socket: Path) -> RemoteEngine | None:
    engine = RemoteEngine(socket, read_only=True)
    try:
        engine.start()
    except (ControlError, EngineError):
        return None  # it has only just been started
    return engine


def machine() -> str:
    """The processor, its cores and Python's version."""
    name = ""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return f"{name or os.uname().machine}, {os.cpu_count()} cores"


def ros_problem() -> str:
    """Why no ROS node can run here; empty: it can."""
    found = subprocess.run([sys.executable, "-c", "import rclpy, std_msgs.msg"], capture_output=True, check=False)
    return "" if found.returncode == 0 else "no ROS here: source its setup file, or install rsb-console[ros]"

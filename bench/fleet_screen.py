"""Prints what the fleet's screen costs over Zenoh: ``python -m bench.fleet_screen --robots 200``, two minutes.

Engines, their keys and sealed connections, the router and the console in a pseudo-terminal are real; the robots' ROS is
a stand-in, many in a process. All of it shares this machine, and so does the control side that they are linked with.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from bench.console import Watched

from rsb_bridge.cdr.known_types import BATTERY_STATE
from rsb_console.command.shell import allow_many_descriptors
from rsb_extras.demo.stand_in import Talk
from rsb_extras.fleet.robots import RobotTraffic
from rsb_extras.fleet.simulated_fleet import SimulatedFleet, fleet, listening
from rsb_extras.operators.fleet_file import load_fleet
from rsb_extras.operators.zenoh_source import ZenohFleet

if TYPE_CHECKING:
    from rsb_extras.demo.processes import Process

DOMAIN = 98
LOAD = RobotTraffic((Talk("/pose", 1.0, 200), Talk("/battery_state", 0.2, 0, BATTERY_STATE)), ())
WITHIN = 240.0
_LOOK_EVERY = 0.02


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=200, help="%(default)s")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each measurement (%(default)s)")
    parser.add_argument("--domain", type=int, default=DOMAIN, help="the control side's (%(default)s)")
    arguments = parser.parse_args()
    allow_many_descriptors()
    names = [f"robot{number}" for number in range(1, arguments.robots + 1)]
    with (
        tempfile.TemporaryDirectory(prefix="rsb-fleet-") as folder,
        fleet(Path(folder), names, domain=arguments.domain, over="zenoh", load=LOAD, operated=True) as running,
    ):
        listening(running.start_control(), running.session)
        running.start_robots(running.names)
        running.wait(lambda robot: len(robot.open) >= len(LOAD.talks), WITHIN)
        measure(running, arguments.seconds)


def measure(running: SimulatedFleet, seconds: float) -> None:
    """Print all figures of a fleet that runs."""
    count = len(running.names)
    engines = count + 1  # the control side announces itself, too
    time.sleep(seconds / 2)
    alone = _cpu(running, seconds)
    known, spoken, used = _spoken(running, engines)
    print(f"{engines} engines: known after {known:.2f} s, all have spoken after {spoken:.2f} s, {used:.2f} s of a core")
    assert running.file is not None
    console = Watched("-m", "rsb_console", "fleet", "--fleet", str(running.file), environ={})
    try:
        painted = console.until(lambda: b"Robots" in console.terminal.output, WITHIN)
        whole = console.until(lambda: f" {engines} robots".encode() in console.terminal.output, WITHIN)
        time.sleep(seconds / 2)
        began, cpu, written, wire = time.monotonic(), console.cpu(), console.written, _wire(console.pid)
        watched = _cpu(running, seconds)
        passed = time.monotonic() - began
        used, drawn = (console.cpu() - cpu) / passed, (console.written - written) / passed
        received, sent = ((after - before) / passed for before, after in zip(wire, _wire(console.pid), strict=True))
    finally:
        console.stop()
    print(f"first paint after {painted:.2f} s, all rows {whole:.2f} s later; at 2 Hz:")
    print(f"  {100 * used:.1f} % of a core, {drawn / 1e3:.1f} kB/s to the terminal")
    print(f"  {received / 1e3:.1f} kB/s from the network, {received / engines:.0f} B/s an engine; {sent:.0f} B/s to it")
    cost = (watched - alone) / count
    print(f"an engine: {100 * alone / count:.2f} % of a core unwatched, {100 * cost:+.2f} % watched")


def _spoken(running: SimulatedFleet, engines: int) -> tuple[float, float, float]:
    """Measure the seconds until a console lists all engines and until each has reported, and the processor time."""
    assert running.file is not None
    began, cpu, known = time.monotonic(), time.process_time(), 0.0
    source = ZenohFleet(load_fleet(running.file))
    starting = threading.Thread(target=source.start)
    starting.start()
    try:
        while True:
            robots, passed = source.robots(), time.monotonic() - began
            if len(robots) == engines:
                known = known or passed
                if all(robot.seen is not None for robot in robots):
                    return known, passed, time.process_time() - cpu
            if passed > WITHIN:
                raise SystemExit(f"{len(robots)} of {engines} engines are known")
            time.sleep(_LOOK_EVERY)
    finally:
        starting.join()
        source.stop()


def _cpu(running: SimulatedFleet, seconds: float) -> float:
    """Processor s per s of all robots, for a while."""
    began, cpu = time.monotonic(), _sum(running.processes)
    time.sleep(seconds)
    return (_sum(running.processes) - cpu) / (time.monotonic() - began)


def _sum(processes: list[Process]) -> float:
    return sum(process.cpu() for process in processes)


def _wire(pid: int) -> tuple[int, int]:
    """Return the bytes that the TCP connections of a process have received and sent (ss(8), TCP_INFO)."""
    lines = subprocess.run(("ss", "-HtnpiO"), capture_output=True, text=True, check=True).stdout.splitlines()
    own = [line for line in lines if f"pid={pid}," in line]
    received, sent = (
        sum(int(found[1]) for line in own if (found := re.search(rf"{what}:(\d+)", line)))
        for what in ("bytes_received", "bytes_sent")
    )
    return received, sent


if __name__ == "__main__":
    main()

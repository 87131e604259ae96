"""Prints what a fleet costs one control side: ``python -m bench.fleet --robots 10,50,200``, a minute and a half each.

The control side is `rsb-console run` with real ROS (rclpy, Fast DDS), and so are the node that publishes a goal a
second for each robot, and the one that listens to one robot's pose. **The robots' ROS is a stand-in**, many robots in
a process: their bridges, keys, sockets and messages are real, their DDS is not there. All of it shares this machine.
"""

from __future__ import annotations

import argparse
import signal
import statistics
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from bench import bed

from rsb_bridge.config import session_file
from rsb_bridge.control.remote_engine import attach
from rsb_console.command.shell import allow_many_descriptors
from rsb_extras.bench import loopback
from rsb_extras.demo import processes
from rsb_extras.demo.processes import ProcessError
from rsb_extras.demo.stand_in import Talk
from rsb_extras.fleet.robots import RobotTraffic
from rsb_extras.fleet.simulated_fleet import USUAL, WAYS, SimulatedFleet, fleet, listening
from rsb_extras.zenoh import ZENOH

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.model.snapshot import Snapshot
    from rsb_extras.demo.processes import Process

DOMAIN = 96
_WITHIN = 120.0
_BIN = 0.1


@dataclass(frozen=True, slots=True)
class Plan:
    """Durations of the measurement, in s.

    Attributes:
        settles: wait after everything is open.
        watched: duration of each measurement.
        down: time between the death of the control side and its next start.
    """

    settles: float = 8.0
    watched: float = 20.0
    down: float = 5.0


@dataclass(frozen=True, slots=True)
class Delays:
    """s until a robot was so far: half of them, and the last one."""

    half: float
    last: float

    @classmethod
    def of(cls, times: Iterable[float], since: float) -> Delays:
        found = sorted(each - since for each in times)
        return cls(statistics.median(found), found[-1])


@dataclass(frozen=True, slots=True)
class Steady:
    """Figures while messages flow.

    Attributes:
        control: processor s per s of the control side; `robots` of all robots together.
        rate: messages a second that the robots published.
        p50, p99: ms from one robot's node to a node on the control side.
        heard: received share of the messages that the robot should have published in the time.
        lost: messages of all robots except the flooding one, by cause, as the control side counts them.
    """

    control: float
    robots: float
    rate: float
    p50: float
    p99: float
    heard: float
    lost: Counter[str]


@dataclass(slots=True)
class Figures:
    """The figures of one fleet.

    Attributes:
        routes: number of all routes.
        linked, flowing: s since the robots' processes were started.
        steady: figures with the usual load.
        resident, proportional: MB of the control side; `robot` MB of a robot's side.
        again, again_flowing: s since the control side listened again.
        routed: s from the Zenoh router's next start until all were linked again, or None without a router.
        attempts: attempts to link, in bins of 100 ms from the death of the control side.
        refused: number of attempts that the control side refused.
        dropped: links that were made again more than once.
        flooded: figures while one robot sends as fast as it can.
        flood: messages a second that it published.
        told: states of the flooding robot's topics on the control side.
    """

    count: int
    routes: int
    linked: Delays
    flowing: Delays
    steady: Steady
    resident: float
    proportional: float
    robot: float
    again: Delays
    again_flowing: Delays
    routed: Delays | None
    attempts: list[int]
    refused: int
    dropped: list[str]
    flooded: Steady
    flood: float
    told: list[str] = field(default_factory=list)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.fleet", description=__doc__)
    parser.add_argument("--robots", default="10,50,200", help="how many, of each fleet (%(default)s)")
    parser.add_argument("--over", choices=tuple(WAYS), default="tcp", help="what the links go over (%(default)s)")
    parser.add_argument("--domain", type=int, default=DOMAIN, help="ROS domain of the control side (%(default)s)")
    parser.add_argument("--pose", type=float, default=10.0, help="Hz of 200 bytes (%(default)s)")
    parser.add_argument("--scan", type=float, default=5.0, help="Hz of 2,500 bytes (%(default)s)")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that what runs is ended first
    allow_many_descriptors()
    status, *_rest = (talk for talk in USUAL.talks if talk.topic == "/status")
    load = RobotTraffic((Talk("/pose", arguments.pose, 200), status, Talk("/scan", arguments.scan, 2500)), USUAL.hears)
    print(f"robots' ROS is a stand-in; each sends {', '.join(map(_described, load.talks))}, and hears /goal at 1 Hz")
    found = []
    for count in map(int, arguments.robots.split(",")):
        found.append(measure(count, over=arguments.over, domain=arguments.domain, load=load))
        _print_one(found[-1])
    _print_all(found)


def measure(
    count: int, *, over: str = "tcp", domain: int = DOMAIN, load: RobotTraffic = USUAL, plan: Plan | None = None
) -> Figures:
    """Run one fleet: start it, watch it, kill and start the control side, and have one robot flood."""
    plan = plan or Plan()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rsb-fleet-")))
        names = [f"robot{number:03d}" for number in range(count)]  # as `many` below has them
        running = stack.enter_context(fleet(folder, names, domain=domain, over=over, load=load))
        heard, flooding = running.names[0], running.names[-1]
        listener = stack.enter_context(bed.Process("-m", loopback.TRAFFIC, "listen", str(domain), f"/{heard}/pose"))
        stack.enter_context(bed.Process("-m", loopback.TRAFFIC, "many", str(domain), "/robot", str(count), "/goal"))
        control = running.start_control()
        listening(control, running.session)
        began = time.time()
        # These two share no interpreter with others, as on machines of their own.
        for alone in dict.fromkeys((heard, flooding)):
            running.start_robots([alone])
        running.start_robots(running.names[1:-1])
        robots = running.wait(lambda robot: len(robot.open) >= load.routes, _WITHIN)
        linked = Delays.of((robot.up[-1] for robot in robots.values()), began)
        flowing = Delays.of((max(robot.open) for robot in robots.values()), began)
        _wait_until_heard(listener)
        time.sleep(plan.settles)
        steady = _watch(running, control, listener, plan.watched)
        resident, proportional = control.memory(), _proportional(control.pid)
        a_robot = sum(_proportional(process.pid) for process in running.processes) / count
        control.signal(signal.SIGKILL)
        killed = time.time()
        control.stop()
        time.sleep(plan.down)
        control = running.start_control()
        returned = listening(control, running.session)
        # Each route was open once before the control side was killed, and a third time comes after the router.
        robots = running.wait(lambda robot: len(robot.open) >= 2 * load.routes, _WITHIN)
        again = Delays.of((robot.up[-1] for robot in robots.values()), returned)
        again_flowing = Delays.of((max(robot.open) for robot in robots.values()), returned)
        tried = [each for robot in robots.values() for each in (*robot.attempts, robot.up[-1]) if each > killed]
        refused = sum(robot.refused for robot in robots.values())
        dropped = [
            f"{name} at {', '.join(f'{each - returned:.1f}' for each in ups)} s"
            for name, robot in robots.items()
            if len(ups := [each for each in robot.up if each > killed]) > 1
        ]
        routed = _without_router(running, plan.down, stack) if running.router is not None else None
        _wait_until_heard(listener)
        time.sleep(plan.settles)
        before, since = running.records()[flooding].published, time.monotonic()
        running.tell(flooding, "flood", "/scan", "2500")
        flooded = _watch(running, control, listener, plan.watched)
        flood = (running.records()[flooding].published - before) / (time.monotonic() - since)
        return Figures(
            count,
            count * load.routes,
            linked,
            flowing,
            steady,
            resident,
            proportional,
            a_robot,
            again,
            again_flowing,
            routed,
            _bins(tried, killed),
            refused,
            dropped,
            flooded,
            flood,
            _told(running, flooding),
        )


def _without_router(running: SimulatedFleet, down: float, stack: ExitStack) -> Delays:
    """Kill the router, and start it again: until when all are linked, and all routes open."""
    network = ZENOH.of(session_file.load(running.session))
    assert network is not None
    assert running.router is not None
    running.router.signal(signal.SIGKILL)
    running.router.stop()
    time.sleep(down)
    stack.enter_context(processes.router(network.connect[0]))
    returned, routes = time.time(), running.load.routes
    robots = running.wait(lambda robot: len(robot.open) >= 3 * routes, _WITHIN)
    return Delays.of((robot.up[-1] for robot in robots.values()), returned)


def _wait_until_heard(listener: Process) -> None:
    """Wait until messages made from now on reach the listener."""
    deadline = time.monotonic() + _WITHIN
    listener.ask("reset")
    while not listener.ask("count")["count"]:
        if time.monotonic() > deadline:
            raise ProcessError("nothing reaches the listener: is the domain free, and ROS set up?")
        time.sleep(_BIN)


def _watch(running: SimulatedFleet, control: Process, listener: Process, seconds: float) -> Steady:
    others = running.names[:-1]
    rate = next(talk.rate for talk in running.load.talks if talk.topic == "/pose")
    lost, before = _lost(running, others), running.records()
    listener.ask("reset")
    began, cpu = time.monotonic(), control.cpu()
    cpu_of_robots = sum(process.cpu() for process in running.processes)
    time.sleep(seconds)
    passed = time.monotonic() - began
    used = control.cpu() - cpu
    used_by_robots = sum(process.cpu() for process in running.processes) - cpu_of_robots
    report, after = listener.ask("report"), running.records()
    published = sum(after[name].published - before[name].published for name in others)
    return Steady(
        used / passed,
        used_by_robots / passed,
        published / passed,
        report["p50"] / 1e6,
        report["p99"] / 1e6,
        report["count"] / (rate * passed),
        _lost(running, others) - lost,
    )


def _snapshot(running: SimulatedFleet) -> Snapshot:
    with attach(running.socket, read_only=True) as engine:
        return engine.snapshot()


def _lost(running: SimulatedFleet, names: Sequence[str]) -> Counter[str]:
    """Messages of robots that were lost, by cause."""
    lost: Counter[str] = Counter()
    for route in _snapshot(running).routes:
        if route.link in names and not route.outgoing:
            ledger = route.ledger
            lost.update({**ledger.dropped, "expired": ledger.expired, "lost in DDS": ledger.lost_in_dds})
    return lost


def _told(running: SimulatedFleet, name: str) -> list[str]:
    """Return the states of a robot's topics as the control side's operator sees them."""
    seen = _snapshot(running)
    return [
        f"{route.topic} {route.state.value} {route.rate:.0f} Hz {route.reason} {dict(route.ledger.dropped)}"
        for route in seen.routes
        if route.link == name and not route.outgoing
    ]


def _bins(times: Sequence[float], since: float) -> list[int]:
    found = Counter(int((each - since) / _BIN) for each in times)
    return [found[number] for number in range(max(found, default=-1) + 1)]


def _proportional(pid: int) -> float:
    """Memory in MB; what processes share counts for each in part (PSS)."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1000


def _described(talk: Talk) -> str:
    return f"{talk.topic} of {talk.size:,} bytes at {talk.rate:g} Hz"


def _print_one(figures: Figures) -> None:
    print(f"\n{figures.count} robots, {figures.routes} routes")
    print(f"attempts to link per 100 ms from the death of the control side: {' '.join(map(str, figures.attempts))}")
    print(f"linked more than once after that: {'; '.join(figures.dropped) or 'none'}")
    if figures.routed is not None:
        half, last = figures.routed.half, figures.routed.last
        print(f"router killed and back: linked again after {half:.1f} s (half of them), {last:.1f} s (the last)")
    print(f"refused: {figures.refused}; the robot that floods publishes {figures.flood:,.0f} msg/s:")
    for line in figures.told:
        print(f"  {line}")
    sys.stdout.flush()


def _print_all(found: Sequence[Figures]) -> None:
    _table(
        "robots, routes, linked p50, last, flowing p50, last, again p50, last, flowing last, most attempts/100 ms",
        [
            (
                each.count,
                each.routes,
                *(f"{s:.1f}" for delay in (each.linked, each.flowing, each.again) for s in (delay.half, delay.last)),
                f"{each.again_flowing.last:.1f}",
                max(each.attempts),
            )
            for each in found
        ],
    )
    _table(
        "robots, msg/s, control CPU %, of it a robot, a robot's side CPU %, control RSS MB, PSS MB, a robot's PSS MB",
        [
            (
                each.count,
                f"{each.steady.rate:,.0f}",
                f"{100 * each.steady.control:.1f}",
                f"{100 * each.steady.control / each.count:.2f}",
                f"{100 * each.steady.robots / each.count:.2f}",
                f"{each.resident:.0f}",
                f"{each.proportional:.0f}",
                f"{each.robot:.2f}",
            )
            for each in found
        ],
    )
    for few, many in pairwise(found):
        more = many.count - few.count
        cpu = 100 * (many.steady.control - few.steady.control) / more
        memory = (many.resident - few.resident) / more
        print(f"from {few.count} to {many.count} robots, each one more: {cpu:.2f} % CPU, {memory:.2f} MB RSS")
    both = ", ".join(f"{of} p50 ms, p99, heard %, others' lost" for of in ("steady", "flood"))
    _table(f"robots, {both}", [(each.count, *_latency(each.steady), *_latency(each.flooded)) for each in found])


def _latency(steady: Steady) -> tuple[str, ...]:
    lost = ", ".join(f"{count:,} {cause}" for cause, count in steady.lost.items()) or "0"
    return f"{steady.p50:.2f}", f"{steady.p99:.1f}", f"{100 * steady.heard:.0f}", lost


def _table(head: str, rows: Sequence[Sequence[object]]) -> None:
    cells = head.split(", ")
    print(f"\n| {' | '.join(cells)} |\n|{'---|' * len(cells)}")
    for row in rows:
        print(f"| {' | '.join(map(str, row))} |")


if __name__ == "__main__":
    main()

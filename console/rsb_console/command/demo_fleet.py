"""``rsb-console demo --fleet``: simulated robots and one control side on this machine, for the fleet's screens."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.control.client import RemoteEngine
from rsb_bridge.control.folders import ControlError
from rsb_bridge.model.snapshot import State
from rsb_console.bench.ends import BenchError
from rsb_console.bench.fleet import fleet, listening
from rsb_console.command.headless import Signals
from rsb_console.command.shell import FAILURE, INTERRUPTED, OK, print_error, print_line
from rsb_console.session.demo import need_ros, own_domain

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import Snapshot
    from rsb_console.bench.fleet import Fleet

_OPEN_WITHIN, _SEEN_WITHIN = 60.0, 10.0
_AFTER = 5.0
"""s until the first trouble."""
_AWAY, _THERE = 10.0, 20.0
"""s for which the robot that comes and goes is away, and there."""
_LOOK_EVERY = 0.2
_FAULTY = "/scan"


def run_fleet_demo(robots: int, *, ui: bool, seconds: float | None) -> int:
    """Run a fleet until a signal, or for a while.

    Args:
        robots: how many.
        ui: only say how to look at it; else print a summary at the end, too.
        seconds: s to run once all robots are linked; None: until a signal.

    Returns:
        The exit code: 0 only if each robot was linked and its topics were open.
    """
    try:
        need_ros()
        with (
            Signals(ignore_hangup=False, has_terminal=True) as signals,
            tempfile.TemporaryDirectory(prefix="rsb-fleet-") as folder,
            fleet(Path(folder), robots, domain=own_domain()) as running,
        ):
            return _run(running, signals, ui=ui, seconds=seconds)
    except (BenchError, ControlError, EngineError) as error:
        print_error(str(error))
        return FAILURE


def _run(running: Fleet, signals: Signals, *, ui: bool, seconds: float | None) -> int:
    control = running.start_control()
    listening(control, running.session)
    running.start_robots(running.names)
    sends = len(running.load.talks)  # nobody publishes the goals that they could receive
    running.wait(lambda robot: len(robot.open) >= sends or bool(signals.caught), _OPEN_WITHIN)
    if signals.caught:
        return INTERRUPTED
    faulty, restless = running.names[min(1, len(running.names) - 1)], running.names[-1]
    _say(running, faulty, restless)
    ends = None if seconds is None else time.monotonic() + seconds
    _trouble(running, signals, faulty, restless, ends)
    if not ui:
        _print_summary(_seen(running))
    return OK


def _say(running: Fleet, faulty: str, restless: str) -> None:
    count = len(running.names)
    print_line(
        f"{count} simulated robots and a control side are linked; the robots' ROS is a stand-in, in {count} graphs"
    )
    print_line(f"{faulty} stops publishing {_FAULTY} after {_AFTER:.0f} s; {restless} comes and goes")
    print_line(f"to look at them: rsb-console attach --control {running.socket}")
    print_line("Ctrl-C ends them all")
    sys.stdout.flush()


def _trouble(running: Fleet, signals: Signals, faulty: str, restless: str, ends: float | None) -> None:
    """Have something to see until a signal or the end comes."""
    due = [
        (time.monotonic() + _AFTER, faulty, ("mute", _FAULTY)),
        (time.monotonic() + _THERE, restless, ("stop",)),
    ]
    while not signals.caught and (ends is None or time.monotonic() < ends):
        now = time.monotonic()
        for at, name, words in [each for each in due if each[0] <= now]:
            due.remove((at, name, words))
            running.tell(name, *words)
            match words:
                case ("stop",):
                    due.append((now + _AWAY, name, ("start",)))
                case ("start",):
                    due.append((now + _THERE, name, ("stop",)))
        time.sleep(_LOOK_EVERY)


def _seen(running: Fleet) -> Snapshot:
    """What the control side sees now, which it renews once a second."""
    engine, asked = RemoteEngine(running.socket, read_only=True), time.time()
    engine.start()
    try:
        ends = time.monotonic() + _SEEN_WITHIN
        while (seen := engine.snapshot()).time < asked and time.monotonic() < ends:
            time.sleep(_LOOK_EVERY)
        return seen
    finally:
        engine.stop()


def _print_summary(seen: Snapshot) -> None:
    """One line a robot: its link, how many of its topics flow, and the worst that is not well."""
    for link in seen.links:
        routes = [route for route in seen.routes if route.link == link.name]
        flowing = sum(route.state.flows for route in routes)
        worst = min(routes, key=lambda route: route.state.rank, default=None)
        why = link.reason or ("" if worst is None or worst.state is State.OK else worst.reason)
        print_line(f"{link.name:<10} {link.state:<8} {flowing} of {len(routes)} topics flow  {why}".rstrip())

"""`rsb-console demo --fleet`: several simulated robots on this machine, on the fleet's screen or headless."""

from __future__ import annotations

import contextlib
import importlib.util
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Clock, EngineError, RobotState, State
from rsb_console.command.headless import Signals
from rsb_console.command.local_commands import can_draw
from rsb_console.command.shell import HUNG_UP, allow_many_descriptors
from rsb_console.command.ways import ways
from rsb_console.feature_console import FAILURE, INTERRUPTED, OK, USAGE, print_error, print_line
from rsb_extras.demo.demo_command import HOW_TO_END
from rsb_extras.demo.demo_session import SimulatedPart, need_ros, own_domain
from rsb_extras.demo.processes import ProcessError
from rsb_extras.fleet.fleet import Memory, RobotFleet
from rsb_extras.fleet.server_source import ServerFleet
from rsb_extras.fleet.simulated_fleet import WITH_BATTERY, fleet, listening

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Iterator, Sequence

    from rsb_extras.fleet.fleet import FleetSource, Robot
    from rsb_extras.fleet.simulated_fleet import SimulatedFleet as Simulated

GROUPS = ("hall", "yard")
# Seconds, for a busy machine. On a quiet one, the topics of ten robots flow after 3.6 s (bench/README.md, A fleet).
_OPEN_WITHIN, _SEEN_WITHIN, _WELL_WITHIN = 60.0, 10.0, 60.0
_AFTER = 5.0
"""Seconds until the first trouble, as docs/one-machine.md says."""
_AWAY, _THERE = 10.0, 20.0
"""Seconds for which the robot that comes and goes is away, and then present."""
_LOOK_EVERY = 0.2  # s. A round figure: a trouble begins so much later at most
_FAULTY = "/scan"
_AFTER_QUIT = "All simulated robots end."


def demo(arguments: Namespace) -> int:
    """Run `rsb-console demo --fleet`."""
    allow_many_descriptors()
    if not arguments.no_ui and not can_draw("rsb-console demo --fleet --no-ui"):
        return USAGE
    return run_fleet_demo(arguments.robots, ui=not arguments.no_ui, seconds=arguments.seconds)


def run_fleet_demo(robots: int, *, ui: bool, seconds: float | None) -> int:
    """Run a fleet on its screen until the operator quits; or headless, and sum it up at the end.

    Args:
        ui: run on the fleet's screen instead of headless.
        seconds: s to run headless once all robots are linked, or None to run until a signal.

    Returns:
        The exit code; headless, 0 only if each robot was linked and its topics were open.
    """
    try:
        need_ros()
        with Signals(ignore_hangup=False, has_terminal=True) as signals, simulated(robots) as running:
            if signals.caught:
                return INTERRUPTED
            if ui:
                return _on_screen(running, signals)
            return _fleet_headless(running, signals, seconds)
    except (EngineError, ProcessError) as error:
        print_error(str(error))
        return FAILURE


@contextlib.contextmanager
def simulated(robots: int) -> Iterator[Simulated]:
    """Start the engines of a fleet: over Zenoh, or over TCP if Zenoh is not installed."""
    over_zenoh = bool(ways()) and importlib.util.find_spec("zenoh") is not None
    network = "a Zenoh router" if over_zenoh else "no Zenoh, which is not installed: pip install 'rsb-console[zenoh]'"
    print_line(f"starting {robots} simulated robots and a control side, with {network}")
    sys.stdout.flush()
    over = "zenoh" if over_zenoh else "tcp"
    names = [f"robot{number}" for number in range(1, robots + 1)]
    domain = own_domain()
    with (
        tempfile.TemporaryDirectory(prefix="rsb-fleet-") as folder,
        fleet(
            Path(folder), names, domain=domain, over=over, load=WITH_BATTERY, groups=GROUPS, operated=over_zenoh
        ) as running,
        contextlib.ExitStack() as stack,
    ):
        topics = [f"/{name}{talk.topic}" for name in names for talk in WITH_BATTERY.talks]
        stack.callback(SimulatedPart.start("listener", domain, Path(folder), *topics).stop)
        control = running.start_control()
        running.start_robots(running.names)
        # Robots that start earlier would fail to link at first, and try again after their pause.
        listening(control, running.session)
        running.records()  # all processes answer
        yield running


@contextlib.contextmanager
def seen(running: Simulated) -> Iterator[RobotFleet]:
    """Open the fleet as an operator's console does: over Zenoh all engines, otherwise the server's clients."""
    source: FleetSource
    source = ServerFleet("control", running.socket) if running.file is None else ways()[0](str(running.file)).robots()
    shown = RobotFleet([source], Memory(None), Clock())
    shown.start()
    try:
        yield shown
    finally:
        shown.stop()


def _on_screen(running: Simulated, signals: Signals) -> int:
    from rsb_extras.fleet.fleet_app import run_fleet  # noqa: PLC0415 -- needs Textual

    over = threading.Event()
    with seen(running) as shown, ThreadPoolExecutor(1) as aside:
        if signals.caught:  # while it waited for the robots; from now on the screen's own handlers catch them
            return INTERRUPTED
        troubling = aside.submit(trouble, running, over.is_set)
        try:
            code = run_fleet(shown, after_quit=_AFTER_QUIT)
        finally:
            # Without this, the executor's end would wait for `trouble` for ever.
            over.set()
        troubling.result()
    return code


def _fleet_headless(running: Simulated, signals: Signals, seconds: float | None) -> int:
    sends = len(running.load.talks)  # nobody publishes the goals that they could receive
    running.wait(lambda robot: len(robot.open) >= sends or bool(signals.caught), _OPEN_WITHIN)
    if signals.caught:
        return INTERRUPTED
    _say(running)
    ends = None if seconds is None else time.monotonic() + seconds
    with seen(running) as shown:
        troubled = trouble(running, lambda: bool(signals.caught) or (ends is not None and time.monotonic() >= ends))
        engines = len(running.names) + (running.file is not None)
        _print_summary(heard(shown, engines, lambda: troubled or bool(signals.caught)))
    return HUNG_UP if signals.hung_up else OK


def _troubled(names: Sequence[str]) -> tuple[str, str]:
    """Return the robot that loses a topic, and the one that comes and goes."""
    return names[min(1, len(names) - 1)], names[-1]


def _say(running: Simulated) -> None:
    count = len(running.names)
    faulty, restless = _troubled(running.names)
    look = f"fleet --fleet {running.file}" if running.file else f"fleet --control {running.socket}"
    print_line(f"{count} simulated robots are linked; their ROS is a stand-in, in {count} graphs")
    print_line(f"{faulty} stops publishing {_FAULTY} after {_AFTER:.0f} s; {restless} comes and goes")
    print_line(f"to watch them: rsb-console {look}")
    print_line(HOW_TO_END)
    sys.stdout.flush()


def trouble(running: Simulated, over: Callable[[], bool]) -> bool:
    """Cause troubles to show until the time is over. Return whether there was time for any."""
    faulty, restless = _troubled(running.names)
    began, troubled = time.monotonic(), False
    due = [(began + _AFTER, faulty, ("mute", _FAULTY)), (began + _THERE, restless, ("stop",))]
    while not over():
        now = time.monotonic()
        # The loop changes `due`, and goes over a copy.
        for at, name, words in [each for each in due if each[0] <= now]:
            due.remove((at, name, words))
            running.tell(name, *words)
            troubled = True
            match words:
                case ("stop",):
                    due.append((now + _AWAY, name, ("start",)))
                case ("start",):
                    due.append((now + _THERE, name, ("stop",)))
        time.sleep(_LOOK_EVERY)
    return troubled


def heard(shown: RobotFleet, engines: int, as_they_are: Callable[[], bool]) -> list[Robot]:
    """Wait until each engine has reported, and return the robots.

    A busy machine keeps robots from publishing, or from answering, for some seconds. So if nothing is meant to be
    wrong, wait until nothing is.

    Args:
        as_they_are: whether something is meant to be wrong, or nobody waits for it to become well.
    """
    asked = time.time()
    while True:
        robots = shown.robots()
        enough = as_they_are()
        heard = len(robots) >= engines and all(_has_said(robot, asked) for robot in robots)
        if heard and (enough or all(map(_is_well, robots))):
            return robots
        if time.time() > asked + (_SEEN_WITHIN if enough else _WELL_WITHIN):
            return robots
        time.sleep(_LOOK_EVERY)


def _is_well(robot: Robot) -> bool:
    """Whether nothing is wrong with a robot, and the desk hears all its topics: it begins with the robots."""
    return robot.summary.state is RobotState.OK and State.UNHEARD not in robot.summary.states


def _has_said(robot: Robot, since: float) -> bool:
    """Whether a robot has reported since a time (s since the epoch), or is missing."""
    return robot.summary.state is RobotState.MISSING or (robot.summary.seen or 0.0) >= since


def _print_summary(robots: Sequence[Robot]) -> None:
    """Print one line for each engine: its state, its flowing topics, its battery and its worst fault."""
    for _, summary, _ in sorted(robots, key=lambda robot: robot.order):
        battery = f"{summary.battery.charge:.0%}" if summary.battery is not None else ""
        flow = f"{summary.flowing} of {summary.routes} topics flow"
        print_line(f"{summary.name:<10} {summary.state:<8} {flow:<21} {battery:>4}  {summary.why}".rstrip())

"""`rsb-console fleet`: all robots of some servers, a command for some of them, a change from robot to robot."""

from __future__ import annotations

import contextlib
import io
import json
import signal
import sys
import time
from functools import partial
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.feature_api import Clock, RobotState, plural, running_bridges
from rsb_bridge.model.calls import FIELDS_LENGTH
from rsb_console.command.target import chosen_bridge
from rsb_console.feature_console import (
    FAILURE,
    OK,
    USAGE,
    NoBridgeError,
    UsageError,
    agreed,
    json_line,
    print_error,
    print_line,
)
from rsb_extras.fleet.fleet import Memory, RobotFleet, UnknownRobotError, memory_path
from rsb_extras.fleet.rolling import Rollout, names_of, report, said, way_back
from rsb_extras.fleet.server_source import ServerFleet

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator, Sequence

    from rsb_extras.fleet.fleet import FleetSource, Robot
    from rsb_extras.fleet.rolling import RobotChange, RolloutOutcome

_LOOK_EVERY = 0.5  # s. A round figure: the command takes so much longer at most
_NO_ROBOTS = "no robots given: name them, or use --group GROUP or --all"


def sources_of(arguments: Namespace) -> list[FleetSource]:
    """Return the sources of the robots: the named server, or all servers that run here.

    Raises:
        NoBridgeError: no server runs here.
        UsageError: the named bridge is not a server, or a way to others is given, too.
    """
    if arguments.way is not None:
        if arguments.bridge is not None or arguments.control is not None:
            option = arguments.way.option
            raise UsageError(f"{option} means bridges elsewhere, --bridge and --control a server here: give one")
        return [arguments.way.robots()]
    if arguments.bridge is not None or arguments.control is not None:
        named = chosen_bridge(arguments)
        if named.info is not None and named.info.role != "server":
            raise UsageError(f"{named.name} is a client and has no robots: name its server")
        return [ServerFleet(named.name, named.path)]
    servers = [bridge for bridge in running_bridges() if bridge.info is not None and bridge.info.role == "server"]
    if not servers:
        raise NoBridgeError("no server runs here that you may attach to; `rsb-console status` lists the bridges")
    names: dict[str, int] = {}
    for server in servers:
        names[server.name] = names.get(server.name, 0) + 1
    # Two servers of one name differ by their sockets only.
    return [
        ServerFleet(server.name if names[server.name] == 1 else str(server.path), server.path) for server in servers
    ]


@contextlib.contextmanager
def _fleet(arguments: Namespace, *, wait: bool = True) -> Iterator[RobotFleet]:
    """Open the fleet that the arguments name, for the duration of a block.

    Args:
        wait: until the robots have said how they are.
    """
    fleet = RobotFleet(sources_of(arguments), Memory(memory_path()), Clock())
    fleet.start()
    try:
        if wait:
            fleet.wait()
        yield fleet
    except UnknownRobotError as error:
        raise UsageError(str(error)) from None
    finally:
        fleet.stop()


# --- looking


def show_fleet(arguments: Namespace) -> int:
    if arguments.json:
        return _print(arguments)
    from rsb_console.command.local_commands import can_draw  # noqa: PLC0415 -- it imports what reads keys, not needed else

    if not can_draw("rsb-console fleet --json"):
        return USAGE
    from rsb_extras.fleet.fleet_app import run_fleet  # noqa: PLC0415 (needs Textual)

    # The screen opens at once, and its rows fill in: over Zenoh, the wait may take 5 s.
    with _fleet(arguments, wait=False) as fleet:
        return run_fleet(
            fleet,
            readonly=arguments.readonly,
            ascii_only=arguments.ascii,
            theme=arguments.theme,
            mouse=not arguments.no_mouse,
        )


def _print(arguments: Namespace) -> int:
    with _fleet(arguments) as fleet:
        deadline = time.monotonic() + arguments.seconds
        robots = fleet.robots()
        # One long sleep would not do: an attached engine renews its snapshot only while somebody asks for it.
        while time.monotonic() < deadline:
            time.sleep(min(_LOOK_EVERY, arguments.seconds))
            robots = fleet.robots()
    if not robots and arguments.way is not None:
        raise NoBridgeError(f"no engine has announced itself in the fleet {fleet.sources[0].name!r}")
    wrong = [robot for robot in robots if robot.summary.state.is_wrong]
    states = [robot.summary.state for robot in robots if not robot.is_server]
    servers = len(robots) - len(states)
    summary = {
        "robots": len(states),
        "servers": servers,
        "states": {state: states.count(state) for state in RobotState},
    }
    print_line(json_line({"ok": not wrong, "time": time.time(), "summary": summary, "robots": [*map(_report, robots)]}))
    return FAILURE if wrong else OK


def _report(robot: Robot) -> dict[str, object]:
    """Report a robot for programs, with all figures, including defaults."""
    summary = robot.summary
    figures: dict[str, object] = msgspec.structs.asdict(summary)
    loss, battery = summary.loss, summary.battery
    figures["loss"] = None if loss is None else {"share": round(loss.share, 4), "span": round(loss.span, 1)}
    figures["battery"] = None if battery is None else {"charge": round(battery.charge, 3), "time": battery.time}
    for name, value in figures.items():
        if isinstance(value, float):
            figures[name] = round(value, 3)
    return {**figures, "server": robot.source.name, "gone": robot.gone}


def dismiss_robots(arguments: Namespace) -> int:
    with _fleet(arguments) as fleet:
        if not (arguments.names or arguments.group or arguments.everyone):
            raise UsageError(_NO_ROBOTS)
        gone = fleet.chosen(arguments.names, arguments.group, everyone=arguments.everyone, gone=True)
        fleet.dismiss(gone)
    if arguments.json:
        print_line(json_line({"ok": True, "dismissed": [robot.summary.name for robot in gone]}))
    return OK


# --- a command for some robots


def execute(arguments: Namespace) -> int:
    words: list[str] = arguments.words
    if not words:
        raise UsageError("no command: rsb-console fleet exec NAME ... -- COMMAND ..., as in -- pause /camera")
    if words[0] not in arguments.able:
        raise UsageError(f"{words[0]} cannot run for a robot; these can: {', '.join(arguments.able)}")
    command = _parsed(words)
    with _fleet(arguments) as fleet:
        robots = _chosen(fleet, arguments)
        codes, outputs = [], {}
        for robot in robots:
            code, lines = _run_on(robot, command, as_json=arguments.json)
            codes.append(code)
            if arguments.json:
                outputs[robot.key] = {"robot": robot.summary.name, "server": robot.source.name, "code": code,
                                      "output": [_plain(line) for line in lines]}  # fmt: skip
            else:
                for line in lines or ["done" if code == OK else f"not done (exit code {code})"]:
                    print_line(f"{robot.summary.name}: {line}")
                # The next robot may take a while to answer.
                sys.stdout.flush()
    failed = [code for code in codes if code != OK]
    if arguments.json:
        print_line(json_line({"ok": not failed, "robots": [*outputs.values()]}))
    elif failed:
        print_error(f"not done for {len(failed)} of {len(codes)} robots")
    return FAILURE if failed else OK


def _parsed(words: Sequence[str]) -> Namespace:
    """Parse a command's arguments; a mistake is reported as usual and ends the process."""
    from rsb_console.command.arguments import parser_and_commands  # noqa: PLC0415 -- it imports this one's arguments

    parsed = parser_and_commands()[0].parse_args([*words])
    if "endless" in parsed and (problem := parsed.endless(parsed)):
        raise UsageError(problem)
    if any(getattr(parsed, name, None) for name in ("bridge", "control", "way", "link")):
        raise UsageError("name the robots before --, and no bridge or link after it")
    for name in ("request", "message"):
        if getattr(parsed, name, None) == "-":  # it can be read once, for all robots
            setattr(parsed, name, sys.stdin.read(FIELDS_LENGTH + 1))
    return parsed


def _run_on(robot: Robot, command: Namespace, *, as_json: bool) -> tuple[int, list[str]]:
    """Run a command on a robot; return its exit code and its printed lines."""
    command.attach = partial(robot.source.open, robot.summary.name)
    command.json = command.json or as_json
    # `shell.encoded` needs the stream's encoding, which a StringIO does not have.
    printed = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", newline="\n")
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        code: int = command.command(command)
    printed.flush()
    text = printed.buffer.getvalue().decode()
    return code, [line.removeprefix("rsb-console: ") for line in text.splitlines()]


def _plain(line: str) -> object:
    """Read a line that a command printed for programs; other text stays as it is."""
    try:
        parsed: object = json.loads(line)
    except ValueError:
        return line
    return parsed


def _chosen(fleet: RobotFleet, arguments: Namespace) -> list[Robot]:
    """Return the robots that the arguments name; print and skip any that is not connected.

    Raises:
        UsageError: the arguments name no robot.
    """
    robots = fleet.chosen(arguments.names, arguments.group, everyone=arguments.everyone)
    gone = [robot.summary for robot in fleet.robots() if robot.gone and not robot.is_server]
    if left_out := [each.name for each in gone if arguments.everyone or (each.group and each.group == arguments.group)]:
        print_error(f"not there, and left out: {', '.join(left_out)}")
    if not robots:
        raise UsageError(_NO_ROBOTS)
    return robots


# --- a change from robot to robot


def edit_robots(arguments: Namespace) -> int:
    words: list[str] = arguments.names
    topics = [word for word in words if word.startswith("/")]
    keys = [word for word in words if "=" in word and not word.startswith("/")]
    arguments.names = [word for word in words if word not in topics and word not in keys]
    if len(topics) != 1 or not keys:
        raise UsageError(
            "the topic or the change is missing, for example: rsb-console fleet edit robot1 /camera max_rate=5"
        )
    if arguments.json and not (arguments.yes or arguments.dry_run):
        raise UsageError("--json does not ask: give --yes, or --dry-run")
    with _fleet(arguments) as fleet:
        robots = _chosen(fleet, arguments)
        rollout = Rollout(fleet, robots, topics[0], keys, arguments.settle, now=time.monotonic, sleep=time.sleep)
        steps = rollout.plan()
        if not arguments.json:
            for step in steps:
                print_line(f"{step.name}: {said(step)}")
        wanted = [step for step in steps if step.new is not None]
        problems = [step for step in steps if step.problem]
        if arguments.dry_run or not wanted:
            if arguments.json:
                print_line(json_line({"ok": not problems, "plan": [*map(_planned, steps)]}))
            return FAILURE if problems else OK
        if not arguments.yes and not agreed(f"Change {len(wanted)} of {len(steps)} robots, one after the other?"):
            print_error("nothing is changed")
            return FAILURE
        with _interruptible(rollout):
            outcome = rollout.run(steps, _silent if arguments.json else _told)
        return _ended(arguments, rollout, outcome, steps)


@contextlib.contextmanager
def _interruptible(rollout: Rollout) -> Iterator[None]:
    """Let a first Ctrl-C stop after the present robot, with a report and the way back; a second stops at once."""

    def stop(_: int, __: object) -> None:
        rollout.cancelled = True
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _planned(step: RobotChange) -> dict[str, object]:
    return {"robot": step.name, "server": step.robot.source.name, "changes": step.changes, "problem": step.problem}


def _told(step: RobotChange, what: str) -> None:
    print_line(f"{step.name}: {what}")
    sys.stdout.flush()


def _silent(_: RobotChange, __: str) -> None:
    pass


def _ended(arguments: Namespace, rollout: Rollout, outcome: RolloutOutcome, steps: Sequence[RobotChange]) -> int:
    """Report the outcome, and undo the change if the operator wants it. Return the exit code."""
    stopped = outcome.failed is not None or bool(outcome.left)
    unreached = [step for step in steps if not step.reached]
    lines = list(report(rollout, outcome)) if stopped else []
    for line in () if arguments.json else lines:
        print_error(line)
    kept: list[tuple[RobotChange, str]] = []
    undone = False
    if stopped and outcome.changed:
        undone = arguments.undo or (
            not arguments.yes and agreed(f"Restore the previous settings on {names_of(outcome.changed)}?")
        )
        if undone:
            kept = rollout.undo(outcome, _silent if arguments.json else _told)
    if arguments.json:
        failed = outcome.failed
        print_line(json_line({
            "ok": not stopped and not unreached, "plan": [*map(_planned, steps)],
            "done": [step.name for step in outcome.done],
            "failed": None if failed is None else {"robot": failed.name, "why": outcome.why},
            "left": [step.name for step in outcome.left], "undone": undone,
            "not_undone": [{"robot": step.name, "why": why} for step, why in kept],
        }))  # fmt: skip
    elif undone:
        for step, why in kept:
            print_error(f"{step.name}: not restored: {why}")
    elif stopped:
        for line in way_back(rollout, outcome):
            print_error(line)
    else:
        print_line(f"done on {len(outcome.done)} {plural(len(outcome.done), 'robot')}")
    if unreached and not stopped and not arguments.json:
        print_error(f"not reached: {names_of(unreached)}")
    return FAILURE if stopped or unreached else OK

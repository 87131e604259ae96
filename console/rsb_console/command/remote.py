"""The commands that attach to a running bridge, for scripts: a few lines each over an `EngineApi`."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.control.bridges import running_bridges
from rsb_bridge.control.control_sockets import ControlError
from rsb_bridge.control.remote_engine import RemoteEngine
from rsb_bridge.model.faults import state_counts
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import plural
from rsb_console.command.adding import add, edit
from rsb_console.command.arming import arm, disarm
from rsb_console.command.echo import echo
from rsb_console.command.figures import BW, HZ, print_figures
from rsb_console.command.health import acknowledged, waiting, wrong
from rsb_console.command.info import print_info
from rsb_console.command.reports import (
    acknowledged_by,
    clock,
    faults_first,
    json_event,
    json_line,
    link_word,
    links_of,
    made_by,
    of_links_that_are_up,
    pattern_text,
    patterns_of,
    rate_text,
    refused_text,
    route_of,
    status_of,
    text_event,
    topics_of_link_that_is_down,
    where_and_why,
)
from rsb_console.command.shell import FAILURE, NOT_RUNNING, OK, print_error, print_line
from rsb_console.command.target import (
    ANSWERED_WITHIN,
    all_chosen,
    attached,
    carried_out,
    check_link,
    chosen,
    chosen_route,
    done,
    done_with_all,
    failed,
    reported,
    result,
)
from rsb_console.command.waiting import wait

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable

    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.model.snapshot import Snapshot, TopicInfo

_LOOK_EVERY = 0.1
_EVENTS_WITHIN = 10.0


def run(name: str, arguments: Namespace) -> int:
    """Run a command by its name. Returns the exit code."""
    return reported(COMMANDS[name], arguments)


# --- looking


def _status(arguments: Namespace) -> int:
    several = _all_bridges(arguments)
    if several:
        return _status_of_all(several, arguments)
    with attached(arguments, read_only=True) as engine:
        faults, lines, figures = _status_of(engine)
    if arguments.json:
        print_line(json_line(figures))
    for line in () if arguments.json else lines:
        print_line(line)
    return FAILURE if faults else OK


def _all_bridges(arguments: Namespace) -> list[RunningBridge]:
    """Return all bridges of this machine if several run and the arguments name none, else an empty list."""
    if arguments.bridge is not None or arguments.control is not None or getattr(arguments, "fleet", None) is not None:
        return []
    if getattr(arguments, "attach", None) is not None:
        return []
    found = running_bridges()
    return found if len(found) > 1 else []


def _status_of_all(bridges: list[RunningBridge], arguments: Namespace) -> int:
    """Print the status of each bridge. Returns the worst exit code."""
    codes: list[int] = []
    figures: list[dict[str, object]] = []
    for bridge in bridges:
        try:
            if bridge.info is None:
                raise ControlError(bridge.problem)
            engine = RemoteEngine(bridge.path, read_only=True)
            try:
                engine.start()
                faults, lines, of_bridge = _status_of(engine)
            finally:
                engine.stop()
        except (ControlError, EngineError, TimeoutError) as error:
            codes.append(NOT_RUNNING)
            lines = [f"{bridge.name}: pid {bridge.pid}, {bridge.path}", f"  {str(error) or 'it does not answer'}"]
            of_bridge = {"ok": False, "name": bridge.name, "pid": bridge.pid, "error": str(error)}
        else:
            codes.append(FAILURE if faults else OK)
        figures.append(of_bridge)
        for line in () if arguments.json else lines:
            print_line(line)
    if arguments.json:
        print_line(json_line({"ok": not any(codes), "bridges": figures}))
    return max(codes)


def _status_of(engine: RemoteEngine) -> tuple[list[str], list[str], dict[str, object]]:
    """Return a bridge's faults, its status as lines, and the same as data."""
    now, bridge = engine.snapshot(), engine.bridge
    faults, known, waits = wrong(now), acknowledged(now), waiting(now)
    about = {key: getattr(bridge, key) for key in ("name", "role", "pid", "started", "file", "program")}
    figures = {"ok": not faults, "wrong": faults, "acknowledged": known, "waiting": waits, **about,
               "address": now.address, "domain_id": now.domain_id,
               "running": now.running, "time": now.time, **status_of(now)}  # fmt: skip
    lines = [
        f"{bridge.name}: {bridge.role}, {now.address}, domain {now.domain_id}, pid {bridge.pid}",
        f"  since {clock(bridge.started)}" + (f", {bridge.file}" if bridge.file else ""),
        f"  {_in_short(now, faults, known, waits)}",
    ]
    for link in now.links:
        lines.append(f"  link {link.name} {link_word(link)}{where_and_why(link)}{acknowledged_by(link)}")
        if waits_for_link := topics_of_link_that_is_down(now, link):
            lines.append(f"    {waits_for_link}")
    lines += [f"  {refused_text(client)}" for client in now.refused]
    shown = faults_first(of_links_that_are_up(now))
    lines += [f"  {rate_text(route)}{made_by(route)}{acknowledged_by(route)}" for route in shown]
    lines += [f"  {pattern_text(pattern)}{acknowledged_by(pattern)}" for pattern in patterns_of(now)]
    return faults, lines, figures


def _in_short(now: Snapshot, faults: list[str], known: list[str], waits: list[str]) -> str:
    """Return the numbers of faults, acknowledged faults and waiting things in words."""
    if not now.running:
        return "STOPPED"
    parts = [f"{len(faults)} {plural(len(faults), 'thing')} wrong" if faults else "nothing is wrong"]
    if unheard := state_counts(now.routes).get(State.UNHEARD):
        parts.append(f"{unheard} unheard")
    if known:
        parts.append(f"{len(known)} acknowledged")
    if refused := len(now.refused):
        parts.append(f"{refused} {plural(refused, 'client')} refused")
    if waits:
        parts.append(f"{len(waits)} {'waits' if len(waits) == 1 else 'wait'}")
    return ", ".join(parts)


def _topics(arguments: Namespace) -> int:
    with attached(arguments, read_only=True) as engine:
        if arguments.available:
            return _available(engine, arguments)
        now = engine.snapshot()
        if arguments.json:
            topics = [route_of(route) for route in now.routes]
            print_line(json_line({"ok": True, "links": links_of(now), "topics": topics}))
        for route in () if arguments.json else now.routes:
            link = f"{route.link}: " if engine.bridge.role == "server" else ""
            print_line(f"{link}{rate_text(route)}{made_by(route)}")
        for pattern in () if arguments.json else patterns_of(now):
            link = f"{pattern.link}: " if engine.bridge.role == "server" else ""
            print_line(f"{link}{pattern_text(pattern)}")
        return OK


def _available(engine: RemoteEngine, arguments: Namespace) -> int:
    sides: dict[str, list[TopicInfo]] = {"": result(engine.topics())}
    for link in engine.snapshot().links:
        if link.state is State.OK:
            sides[link.name] = result(engine.topics(link.name))
    found = [
        {"side": side or "here", "kind": info.kind, "topic": info.topic, "type": info.type_name,
         "publishers": info.publishers, "subscriptions": info.subscriptions}
        for side, infos in sides.items() for info in infos
    ]  # fmt: skip
    if arguments.json:
        print_line(json_line({"ok": True, "available": found}))
    for info in () if arguments.json else found:
        ends = "publishers: {publishers}, subscriptions: {subscriptions}"
        if info["kind"] != "topic":
            ends = "providers: {publishers}, callers: {subscriptions}"
        type_name = " {type}" if info["type"] else ""  # a node with parameters has none
        print_line(f"{{side}}: {{kind}} {{topic}}{type_name}, {ends}".format(**info))
    return OK


def _events(arguments: Namespace) -> int:
    format_event = json_event if arguments.json else text_event
    with attached(arguments, read_only=True) as engine:
        events, seen = engine.remembered_events(_EVENTS_WITHIN), 0
        while True:
            for event in events:
                print_line(format_event(event))
                seen = event.number
            sys.stdout.flush()
            if not arguments.follow:
                return OK
            events = engine.wait_for_events(seen, _EVENTS_WITHIN)


def _echo(arguments: Namespace) -> int:
    with attached(arguments, read_only=True) as engine:
        route = chosen_route(engine, arguments)
        if echo(engine, route, arguments):
            return OK
        why = f": {route.reason}" if (route := chosen_route(engine, arguments)).reason else ""
    return failed(arguments, f"no more messages of {arguments.topic} within {arguments.timeout:g} s{why}", FAILURE)


def _hz(arguments: Namespace) -> int:
    return print_figures(HZ, arguments)


def _bw(arguments: Namespace) -> int:
    return print_figures(BW, arguments)


# --- changing


def _remove(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        result(engine.remove_topic(chosen(engine, arguments).key, drop_arm=arguments.drop_arm))
        return done(arguments)


def _pause(arguments: Namespace, *, paused: bool = True) -> int:
    with attached(arguments) as engine:
        found = all_chosen(engine, arguments)
        carried_out([engine.pause(each.key, paused) for each in found])
        return done_with_all(arguments, found, "paused" if paused else "resumed")


def _resume(arguments: Namespace) -> int:
    return _pause(arguments, paused=False)


def _ack(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        if arguments.topic in {link.name for link in engine.snapshot().links}:
            result(engine.acknowledge("", not arguments.undo, link=arguments.topic))
        else:
            result(engine.acknowledge(chosen(engine, arguments).key, not arguments.undo))
        return done(arguments)


def _retry(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        check_link(engine, arguments.link)
        result(engine.retry(arguments.link))
        return done(arguments)


def _restart(arguments: Namespace) -> int:
    def step(text: str) -> None:
        if not arguments.json:
            print_line(text)

    with attached(arguments) as engine:
        result(engine.restart(step))
        return done(arguments)


def _reload(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        reloaded = result(engine.reload(dry_run=arguments.dry_run))
    if arguments.json:
        is_done = not (reloaded.left or reloaded.failed)
        print_line(json_line({"ok": is_done, "dry_run": arguments.dry_run, **asdict(reloaded)}))
    else:
        for line in reloaded.changed or ["nothing that can change in place differs"]:
            print_line(line)
        for line in (*reloaded.left, *reloaded.failed):
            print_error(line)
    return FAILURE if reloaded.left or reloaded.failed else OK


def _stop(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        result(engine.stop_bridge())
        deadline = time.monotonic() + ANSWERED_WITHIN
        while not engine.unreachable:
            if time.monotonic() > deadline:
                raise TimeoutError
            time.sleep(_LOOK_EVERY)
        return done(arguments)


COMMANDS: dict[str, Callable[[Namespace], int]] = {
    "status": _status,
    "topics": _topics,
    "add": add,
    "edit": edit,
    "remove": _remove,
    "pause": _pause,
    "resume": _resume,
    "ack": _ack,
    "arm": arm,
    "disarm": disarm,
    "retry": _retry,
    "restart": _restart,
    "reload": _reload,
    "events": _events,
    "wait": wait,
    "echo": _echo,
    "hz": _hz,
    "bw": _bw,
    "info": print_info,
    "stop": _stop,
}

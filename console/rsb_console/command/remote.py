"""The commands that attach to a running bridge, for scripts: a few lines each over an `EngineApi`."""

from __future__ import annotations

import contextlib
import difflib
import sys
import time
from dataclasses import asdict
from typing import TYPE_CHECKING, TypeVar

from rsb_bridge.api import EngineError
from rsb_bridge.control.bridges import ask, running_bridges
from rsb_bridge.control.client import RemoteEngine
from rsb_bridge.control.folders import ControlError, hidden_services
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_console.command.echo import echo
from rsb_console.command.reports import (
    clock,
    faults_first,
    json_event,
    json_line,
    rate_text,
    route_of,
    status_of,
    text_event,
)
from rsb_console.command.shell import FAILURE, NOT_RUNNING, OK, USAGE, print_error, print_line
from rsb_console.session.draft import problems_of, topic_of, values_of

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Iterator
    from concurrent.futures import Future

    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.model.history import HistoryReport
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot, TopicInfo

ANSWERED_WITHIN = 60.0
_LOOK_EVERY = 0.1
_EVENTS_WITHIN = 10.0

T = TypeVar("T")


class UsageError(Exception):
    """What was asked for is not clear, or not valid; the message says what would be."""


class NoBridgeError(Exception):
    """No bridge runs, or not this one; the message says which do."""


def run(name: str, arguments: Namespace) -> int:
    """Run a command by its name. Returns the exit code."""
    return reported(COMMANDS[name], arguments)


def bridge_to_attach(arguments: Namespace) -> RunningBridge | int:
    """The bridge that the arguments mean; or the exit code, after saying why there is none."""
    return reported(chosen_bridge, arguments)


def reported(work: Callable[[Namespace], T], arguments: Namespace) -> T | int:
    """Do something; what goes wrong is said in words, and gives an exit code."""
    try:
        return work(arguments)
    except UsageError as error:
        return _failed(arguments, str(error), USAGE)
    except (NoBridgeError, ControlError) as error:
        return _failed(arguments, str(error), NOT_RUNNING)
    except EngineError as error:
        return _failed(arguments, str(error), FAILURE)
    except TimeoutError:
        return _failed(arguments, f"the bridge has not answered for {ANSWERED_WITHIN:.0f} s", FAILURE)


def _failed(arguments: Namespace, message: str, code: int) -> int:
    if getattr(arguments, "json", False):
        print_line(json_line({"ok": False, "error": message}))
    else:
        print_error(message)
    return code


# --- which bridge


def chosen_bridge(arguments: Namespace) -> RunningBridge:
    """The bridge that the arguments mean.

    Raises:
        NoBridgeError: none does.
        UsageError: several do.
        ControlError: the socket that they name has none.
    """
    name, path = arguments.bridge, arguments.control
    if path is not None:
        return _answering(ask(path))
    found = running_bridges()
    chosen = [bridge for bridge in found if name in (None, bridge.name)]
    running = "".join(f"\n  {bridge}" for bridge in found)
    if not found:
        other = hidden_services()
        hint = f"; services are the user {other}'s: sudo -u {other} rsb-console …" if other else ""
        raise NoBridgeError(f"no bridge runs here that you may attach to{hint}")
    if not chosen:
        raise NoBridgeError(f"no bridge {name!r} runs here; these do:{running}")
    if len(chosen) > 1:
        raise UsageError(f"several bridges run here; say which:{running}")
    return _answering(chosen[0])


def _answering(bridge: RunningBridge) -> RunningBridge:
    if bridge.info is None:
        raise ControlError(f"{bridge.name} (pid {bridge.pid}): {bridge.problem}")
    return bridge


@contextlib.contextmanager
def _attached(arguments: Namespace, *, read_only: bool = False) -> Iterator[RemoteEngine]:
    engine = RemoteEngine(chosen_bridge(arguments).path, read_only=read_only)
    engine.start()
    try:
        yield engine
    finally:
        engine.stop()


def ask_history(arguments: Namespace, seconds: float) -> HistoryReport:
    """What happened to the bridge that the arguments mean, in the last so many s."""
    with _attached(arguments, read_only=True) as engine:
        return _result(engine.history(seconds))


# --- looking


def _status(arguments: Namespace) -> int:
    with _attached(arguments, read_only=True) as engine:
        now, bridge = engine.snapshot(), engine.bridge
        if arguments.json:
            about = {key: getattr(bridge, key) for key in ("name", "role", "pid", "started", "file", "program")}
            print_line(
                json_line({**about, "address": now.address, "domain_id": now.domain_id, "running": now.running,
                           "time": now.time, **status_of(now)})
            )  # fmt: skip
        else:
            print_line(f"{bridge.name}: {bridge.role}, {now.address}, domain {now.domain_id}, pid {bridge.pid}")
            print_line(f"  since {clock(bridge.started)}" + (f", {bridge.file}" if bridge.file else ""))
            if not now.running:
                print_line("  STOPPED")
            for link in now.links:
                print_line(
                    f"  link {link.name} {link.state.upper()} {link.peer} {link.reason or link.warning}".rstrip()
                )
            for route in faults_first(now.routes):
                print_line(f"  {rate_text(route)}")
        return OK if _is_fine(now) else FAILURE


def _is_fine(now: Snapshot) -> bool:
    """Whether nothing is wrong. What an operator wants to be so is not: a pause, a limit."""
    links = all(link.state is State.OK and not link.warning for link in now.links)
    return now.running and links and all(route.state in (State.OK, State.PAUSED) for route in now.routes)


def _topics(arguments: Namespace) -> int:
    with _attached(arguments, read_only=True) as engine:
        if arguments.available:
            return _available(engine, arguments)
        routes = engine.snapshot().routes
        if arguments.json:
            print_line(json_line({"topics": [route_of(route) for route in routes]}))
        for route in () if arguments.json else routes:
            link = f"{route.link}: " if engine.bridge.role == "server" else ""
            print_line(f"{link}{rate_text(route)}")
        return OK


def _available(engine: RemoteEngine, arguments: Namespace) -> int:
    sides: dict[str, list[TopicInfo]] = {"": engine.topics().result(ANSWERED_WITHIN)}
    for link in engine.snapshot().links:
        if link.state is State.OK:
            sides[link.name] = engine.topics(link.name).result(ANSWERED_WITHIN)
    found = [
        {"side": side or "here", "topic": info.topic, "type": info.type_name, "publishers": info.publishers,
         "subscriptions": info.subscriptions}
        for side, infos in sides.items() for info in infos
    ]  # fmt: skip
    if arguments.json:
        print_line(json_line({"available": found}))
    for info in () if arguments.json else found:
        print_line("{side}: {topic} {type} {publishers} publishers {subscriptions} subscriptions".format(**info))
    return OK


def _events(arguments: Namespace) -> int:
    format_event = json_event if arguments.json else text_event
    with _attached(arguments, read_only=True) as engine:
        events, seen = engine.remembered_events(_EVENTS_WITHIN), 0
        while True:
            for event in events:
                print_line(format_event(event))
                seen = event.number
            sys.stdout.flush()
            if not arguments.follow:
                return OK
            events = engine.wait_for_events(seen, _EVENTS_WITHIN)


def _wait(arguments: Namespace) -> int:
    holds = _condition(arguments.wanted)
    began = time.monotonic()
    deadline = float("inf") if arguments.timeout is None else began + arguments.timeout
    with _attached(arguments, read_only=True) as engine:
        while not (held := holds(engine)):
            if time.monotonic() >= deadline:
                break
            time.sleep(_LOOK_EVERY)
        reason = "" if held else _why_not(engine, arguments.wanted)
    if held:
        return _done(arguments, seconds=round(time.monotonic() - began, 3))
    return _failed(arguments, f"not {' '.join(arguments.wanted)} within {arguments.timeout:g} s{reason}", FAILURE)


def _condition(wanted: list[str]) -> Callable[[RemoteEngine], bool]:
    match wanted:
        case ["flowing", topic]:
            return lambda engine: _flows(engine, topic)
        case ["linked"]:
            return lambda engine: any(link.state is State.OK for link in engine.snapshot().links)
        case ["linked", name]:
            return lambda engine: (name, State.OK) in [(link.name, link.state) for link in engine.snapshot().links]
        case ["stopped"]:
            return lambda engine: not engine.snapshot().running
    raise UsageError(f"--for {' '.join(wanted)}: not one of flowing TOPIC, linked [CLIENT], stopped")


def _flows(engine: RemoteEngine, topic: str) -> bool:
    """Whether every route of a topic carries messages, however many and whoever hears them."""
    routes = [route for route in engine.snapshot().routes if route.topic == topic]
    return bool(routes) and all(route.state.flows and route.ledger.delivered for route in routes)


def _why_not(engine: RemoteEngine, wanted: list[str]) -> str:
    now = engine.snapshot()
    reasons = [engine.unreachable]
    if wanted[0] == "flowing":
        routes = [route for route in now.routes if route.topic == wanted[1]]
        reasons += [rate_text(route) for route in routes] or [f"{wanted[1]} is not bridged"]
    if wanted[0] == "linked":
        reasons += [f"{link.name}: {link.reason}" for link in now.links if link.state is not State.OK]
    found = [reason for reason in reasons if reason]
    return f": {'; '.join(found)}" if found else ""


def _echo(arguments: Namespace) -> int:
    with _attached(arguments, read_only=True) as engine:
        route = _route(engine, arguments)
        if echo(engine, route, arguments):
            return OK
        why = f": {route.reason}" if (route := _route(engine, arguments)).reason else ""
    return _failed(arguments, f"no more messages of {arguments.topic} within {arguments.timeout:g} s{why}", FAILURE)


# --- changing


def _add(arguments: Namespace) -> int:
    with _attached(arguments) as engine:
        topic = _topic({"topic": arguments.topic, "direction": arguments.direction}, arguments.keys, engine, None)
        return _done(arguments, key=_result(engine.add_topic(topic, arguments.link)))


def _edit(arguments: Namespace) -> int:
    with _attached(arguments) as engine:
        route = _route(engine, arguments)
        topic = _topic(values_of(route.spec), arguments.keys, engine, route.spec)
        return _done(arguments, key=_result(engine.edit_topic(route.key, topic)))


def _remove(arguments: Namespace) -> int:
    with _attached(arguments) as engine:
        _result(engine.remove_topic(_route(engine, arguments).key))
        return _done(arguments)


def _pause(arguments: Namespace, *, paused: bool = True) -> int:
    with _attached(arguments) as engine:
        _result(engine.pause(_route(engine, arguments).key, paused))
        return _done(arguments)


def _resume(arguments: Namespace) -> int:
    return _pause(arguments, paused=False)


def _retry(arguments: Namespace) -> int:
    with _attached(arguments) as engine:
        _result(engine.retry(arguments.link))
        return _done(arguments)


def _restart(arguments: Namespace) -> int:
    def step(text: str) -> None:
        if not arguments.json:
            print_line(text)

    with _attached(arguments) as engine:
        _result(engine.restart(step))
        return _done(arguments)


def _reload(arguments: Namespace) -> int:
    with _attached(arguments) as engine:
        reloaded = _result(engine.reload(dry_run=arguments.dry_run))
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
    with _attached(arguments) as engine:
        _result(engine.stop_bridge())
        deadline = time.monotonic() + ANSWERED_WITHIN
        while not engine.unreachable:
            if time.monotonic() > deadline:
                raise TimeoutError
            time.sleep(_LOOK_EVERY)
        return _done(arguments)


def _result(future: Future[T]) -> T:
    return future.result(ANSWERED_WITHIN)


def _done(arguments: Namespace, **results: object) -> int:
    """Tell a program that it is done; a person sees that by the exit code."""
    if arguments.json:
        print_line(json_line({"ok": True, **results}))
    return OK


def _route(engine: RemoteEngine, arguments: Namespace) -> RouteSnapshot:
    """The route that the arguments mean.

    Raises:
        UsageError: none or several do.
    """
    routes = [
        route
        for route in engine.snapshot().routes
        if route.topic == arguments.topic
        and arguments.link in ("", route.link)
        and arguments.direction in (None, route.spec.direction)
    ]
    if len(routes) == 1:
        return routes[0]
    if routes:
        which = "; ".join(f"--link {route.link} --direction {route.spec.direction}" for route in routes)
        raise UsageError(f"{arguments.topic} is bridged {len(routes)} times; say which: {which}")
    near = difflib.get_close_matches(arguments.topic, [route.topic for route in engine.snapshot().routes], n=1)
    raise UsageError(f"{arguments.topic} is not bridged" + (f"; did you mean {near[0]}?" if near else ""))


def _topic(values: dict[str, str], keys: list[str], engine: RemoteEngine, replaced: Topic | None) -> Topic:
    """A topic of the values that it has already and those of the command line.

    Raises:
        UsageError: something is wrong with it.
    """
    for text in keys:
        key, is_pair, value = text.partition("=")
        if not is_pair or key not in Topic.__struct_fields__:
            raise UsageError(f"{text}: not KEY=VALUE with a KEY out of {', '.join(Topic.__struct_fields__)}")
        values[key] = "" if key == "paused" and value in ("no", "false") else value
    topic = topic_of(values)
    if problems := problems_of(topic, engine.session, replaced):
        raise UsageError("; ".join(f"{key}: {problem}" for key, problem in problems.items()))
    return topic


COMMANDS: dict[str, Callable[[Namespace], int]] = {
    "status": _status,
    "topics": _topics,
    "add": _add,
    "edit": _edit,
    "remove": _remove,
    "pause": _pause,
    "resume": _resume,
    "retry": _retry,
    "restart": _restart,
    "reload": _reload,
    "events": _events,
    "wait": _wait,
    "echo": _echo,
    "stop": _stop,
}

"""The commands that watch a running bridge: its events, its messages, and until something is so."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.wording import Wording
from rsb_console.command.echo import echo
from rsb_console.command.formatting import json_event, rate_text, text_event
from rsb_console.command.shell import FAILURE, OK, print_line
from rsb_console.command.target import RouteChoice, UsageError, attached, check_link, chosen_route, done, failed, named
from rsb_console.session.draft import suggestion

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.snapshot import RouteSnapshot

_LOOK_EVERY = 0.1  # s. A round figure: a command takes so much longer at most
_EVENTS_WITHIN = 10.0
"""s for the events that a bridge remembers; with --follow, only how long one wait for more lasts. A round figure."""


class WatchingProblem(Wording):
    """Reasons why something is not so, or does not come."""

    NOT_REACHED = "not {condition} within {seconds:g} s{reason}"
    CONDITION_UNKNOWN = "--for {condition}: not one of flowing TOPIC, linked [CLIENT], stopped"
    NOT_BROUGHT = "no client has brought {topic} so far{hint}"
    NO_MORE_MESSAGES = "no more messages of {topic} within {seconds:g} s{reason}"


def print_events(arguments: Namespace) -> int:
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


def print_messages(arguments: Namespace) -> int:
    with attached(arguments, read_only=True) as engine:
        route = chosen_route(engine, arguments)
        if echo(engine, route, arguments):
            return OK
        reason = chosen_route(engine, arguments).reason
    why = f": {reason}" if reason else ""
    problem = WatchingProblem.NO_MORE_MESSAGES(topic=arguments.topic, seconds=arguments.timeout, reason=why)
    return failed(arguments, problem, FAILURE)


def wait_until(arguments: Namespace) -> int:
    holds = _condition(arguments.wanted)
    began = time.monotonic()
    deadline = float("inf") if arguments.timeout is None else began + arguments.timeout
    with attached(arguments, read_only=True) as engine:
        _refuse_what_cannot_be(engine, arguments.wanted)
        while not (held := holds(engine)) and time.monotonic() < deadline:
            time.sleep(_LOOK_EVERY)
        reason = "" if held else _why_not(engine, arguments.wanted)
    if held:
        return done(arguments, seconds=round(time.monotonic() - began, 3))
    condition = " ".join(arguments.wanted)
    problem = WatchingProblem.NOT_REACHED(condition=condition, seconds=arguments.timeout, reason=reason)
    return failed(arguments, problem, FAILURE)


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
    raise UsageError(WatchingProblem.CONDITION_UNKNOWN(condition=" ".join(wanted)))


def _refuse_what_cannot_be(engine: RemoteEngine, wanted: list[str]) -> None:
    """Raise UsageError for a name that this bridge does not know and that no client can add.

    A client knows its topics from the start, and a server its clients; but a server learns a client's topics when they
    link, so there a topic may yet come.
    """
    now = engine.snapshot()
    match wanted:
        case ["flowing", topic] if now.role == "client":
            known = [route.topic for route in now.routes]
            if not named(now.routes, topic):
                raise UsageError(f"{topic} is not bridged{suggestion(topic, known)}; `rsb-console add` adds a topic")
        case ["linked", name]:
            check_link(engine, name)


def _flows(engine: RemoteEngine, topic: str) -> bool:
    """Whether every route of a name carries messages, at any rate and with or without subscribers, or can be called."""
    routes = named(engine.snapshot().routes, topic)
    return bool(routes) and all(map(_carries, routes))


def _carries(route: RouteSnapshot) -> bool:
    passed = {stage.name for stage in route.stages if stage.done}
    if route.spec.kind == "topic":
        # An earlier process may have delivered the messages that the far side keeps of a latched topic.
        return route.state.flows and (route.ledger.delivered > 0 or "published" in passed)
    return "offered" in passed


def _why_not(engine: RemoteEngine, wanted: list[str]) -> str:
    now = engine.snapshot()
    reasons = [engine.unreachable]
    if wanted[0] == "flowing":
        routes = named(now.routes, wanted[1])
        hint = suggestion(wanted[1], [route.topic for route in now.routes])
        problem = WatchingProblem.NOT_BROUGHT if now.role == "server" else RouteChoice.NOT_BRIDGED
        reasons += [rate_text(route) for route in routes] or [problem(topic=wanted[1], hint=hint)]
    if wanted[0] == "linked":
        meant = [link for link in now.links if link.name in wanted[1:] or not wanted[1:]]
        reasons += [f"{link.name}: {link.reason}" for link in meant if link.state is not State.OK]
    found = "; ".join(filter(None, reasons))
    return f": {found}" if found else ""

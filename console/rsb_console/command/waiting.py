"""The command ``wait``: until something is so."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import State
from rsb_console.command.reports import rate_text
from rsb_console.command.shell import FAILURE
from rsb_console.command.target import UsageError, attached, check_link, done, failed, named
from rsb_console.session.typed_topic import suggestion

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot

_LOOK_EVERY = 0.1


def wait(arguments: Namespace) -> int:
    """Wait, and say how it went. Returns the exit code."""
    holds = _condition(arguments.wanted)
    began = time.monotonic()
    deadline = float("inf") if arguments.timeout is None else began + arguments.timeout
    with attached(arguments, read_only=True) as engine:
        _refuse_what_cannot_be(engine, arguments.wanted)
        while not (held := holds(engine)):
            if time.monotonic() >= deadline:
                break
            time.sleep(_LOOK_EVERY)
        reason = "" if held else _why_not(engine, arguments.wanted)
    if held:
        return done(arguments, seconds=round(time.monotonic() - began, 3))
    return failed(arguments, f"not {' '.join(arguments.wanted)} within {arguments.timeout:g} s{reason}", FAILURE)


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


def _refuse_what_cannot_be(engine: RemoteEngine, wanted: list[str]) -> None:
    """Refuse a name that this bridge does not know, and that nobody else can bring.

    A client knows its topics from the start, and a server its clients; but a server learns a client's topics when they
    link, so there a topic may yet come.

    Raises:
        UsageError: it would be waited for in vain.
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
    """Whether every route of a name carries messages, however many and whoever hears them, or can be called."""
    routes = named(engine.snapshot().routes, topic)
    return bool(routes) and all(map(_carries, routes))


def _carries(route: RouteSnapshot) -> bool:
    if route.spec.kind == "topic":
        # An earlier process may have delivered the messages that the far side keeps of a latched topic.
        return route.state.flows and (route.ledger.delivered > 0 or _has_passed(route, "published"))
    return _has_passed(route, "offered")


def _has_passed(route: RouteSnapshot, name: str) -> bool:
    return any(stage.name == name and stage.done for stage in route.stages)


def _why_not(engine: RemoteEngine, wanted: list[str]) -> str:
    now = engine.snapshot()
    reasons = [engine.unreachable]
    if wanted[0] == "flowing":
        routes = named(now.routes, wanted[1])
        reasons += [rate_text(route) for route in routes] or [_not_bridged(now, wanted[1])]
    if wanted[0] == "linked":
        meant = [link for link in now.links if link.name in wanted[1:] or not wanted[1:]]
        reasons += [f"{link.name}: {link.reason}" for link in meant if link.state is not State.OK]
    found = [reason for reason in reasons if reason]
    return f": {'; '.join(found)}" if found else ""


def _not_bridged(now: Snapshot, topic: str) -> str:
    hint = suggestion(topic, [route.topic for route in now.routes])
    return f"no client has brought {topic} so far{hint}" if now.role == "server" else f"{topic} is not bridged{hint}"

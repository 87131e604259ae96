"""`call`: a service, or one of an action's or of a node's parameters, called by hand through a running bridge."""

from __future__ import annotations

import re
import sys
import time
from typing import TYPE_CHECKING, Any

from rsb_bridge.api import EngineError
from rsb_bridge.config.fields_text import read_written
from rsb_bridge.model.calls import FIELDS_LENGTH, LANES, FieldError
from rsb_console.command.reports import json_line, json_value
from rsb_console.command.shell import OK, print_error, print_line, print_lines
from rsb_console.command.target import ANSWERED_WITHIN, UsageError, attached, chosen_route, reported
from rsb_console.session.typed_topic import suggestion

if TYPE_CHECKING:
    from argparse import Namespace
    from concurrent.futures import Future

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.snapshot import RouteSnapshot

_LOOKED_EVERY, _TOLD_EVERY = 0.5, 30.0
"""s until a goal's state is looked at again, and until it is told again."""
_GOAL = re.compile(r"[0-9a-fA-F]{32}")
_NEW_GOAL = "# goal_id: "


def run(name: str, arguments: Namespace) -> int:
    """Run `call`. Returns the exit code."""
    assert name == "call"
    return reported(_call, arguments)


def _call(arguments: Namespace) -> int:
    request = sys.stdin.read(FIELDS_LENGTH + 1) if arguments.request == "-" else arguments.request
    with attached(arguments) as engine:
        route = chosen_route(engine, arguments)
        text = response(engine, route, request, _lane(route, arguments.lane), arguments.timeout)
    if arguments.json:
        goal = {"goal_id": text.splitlines()[0].removeprefix(_NEW_GOAL)} if text.startswith(_NEW_GOAL) else {}
        print_line(json_line({"ok": True, **goal, "response": json_value(data_of(text))}))
    else:
        print_lines(text.removesuffix("\n"))
    return OK


def _lane(route: RouteSnapshot, lane: str) -> str:
    """The service of a route that is meant.

    Raises:
        UsageError: it has none of that name.
    """
    if lane in (route.lanes or ("",)):
        return lane
    lanes = [each for each in route.lanes if each]
    if not lanes:
        raise UsageError(f"{route.topic} is one service: leave out --lane")
    what = f"has no {lane!r}{suggestion(lane, lanes)}" if lane else "consists of several"
    raise UsageError(f"{route.topic} {what}: say which with --lane ({', '.join(lanes)})")


def response(engine: RemoteEngine, route: RouteSnapshot, request: str, lane: str, timeout: float | None = None) -> str:
    """What a call gives, as YAML.

    Args:
        engine: the bridge.
        route: what is called.
        request: its fields, as YAML.
        lane: which of the route's services.
        timeout: s; None: what the route allows, and a goal's result may take as long as the goal.

    Raises:
        EngineError: the bridge refuses it, or there is no answer in time.
        TimeoutError: the bridge does not answer.
    """
    future = engine.call(route.key, request, lane)
    patient = any(each.patient for each in LANES[route.spec.kind] if each.name == lane)
    if timeout is None and not patient:
        return future.result(route.spec.call_timeout + ANSWERED_WITHIN)
    goal = _GOAL.search(request.replace("-", "")) if patient else None
    return _awaited(engine, route, future, timeout, goal.group().lower() if goal else "")


def _awaited(engine: RemoteEngine, route: RouteSnapshot, future: Future[str], timeout: float | None, goal: str) -> str:
    """Wait so long, and tell what becomes of the goal meanwhile."""
    began = time.monotonic()
    told, told_at = "", began
    while True:
        waited = time.monotonic() - began
        if timeout is not None and waited >= timeout:
            future.cancel()
            goes_on = "; the goal goes on, and its result can be asked for again" if goal else ""
            raise EngineError(f"{route.topic} gave no answer within {timeout:g} s{goes_on}")
        try:
            return future.result(_LOOKED_EVERY if timeout is None else min(_LOOKED_EVERY, timeout - waited))
        except TimeoutError:
            state = _state(engine, route.key, goal)
        if state and (state != told or time.monotonic() - told_at >= _TOLD_EVERY):
            told, told_at = state, time.monotonic()
            print_error(f"waiting for the result, {waited:.0f} s: the goal is {state} (Ctrl-C ends the waiting only)")


def _state(engine: RemoteEngine, key: str, goal: str) -> str:
    """A goal's, as far as the bridge knows it."""
    goals = [each for route in engine.snapshot().routes if route.key == key for each in route.goals]
    return next((each.state for each in goals if each.id == goal), "unknown here") if goal else ""


def data_of(text: str) -> Any:
    """A response as plain data; what cannot be read stays as it is."""
    try:
        data = read_written(text)
    except FieldError:
        return text
    return text if data is None else data

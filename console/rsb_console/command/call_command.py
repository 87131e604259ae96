"""The command ``call``: services and goals called by hand through a running bridge."""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import DescriptionError, hash_of_text, read_description
from rsb_bridge.config.fields_text import whole_fields
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.text import escape_text
from rsb_bridge.model.wording import Wording
from rsb_console.command.formatting import json_line, json_value
from rsb_console.command.shell import FAILURE, OK, print_error, print_line, print_lines
from rsb_console.command.target import ANSWERED_WITHIN, UsageError, attached, chosen_route, done, fields_from
from rsb_console.notation.formats import answer_report
from rsb_console.session.draft import suggestion

if TYPE_CHECKING:
    from argparse import Namespace
    from concurrent.futures import Future

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.commands import R
    from rsb_bridge.model.snapshot import RouteSnapshot

_CHECKED_EVERY, _REPORTED_EVERY = 0.5, 30.0
"""Seconds between checks of a goal's state, and between reports of an unchanged state. Round figures."""
_ALL = 1 << 25  # elements, and values: an answer has fewer bytes
_GOAL = re.compile(r"[0-9a-fA-F]{32}")


class CallProblem(Wording):
    """Reasons why a call by hand fails, or why its answer is incomplete."""

    NO_LANES = "{topic} is one service: leave out --lane"
    LANE_MISSING = "{topic} has several services: choose one with --lane ({lanes})"
    LANE_UNKNOWN = "{topic} has no service {lane!r}{hint}: choose one with --lane ({lanes})"
    CUT = "{topic} answered, and its answer is too long to be whole: {what}"


def call_service(arguments: Namespace) -> int:
    # The fields are read first, since the command's time counts from the attachment.
    request = fields_from(arguments.request)
    with attached(arguments, expires=True) as engine:
        route = chosen_route(engine, arguments)
        lane, began = _lane(route, arguments.lane), Clock.steady()
        if arguments.json:
            whole = _awaited(
                engine, route, engine.call_whole(route.key, request, lane), request, lane, arguments.timeout
            )
        else:
            text = response(engine, route, request, lane, arguments.timeout)
        report = answer_report(route, Clock.steady() - began)
    if not arguments.json:
        print_lines(text.removesuffix("\n"))
        print_error(escape_text(report))
        return OK
    try:
        description = read_description(whole.description, hash_of_text(whole.description))
    except DescriptionError as error:
        raise EngineError(CallProblem.CUT(topic=route.topic, what=error)) from None
    data, cut = whole_fields(decode(description, whole.payload, items=_ALL, steps=_ALL))
    goal = {"goal_id": whole.goal} if whole.goal else {}
    answer = {**goal, "response": json_value(data), "landed": [{"ok": True, "report": report}]}
    if cut:
        cut = CallProblem.CUT(topic=route.topic, what=cut)
        print_line(json_line({"ok": False, "error": cut, **answer}))
        return FAILURE
    return done(arguments, **answer)


def _lane(route: RouteSnapshot, lane: str) -> str:
    """Return the name of the service of a route to call. A plain service has one lane, without a name."""
    if lane in (route.lanes or ("",)):
        return lane
    lanes = [each for each in route.lanes if each]
    problem = CallProblem.LANE_UNKNOWN if lane else CallProblem.LANE_MISSING
    if not lanes:
        problem = CallProblem.NO_LANES
    hint = suggestion(lane, lanes)
    raise UsageError(problem(topic=route.topic, lane=lane, hint=hint, lanes=", ".join(lanes)))


def response(engine: RemoteEngine, route: RouteSnapshot, request: str, lane: str, timeout: float | None = None) -> str:
    """Call a service and return its response as YAML.

    Args:
        request: fields of the request, as YAML.
        lane: name of the service, if the route has several.
        timeout: s, or None for the route's own timeout, which does not limit a goal's result.
    """
    return _awaited(engine, route, engine.call(route.key, request, lane), request, lane, timeout)


def _awaited(
    engine: RemoteEngine, route: RouteSnapshot, future: Future[R], request: str, lane: str, timeout: float | None
) -> R:
    """Wait for the response of a call that has begun; `response` has the arguments."""
    patient = any(each.patient for each in LANES[route.spec.kind] if each.name == lane)
    # The bridge ends the call itself after `call_timeout`; the rest is for its own answer.
    if timeout is None and not patient:
        return future.result(route.spec.call_timeout + ANSWERED_WITHIN)
    # A goal's identifier may have the dashes of a UUID.
    goal = _GOAL.search(request.replace("-", "")) if patient else None
    return _watched(engine, route, future, timeout, goal.group().lower() if goal else "")


def _watched(engine: RemoteEngine, route: RouteSnapshot, future: Future[R], timeout: float | None, goal: str) -> R:
    """Wait for a response and report the goal's state meanwhile."""
    began = time.monotonic()
    told, told_at = "", began
    while True:
        waited = time.monotonic() - began
        if timeout is not None and waited >= timeout:
            future.cancel()
            more = "; the goal goes on, so you can ask for its result again" if goal else ""
            raise EngineError(f"{route.topic} gave no answer within {timeout:g} s{more}")
        try:
            return future.result(_CHECKED_EVERY if timeout is None else min(_CHECKED_EVERY, timeout - waited))
        except TimeoutError:
            state = _state(engine, route.key, goal)
        if state and (state != told or time.monotonic() - told_at >= _REPORTED_EVERY):
            told, told_at = state, time.monotonic()
            print_error(f"waiting for the result, {waited:.0f} s: the goal is {state} (Ctrl-C ends the waiting only)")


def _state(engine: RemoteEngine, key: str, goal: str) -> str:
    """Return a goal's state as the bridge knows it."""
    if not goal:
        return ""
    goals = (each for route in engine.snapshot().routes if route.key == key for each in route.goals)
    return next((each.state for each in goals if each.id == goal), "unknown here")

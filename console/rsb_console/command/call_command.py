"""The commands ``call`` and ``param``: services, goals and parameters called by hand through a running bridge."""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING, Any

from rsb_bridge.api import EngineError
from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import DescriptionError, hash_of_text, read_description
from rsb_bridge.config.fields_text import read_written, whole_fields
from rsb_bridge.config.yaml_text import dump_yaml, inline
from rsb_bridge.model.calls import LANES, FieldError
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.text import escape_text
from rsb_bridge.model.wording import Wording
from rsb_console.command.formatting import json_line, json_value
from rsb_console.command.shell import FAILURE, OK, print_error, print_line, print_lines
from rsb_console.command.target import ANSWERED_WITHIN, UsageError, attached, chosen_route, done, failed, fields_from
from rsb_console.notation.formats import answer_report
from rsb_console.session.draft import suggestion
from rsb_console.session.parameter_files import parameters_text
from rsb_console.session.parameter_values import KIND_NAMES, KINDS, refusal, set_request, value_of

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
_NEW_GOAL = "# goal_id: "
_AT_ONCE = 50
"""Most parameters to request in one call: a bridge cuts a long response
(`config.fields_text.STEPS`), and then the dump fails. A round figure."""


class CallProblem(Wording):
    """Reasons why a call by hand fails, or why its answer is incomplete."""

    NO_LANES = "{topic} is one service: leave out --lane"
    LANE_MISSING = "{topic} has several services: choose one with --lane ({lanes})"
    LANE_UNKNOWN = "{topic} has no service {lane!r}{hint}: choose one with --lane ({lanes})"
    UNREADABLE = "the answer of {topic} cannot be read"
    CUT = "{topic} answered, and its answer is too long to be whole: {what}"
    PARAMETER_MISSING = "{node} has no parameter {parameter}, or it has no value"
    PARAMETER_REFUSED = "{node} does not set {parameter}: {reason}"


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


def _cut(route: RouteSnapshot, text: str) -> str:
    """Name the parts of an answer that the bridge left out, or return an empty string."""
    notes = [line.removeprefix("# ") for line in text.splitlines() if line.startswith("#")]
    what = "; ".join(note for note in notes if not f"# {note}".startswith(_NEW_GOAL))
    return CallProblem.CUT(topic=route.topic, what=what) if what else ""


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


def data_of(text: str) -> Any:
    """Convert a response to plain data; unreadable text stays as it is."""
    try:
        data = read_written(text)
    except FieldError:
        return text
    return text if data is None else data


def list_parameters(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        names = names_of(engine, chosen_route(engine, arguments), whole=arguments.json)
    return done(arguments, *names, names=names)


def get_parameter(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        route = chosen_route(engine, arguments)
        value = _values(engine, route, [arguments.parameter], whole=arguments.json)[0]
    if value is None:
        problem = CallProblem.PARAMETER_MISSING(node=route.topic, parameter=arguments.parameter)
        return failed(arguments, problem, FAILURE)
    return done(arguments, inline(value), value=json_value(value))


def set_parameter(arguments: Namespace) -> int:
    if arguments.type not in ("", *KIND_NAMES):
        raise UsageError(f"{arguments.type} is not a parameter type; choose one of {', '.join(KIND_NAMES)}")
    try:
        # An empty word means an empty text; as YAML it would be no value.
        request = set_request(arguments.parameter, arguments.value or "''", arguments.type)
    except FieldError as error:
        raise UsageError(f"{arguments.value}: {error}") from None
    with attached(arguments, expires=True) as engine:
        route = chosen_route(engine, arguments)
        answer = response(engine, route, request.text, "set_parameters")
    if (why := refusal(answer)) is not None:
        problem = CallProblem.PARAMETER_REFUSED(node=route.topic, parameter=arguments.parameter, reason=why)
        return failed(arguments, problem, FAILURE)
    said = f"set {escape_text(arguments.parameter)} of {escape_text(route.topic)}: {escape_text(request.meaning)}"
    made = {"parameter": arguments.parameter, "type": request.kind, "value": json_value(request.value)}
    return done(arguments, said, node=route.topic, **made)


def dump_parameters(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        route = chosen_route(engine, arguments)
        names = sorted(names_of(engine, route, whole=True))
        values: dict[str, Any] = {}
        for at in range(0, len(names), _AT_ONCE):
            some = names[at : at + _AT_ONCE]
            values.update(zip(some, _values(engine, route, some, whole=True), strict=True))
    known = {name: value for name, value in values.items() if value is not None}
    if arguments.json:
        return done(arguments, node=route.topic, parameters=json_value(known))
    print_lines(parameters_text(route.topic, known).removesuffix("\n"))
    return OK


def describe_parameter(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        route = chosen_route(engine, arguments)
        request = dump_yaml({"names": [arguments.parameter]})
        answer = _fields(route, response(engine, route, request, "describe_parameters"))
    # For an unknown name, a node in C++ answers with no descriptor, one in Python with an empty one.
    found = answer.get("descriptors") or [{"type": 0}]
    number = found[0]["type"]
    if not 1 <= number <= len(KINDS):
        problem = CallProblem.PARAMETER_MISSING(node=route.topic, parameter=arguments.parameter)
        return failed(arguments, problem, FAILURE)
    described = {**found[0], "type": KINDS[number - 1].name}
    if arguments.json:
        return done(arguments, descriptor=json_value(described))
    print_lines(dump_yaml(described).removesuffix("\n"))
    return OK


def names_of(engine: RemoteEngine, route: RouteSnapshot, *, whole: bool = False) -> list[str]:
    """Return the names of parameters. With `whole`, an incomplete list is an error."""
    text = response(engine, route, "", "list_parameters")
    names: list[str] = _fields(route, text)["result"]["names"]
    _report_cut(route, text, whole=whole)
    return names


def _report_cut(route: RouteSnapshot, text: str, *, whole: bool) -> None:
    """Report the parts of an answer that the bridge left out: as an error, or on standard error."""
    if cut := _cut(route, text):
        if whole:
            raise EngineError(cut)
        print_error(cut)


def _values(engine: RemoteEngine, route: RouteSnapshot, names: list[str], *, whole: bool = False) -> list[Any]:
    """Return the values of parameters, None for a missing one. With `whole`, an incomplete value is an error."""
    text = response(engine, route, dump_yaml({"names": names}), "get_parameters")
    _report_cut(route, text, whole=whole)
    values = _fields(route, text).get("values") or []
    # If one name is unknown, a node in C++ answers with no values at all.
    return [value_of(each) for each in values] + [None] * (len(names) - len(values))


def _fields(route: RouteSnapshot, text: str) -> dict[str, Any]:
    fields = data_of(text)
    if not isinstance(fields, dict):
        raise EngineError(CallProblem.UNREADABLE(topic=route.topic))
    return fields

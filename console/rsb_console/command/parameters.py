"""`param`: the parameters of a bridged node, read and set through a running bridge."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rsb_bridge.api import EngineError
from rsb_bridge.config.fields_text import ITEMS
from rsb_bridge.config.yaml_text import dump_yaml, inline
from rsb_bridge.model.calls import FieldError
from rsb_console.command.calling import data_of, response
from rsb_console.command.reports import json_value
from rsb_console.command.shell import FAILURE, OK, print_error, print_line, print_lines
from rsb_console.command.target import UsageError, attached, chosen_route, done, failed, reported
from rsb_console.session.parameters import KIND_NAMES, KINDS, refusal, set_request, value_of

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.snapshot import RouteSnapshot

_AT_ONCE = 50
"""Parameters that are asked for in one call."""


def run(name: str, arguments: Namespace) -> int:
    """Run `param NAME`. Returns the exit code."""
    return reported(COMMANDS[name], arguments)


def _list(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        names = names_of(engine, chosen_route(engine, arguments))
    if arguments.json:
        return done(arguments, names=names)
    for name in names:
        print_line(name)
    return OK


def _get(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        route = chosen_route(engine, arguments)
        value = _values(engine, route, [arguments.parameter])[0]
    if value is None:
        return failed(arguments, f"{route.topic} has no parameter {arguments.parameter}, or it has no value", FAILURE)
    if arguments.json:
        return done(arguments, value=json_value(value))
    print_line(inline(value))
    return OK


def _set(arguments: Namespace) -> int:
    if arguments.type not in ("", *KIND_NAMES):
        raise UsageError(f"{arguments.type} is no type of a parameter: it is one of {', '.join(KIND_NAMES)}")
    try:
        request = set_request(arguments.parameter, arguments.value or "''", arguments.type)
    except FieldError as error:
        raise UsageError(f"{arguments.value}: {error}") from None
    with attached(arguments) as engine:
        route = chosen_route(engine, arguments)
        answer = response(engine, route, request.text, "set_parameters")
    if (why := refusal(answer)) is not None:
        return failed(arguments, f"{route.topic} does not set {arguments.parameter}: {why}", FAILURE)
    return done(arguments)


def _dump(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        route = chosen_route(engine, arguments)
        names = sorted(names_of(engine, route))
        values: dict[str, Any] = {}
        for at in range(0, len(names), _AT_ONCE):
            some = names[at : at + _AT_ONCE]
            values.update(zip(some, _values(engine, route, some, whole=True), strict=True))
    known = {name: value for name, value in values.items() if value is not None}
    if arguments.json:
        return done(arguments, node=route.topic, parameters=json_value(known))
    print_lines(dump_yaml({route.topic: {"ros__parameters": known}}).removesuffix("\n"))
    return OK


def _describe(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        route = chosen_route(engine, arguments)
        answer = _ask(engine, route, "describe_parameters", {"names": [arguments.parameter]})
    found = answer.get("descriptors") or [{"type": 0}]
    number = found[0]["type"]
    if not 1 <= number <= len(KINDS):
        return failed(arguments, f"{route.topic} has no parameter {arguments.parameter}, or it has no value", FAILURE)
    described = {**found[0], "type": KINDS[number - 1].name}
    if arguments.json:
        return done(arguments, descriptor=json_value(described))
    print_lines(dump_yaml(described).removesuffix("\n"))
    return OK


def names_of(engine: RemoteEngine, route: RouteSnapshot) -> list[str]:
    names: list[str] = _ask(engine, route, "list_parameters", {})["result"]["names"]
    if len(names) >= ITEMS:
        print_error(f"{route.topic} may have more parameters than the first {ITEMS:,}")
    return names


def _values(engine: RemoteEngine, route: RouteSnapshot, names: list[str], *, whole: bool = False) -> list[Any]:
    """The values of parameters; None: there is none. With `whole`, one that is not all there is an error."""
    text = response(engine, route, dump_yaml({"names": names}), "get_parameters")
    for note in [line.removeprefix("# ") for line in text.splitlines() if line.startswith("#")]:
        if whole:
            raise EngineError(f"too much of {route.topic} is there to dump it: {note}")
        print_error(note)
    values = _fields(route, text).get("values") or []
    return [value_of(each) for each in values] + [None] * (len(names) - len(values))


def _ask(engine: RemoteEngine, route: RouteSnapshot, lane: str, request: dict[str, Any]) -> dict[str, Any]:
    return _fields(route, response(engine, route, dump_yaml(request) if request else "", lane))


def _fields(route: RouteSnapshot, text: str) -> dict[str, Any]:
    fields = data_of(text)
    if not isinstance(fields, dict):
        raise EngineError(f"{route.topic} has answered what cannot be read")
    return fields


COMMANDS: dict[str, Callable[[Namespace], int]] = {
    "list": _list,
    "get": _get,
    "set": _set,
    "dump": _dump,
    "describe": _describe,
}

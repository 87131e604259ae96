"""`arm` and `disarm`: a topic stays armed while the command runs, and its operator gives signs of life."""

from __future__ import annotations

import os
import select
import sys
from typing import TYPE_CHECKING

from rsb_console.command.reports import json_line
from rsb_console.command.shell import FAILURE, print_line
from rsb_console.command.target import (
    all_chosen,
    attached,
    carried_out,
    chosen_route,
    done_with_all,
    failed,
    result,
)

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.snapshot import RouteSnapshot

_TOLD_EVERY = 0.5
_READ_SIZE = 4096


class _Keys:
    """Lines on standard input; once that has ended, none come any more."""

    def __init__(self) -> None:
        self._ended = False

    def wait(self, seconds: float) -> bool:
        """Wait so many s, or until there is a line; whether there was one."""
        ready, _, _ = select.select([] if self._ended else [sys.stdin.fileno()], [], [], seconds)
        if not ready:
            return False
        self._ended = not os.read(sys.stdin.fileno(), _READ_SIZE)
        return not self._ended


def arm(arguments: Namespace) -> int:
    """Arm a topic until this ends, however it does: the bridge disarms it then. Returns the exit code."""
    with attached(arguments) as engine:
        route = chosen_route(engine, arguments)
        result(engine.arming.arm(route.key))
        _say_armed(arguments, route)
        why, cause = _hold(engine, route.key)
    return failed(arguments, f"{route.topic} is not armed any more: {why}", FAILURE, cause=cause)


def _say_armed(arguments: Namespace, route: RouteSnapshot) -> None:
    if arguments.json:
        print_line(json_line({"ok": True, "armed": True, "topic": route.topic, "link": route.link}))
    else:
        deadman = route.arming.deadman if route.arming is not None else 0.0
        keys = f"press Enter within {deadman:g} s, again and again; " if deadman else ""
        print_line(f"{route.topic} of {route.link} is ARMED: {keys}Ctrl-C disarms it")
    sys.stdout.flush()


def _hold(engine: RemoteEngine, key: str) -> tuple[str, str]:
    """Keep a topic armed; return, once it is not, why, in words and as a cause."""
    keys = _Keys()
    while True:
        result(engine.arming.keep(pressed=keys.wait(_TOLD_EVERY)))
        if engine.unreachable:
            return engine.unreachable, ""
        route = next((each for each in engine.snapshot().routes if each.key == key), None)
        if route is None:
            return "it is not bridged any more", "removed"
        if route.arming is None:
            return "it need not be armed any more", ""
        if not route.arming.armed:
            return route.arming.reason or route.reason, route.arming.why


def disarm(arguments: Namespace) -> int:
    """Disarm all routes of a name. Returns the exit code."""
    with attached(arguments) as engine:
        routes = all_chosen(engine, arguments)
        carried_out([engine.arming.disarm(route.key) for route in routes])
        return done_with_all(arguments, routes, "disarmed", one=True)

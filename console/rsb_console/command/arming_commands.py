"""The commands that arm and disarm topics of a running bridge."""

from __future__ import annotations

import contextlib
import math
import os
import sys
import time
from dataclasses import asdict
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.model.by_hand import ASKED_FOR
from rsb_bridge.model.text import escape_text
from rsb_bridge.model.wording import Wording
from rsb_console.command.shell import FAILURE, print_error
from rsb_console.command.target import (
    ANSWERED_WITHIN,
    all_chosen,
    attached,
    carried_out,
    chosen_route,
    done,
    done_with,
    failed,
    result,
)
from rsb_console.notation import formats
from rsb_console.terminal.pulse import ASKED_EVERY, TypedKeys

if TYPE_CHECKING:
    from argparse import Namespace
    from concurrent.futures import Future

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.snapshot import RouteSnapshot

_SHOWN_WITHIN = 1.0
"""s from the end of an arming until the bridge's state, which comes four times a second, surely shows it."""
_ALIVE_EVERY = 1.0  # s; a console counts as gone after 5 s without a sign of life (docs/operators.md)


class ArmingNote(Wording):
    """Notes on an arming that another operator has, or asks for."""

    HELD_BY_ANOTHER = "{topic} has gone over to {who}"
    ASKED_FOR = "{who} asks for {topic}: Enter keeps it; without an answer it goes over in {seconds:g} s"


def arm_topic(arguments: Namespace) -> int:
    """Arm a topic until this process ends in any way; then the bridge disarms it."""
    try:
        typed = sys.stdin.fileno()
    except (AttributeError, OSError):  # it is closed, as of some services
        typed = os.open(os.devnull, os.O_RDONLY)
    # The console detaches first, which disarms: the terminal's last answer may take its time.
    with TypedKeys(typed, os.environ) as keys, attached(arguments, expires=True) as engine:
        route = chosen_route(engine, arguments)
        arm = engine.take_arming if arguments.take else engine.ask_holder if arguments.ask else engine.arm
        _wait_alive(engine, arm(route.key, shared=True))  # shared with `rsb-console pub` in another shell
        engine.given_at = None  # what follows is given by young keys, however long ago this one attached
        _say_armed(arguments, route)
        why, cause = _hold(engine, route, keys)
    return failed(arguments, why, FAILURE, cause=cause)


def _wait_alive(engine: RemoteEngine, arming: Future[None]) -> None:
    """Wait for an arming as `result` does, and give signs of life: the question of a silent console ends."""
    deadline = time.monotonic() + ANSWERED_WITHIN
    while time.monotonic() < deadline:
        with contextlib.suppress(TimeoutError):
            return arming.result(_ALIVE_EVERY)
        engine.keep_armed(pressed=False)
    raise TimeoutError


def _say_armed(arguments: Namespace, route: RouteSnapshot) -> None:
    deadman = route.arming.deadman if route.arming is not None else 0.0
    keys = f"press Enter within {deadman:g} s, again and again; " if deadman else ""
    now = f". {escape_text(formats.drivers_now(route))}" if route.calls is None else ""
    text = f"{route.topic} of {route.link} is ARMED: {keys}Ctrl-C disarms it{now}"
    drivers = [asdict(each) for each in route.drivers]
    done(arguments, text, armed=True, topic=route.topic, link=route.link, drivers=drivers)
    sys.stdout.flush()


def _hold(engine: RemoteEngine, route: RouteSnapshot, keys: TypedKeys) -> tuple[str, str]:
    """Keep a topic armed; once this process holds it no longer, return that with the reason, and the cause."""
    topic, asked_by, lost_at = route.topic, "", math.inf
    while True:
        pressed = keys.wait(ASKED_EVERY)
        holds = route.key in result(engine.keep_armed(pressed=pressed)).keys
        # From the first answer that has it: a bridge that hung shows its old state for a moment.
        lost_at = math.inf if holds else min(lost_at, time.monotonic())
        if pressed and asked_by:  # pressing Enter means driving
            with contextlib.suppress(EngineError):  # it is over
                result(engine.answer_asker(route.key, gives=False, who=asked_by))
        now = next((each for each in engine.snapshot().routes if each.key == route.key), None)
        if now is None or now.arming is None or not now.arming.armed or engine.unreachable:
            reason, cause = _why_disarmed(engine, now)
            return f"{topic} is no longer armed: {reason}", cause
        if time.monotonic() - lost_at > _SHOWN_WITHIN:
            return ArmingNote.HELD_BY_ANOTHER(topic=topic, who=escape_text(now.arming.by)), "held_by_another"
        if holds and now.arming.asked_by != asked_by:
            asked_by = now.arming.asked_by
            if asked_by:
                print_error(ArmingNote.ASKED_FOR(who=escape_text(asked_by), topic=topic, seconds=ASKED_FOR))


def _why_disarmed(engine: RemoteEngine, route: RouteSnapshot | None) -> tuple[str, str]:
    """Return why a topic is no longer armed, in words and as a cause."""
    if engine.unreachable:
        return engine.unreachable, ""
    if route is None:
        return "it is not bridged any more", "removed"
    if route.arming is None:
        return "arming is not required any more", ""
    # The route's reason advises to arm it again, although a colleague may just have disarmed it.
    return route.arming.reason or route.reason, route.arming.why


def disarm_topic(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        routes = all_chosen(engine, arguments)
        carried_out([engine.disarm(route.key) for route in routes])
        return done_with(arguments, routes, "disarmed")

"""The running bridge that a command is for: finds it, attaches to it, and reports errors."""

from __future__ import annotations

import contextlib
import os
import shlex
import sys
import termios
from functools import partial
from typing import TYPE_CHECKING, TypeAlias, TypeVar

from rsb_bridge.api import EngineError, InvalidRequestError
from rsb_bridge.config.keys import KeyFileError
from rsb_bridge.config.session_changes import ClientError
from rsb_bridge.config.session_file import SessionError, UnwritableError
from rsb_bridge.config.topic_rules import A_KIND
from rsb_bridge.control.bridges import ask, running_bridges
from rsb_bridge.control.control_sockets import (
    AttachProblem,
    ControlError,
    UnclearError,
    hidden_bridges,
    run_as,
    user_name,
)
from rsb_bridge.control.remote_engine import attach
from rsb_bridge.model.calls import FIELDS_LENGTH
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.names import other_side as other_side_of
from rsb_bridge.model.patterns import is_pattern
from rsb_bridge.model.snapshot import RouteSnapshot
from rsb_bridge.model.text import join_first
from rsb_bridge.model.wording import Wording
from rsb_console.command.formatting import json_line
from rsb_console.command.shell import FAILURE, NOT_RUNNING, OK, USAGE, print_error, print_line
from rsb_console.session.draft import suggestion

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from concurrent.futures import Future
    from pathlib import Path

    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.snapshot import PatternSnapshot

ANSWERED_WITHIN = 60.0
"""s. A round figure: with ten times as much, a bridge that hangs would hold up a script for ten minutes."""
Attach: TypeAlias = "Callable[[], RemoteEngine]"

T = TypeVar("T")


class BridgeChoice(Wording):
    """Reasons why a command finds no bridge, or several."""

    NONE_RUNS = "no bridge runs here that you may attach to"
    NONE_OF_YOURS_RUNS = "no bridge runs here that you may attach to; some may belong to {user}: {remedy}"
    UNKNOWN = "no bridge {name!r} runs here; these do:{running}"


class RouteChoice(Wording):
    """Reasons why a command finds no route, pattern or link, or several."""

    SEVERAL = "{topic} is bridged {count} times; choose one: {options}"
    OF_ANOTHER_KIND = "{topic} is bridged as {actual}, and not as {wanted}"
    NOT_BRIDGED = "{topic} is not bridged{hint}"
    UNKNOWN_LINK = "{bridge} has no link {name!r}, only {known}"


class Asking(Wording):
    """A question to the operator."""

    NOBODY = "no operator can answer: give {options}"


class UsageError(Exception):
    """A command that is ambiguous or invalid; the message names the remedy."""


class NoBridgeError(Exception):
    """The bridge that a command needs does not run; the message lists the running ones."""


def what_to_attach(arguments: Namespace) -> Path | Attach:
    """Return the control socket of the bridge that the arguments name, or a function that attaches to it elsewhere.

    Raises:
        ControlError: the socket that they name has no bridge.
        NoBridgeError: there is no such bridge.
        UsageError: there are several, or the file of the way to it has mistakes.
    """
    if arguments.way is None:
        return chosen_bridge(arguments).path
    arguments.way.check()  # the file's mistakes come before the console opens
    return partial(arguments.way.attach, arguments.bridge or "", read_only=arguments.readonly)


def reported(error: Exception, arguments: Namespace) -> int:
    """Report an error of a command, and return the exit code. Raise one again that no command makes."""
    # Most of these are EngineErrors, so that errors with an exit code of their own come first.
    if isinstance(error, UsageError | UnclearError | InvalidRequestError):
        return failed(arguments, str(error), USAGE)
    if isinstance(error, NoBridgeError | ControlError):
        return failed(arguments, str(error), NOT_RUNNING)
    if isinstance(error, EngineError):
        return failed(arguments, str(error), FAILURE)
    if isinstance(error, ClientError | SessionError | KeyFileError):
        # A disk or a key that refuses is no wrong usage: the same words may work later.
        code = FAILURE if isinstance(error, UnwritableError | KeyFileError) else USAGE
        return failed(arguments, str(error), code)
    if isinstance(error, TimeoutError) and "bridge" in arguments:  # else none was waited for
        return failed(arguments, AttachProblem.SILENT_FOR(seconds=ANSWERED_WITHIN), FAILURE)
    raise error


def failed(arguments: Namespace, message: str, code: int, **more: str) -> int:
    """Print the reason of a failure; `more` is for programs. Return the exit code."""
    if getattr(arguments, "json", False):
        print_line(json_line({"ok": False, "error": message} | more))
    else:
        print_error(message)
    return code


# --- which bridge


def chosen_bridge(arguments: Namespace) -> RunningBridge:
    """Return the bridge that the arguments name; raises as `what_to_attach`."""
    name, path = arguments.bridge, arguments.control
    if path is not None:
        return _answering(ask(path))
    found = running_bridges()
    chosen = [bridge for bridge in found if name in (None, bridge.name)]
    running = "".join(f"\n  {bridge}" for bridge in found)
    if not found:
        other = hidden_bridges(os.environ)
        if other is None:
            raise NoBridgeError(BridgeChoice.NONE_RUNS())
        raise NoBridgeError(BridgeChoice.NONE_OF_YOURS_RUNS(user=user_name(other), remedy=run_as(other)))
    if not chosen:
        raise NoBridgeError(BridgeChoice.UNKNOWN(name=name, running=running))
    if len({bridge.name for bridge in chosen}) < len(chosen):  # in folders of several users or services
        paths = "".join(f"\n  --control {bridge.path}  {bridge}" for bridge in chosen)
        raise UsageError(f"several bridges with this name run here; choose one:{paths}")
    if len(chosen) > 1:
        raise UsageError(f"several bridges run here; choose one with --bridge NAME:{running}")
    return _answering(chosen[0])


def _answering(bridge: RunningBridge) -> RunningBridge:
    if bridge.info is None:
        raise ControlError(f"{bridge.name} (pid {bridge.pid}): {bridge.problem}")
    return bridge


@contextlib.contextmanager
def attached(arguments: Namespace, *, read_only: bool = False, expires: bool = False) -> Iterator[RemoteEngine]:
    """Be attached to the bridge that the arguments mean, or in `fleet exec` to the robot that `arguments.attach` opens.

    A command that `expires` must not be carried out late, counted from now: a slow computer takes longer to start this
    process than a command may be old.
    """
    began = Clock.steady()
    if (attach_robot := getattr(arguments, "attach", None)) is not None:
        engine = attach_robot(read_only=read_only)
    elif (way := getattr(arguments, "way", None)) is not None:
        engine = way.attach(arguments.bridge or "", read_only=read_only)
    else:
        engine = attach(chosen_bridge(arguments).path, read_only=read_only)
    with engine:
        if expires:
            engine.given_at = began
        yield engine


def fields_from(text: str) -> str:
    """Return the fields in YAML that an argument gives, read from standard input if it is ``-``."""
    if text != "-":
        return text
    # This reads one character too many: the bridge refuses a text that is too long, but a cut one could be valid.
    return sys.stdin.read(FIELDS_LENGTH + 1)


# --- what it answers


def result(future: Future[T]) -> T:
    """Wait for the result of a command. Raise EngineError if the bridge refuses it, TimeoutError if it is silent."""
    return future.result(ANSWERED_WITHIN)


def done(arguments: Namespace, *lines: str, **results: object) -> int:
    """Report success: the lines to people, the results to programs. Return the exit code."""
    for line in [json_line({"ok": True, **results})] if arguments.json else lines:
        print_line(line)
    return OK


def agreed(question: str, options: str = "--yes", *, ask: bool = True) -> bool:
    """Return whether an operator answers yes.

    Args:
        options: the options that answer.
        ask: whether the output is for people.

    Raises:
        UsageError: nobody is there to ask.
    """
    # The output may be a file, or be collected for many robots.
    if not (ask and sys.stdin.isatty() and sys.stdout.isatty()):
        raise UsageError(Asking.NOBODY(options=options))
    # Lines that were typed ahead are for something else. Not every input that calls itself a terminal can be flushed.
    with contextlib.suppress(OSError, termios.error):
        termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)
    print_line(f"{question} [y/N]")
    sys.stdout.flush()
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def chosen_route(engine: RemoteEngine, arguments: Namespace) -> RouteSnapshot:
    """Return the route that the arguments name: by its name on this side, otherwise on the client.

    Raise UsageError if none or several have it.
    """
    routes = _routes_meant(engine, arguments)
    if len(routes) == 1:
        return routes[0]
    options = "; ".join(_which(route, routes) for route in routes)
    raise UsageError(RouteChoice.SEVERAL(topic=arguments.topic, count=len(routes), options=options))


def _routes_meant(engine: RemoteEngine, arguments: Namespace) -> list[RouteSnapshot]:
    check_link(engine, arguments.link)
    kinds = arguments.kinds if arguments.kind is None else (arguments.kind,)
    now = engine.snapshot()
    meant = [
        route
        for route in now.routes
        if arguments.link in ("", route.link)
        and arguments.direction in (None, route.spec.direction)
        and arguments.remote in (None, route.remote_topic)
    ]
    if routes := named([route for route in meant if route.spec.kind in kinds], arguments.topic):
        return routes
    if others := named(meant, arguments.topic):
        actual = join_first(sorted({A_KIND[route.spec.kind] for route in others}), len(A_KIND))
        wanted = " or ".join(A_KIND[kind] for kind in kinds)
        raise UsageError(RouteChoice.OF_ANOTHER_KIND(topic=arguments.topic, actual=actual, wanted=wanted))
    known = [route.topic for route in now.routes if route.spec.kind in kinds]
    raise UsageError(RouteChoice.NOT_BRIDGED(topic=arguments.topic, hint=suggestion(arguments.topic, known)))


def other_side(engine: RemoteEngine, link: str) -> str:
    return other_side_of(engine.bridge.role, link)


def chosen(engine: RemoteEngine, arguments: Namespace) -> RouteSnapshot | PatternSnapshot:
    """Return the route or the pattern that the arguments name. Raise UsageError if none or several do."""
    if not is_pattern(arguments.topic):
        return chosen_route(engine, arguments)
    found = _patterns_meant(engine, arguments)
    if len(found) == 1:
        return found[0]
    options = (f"--link {each.link} --direction {each.spec.direction} --kind {each.spec.kind}" for each in found)
    raise UsageError(f"{arguments.topic} is followed {len(found)} times; choose one: {'; '.join(options)}")


def all_chosen(engine: RemoteEngine, arguments: Namespace) -> Sequence[RouteSnapshot | PatternSnapshot]:
    """Return every route or pattern of a name, of all links, at least one. Raise UsageError if there is none."""
    return (_patterns_meant if is_pattern(arguments.topic) else _routes_meant)(engine, arguments)


def carried_out(commands: Iterable[Future[None]]) -> None:
    """Wait for the results of several commands, as `result` does for one."""
    failures: list[Exception] = []
    for command in commands:
        try:
            result(command)
        except (EngineError, TimeoutError) as error:
            failures.append(error)
    # An error raised earlier would detach from the bridge before the other commands are answered.
    if failures:
        raise failures[0]


def done_with(
    arguments: Namespace,
    found: Sequence[RouteSnapshot | PatternSnapshot],
    effect: str,
    *,
    note: str = "",
    **results: object,
) -> int:
    """Report a command on all routes of a name: to people a line each, of its effect and a note."""
    routes = [
        {
            "link": each.link,
            "kind": each.spec.kind,
            "direction": each.spec.direction,
            "remote_topic": each.remote_topic if isinstance(each, RouteSnapshot) else None,
        }
        for each in found
    ]
    lines = []
    for each in routes:
        there = f", {each['remote_topic']} there" if each["remote_topic"] else ""
        lines.append(f"{effect}: {arguments.topic} of {each['link']} ({each['direction']}{there}){note}")
    return done(arguments, *lines, **results | ({"routes": routes} if len(routes) > 1 else {}))


def _patterns_meant(engine: RemoteEngine, arguments: Namespace) -> list[PatternSnapshot]:
    check_link(engine, arguments.link)
    kinds = arguments.kinds if arguments.kind is None else (arguments.kind,)
    known = [
        pattern
        for link in engine.snapshot().links
        for pattern in link.patterns
        if pattern.spec.kind in kinds and arguments.link in ("", link.name)
    ]
    meant = [each for each in known if each.spec.topic == arguments.topic]
    if found := [each for each in meant if arguments.direction in (None, each.spec.direction)]:
        return found
    names = [each.spec.topic for each in known]
    raise UsageError(f"there is no pattern {arguments.topic}{suggestion(arguments.topic, names)}")


def _which(route: RouteSnapshot, others: Sequence[RouteSnapshot]) -> str:
    """Return the options that tell a route from others of its name."""
    kinds = [each.spec.kind for each in others]
    if kinds.count(route.spec.kind) == 1:
        return f"--kind {route.spec.kind}"
    kind = f" --kind {route.spec.kind}" if len(set(kinds)) > 1 else ""
    alike = [each for each in others if (each.link, each.spec.direction) == (route.link, route.spec.direction)]
    there = f" --remote {route.remote_topic}" if len(alike) > 1 else ""
    return f"--link {shlex.quote(route.link)} --direction {route.spec.direction}{kind}{there}"


def named(routes: Iterable[RouteSnapshot], topic: str) -> list[RouteSnapshot]:
    """Return the routes of a topic, by its name on the bridge's own side, otherwise by the client's name for it."""
    found = list(routes)
    return [each for each in found if each.topic == topic] or [each for each in found if each.spec.topic == topic]


def check_link(engine: RemoteEngine, name: str) -> None:
    """Raise UsageError if the bridge has no link of that name; an empty name is none."""
    known = [link.name for link in engine.snapshot().links]
    if name and name not in known:
        raise UsageError(RouteChoice.UNKNOWN_LINK(bridge=engine.name, name=name, known=", ".join(known) or "none"))

"""The command ``status``: a bridge's faults, its waits, and the states of its links and topics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.control.bridges import running_bridges
from rsb_bridge.control.control_sockets import ControlError
from rsb_bridge.control.remote_engine import attach
from rsb_bridge.model.faults import is_wrong, route_waits, state_counts
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import plural
from rsb_console.command.formatting import (
    acknowledged_by,
    clock,
    faults_first,
    json_line,
    link_fault,
    link_word,
    made_by,
    of_links_that_are_up,
    pattern_text,
    patterns_of,
    rate_text,
    refused_text,
    status_of,
    topics_of_link_that_is_down,
    where_and_why,
)
from rsb_console.command.shell import FAILURE, NOT_RUNNING, OK, print_line
from rsb_console.command.target import attached
from rsb_console.notation import formats
from rsb_console.notation.link_fact import wrong_of

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.snapshot import LinkSnapshot, PatternSnapshot, RouteSnapshot, Snapshot


def _faults(now: Snapshot) -> tuple[list[str], list[str]]:
    """Return the faults that nobody has acknowledged, and the others: a sentence each, links first, a lost link once.

    Some states are not faults: a link or a topic that waits for its first connection or message, a topic without a
    subscriber, and the wishes of operators: a pause, a limit, a disarmed topic.
    """
    if not now.running:
        return ["the bridge is stopped"], []
    texts: list[tuple[LinkSnapshot | PatternSnapshot | RouteSnapshot, str]] = [
        *((link, f"link {link.name} {link_fault(link)}") for link in now.links),
        *((pattern, pattern_text(pattern)) for pattern in patterns_of(now)),
        *((route, rate_text(route)) for route in of_links_that_are_up(now)),
    ]
    wrong = [(each.acknowledged is not None, text) for each, text in texts if is_wrong(each)]
    return [text for known, text in wrong if not known], [text for known, text in wrong if known]


def print_status(arguments: Namespace) -> int:
    """Print the status of a bridge, or of all on this machine. Return the exit code, which shows any fault."""
    named = [getattr(arguments, name, None) for name in ("bridge", "control", "way", "attach")]
    if all(each is None for each in named) and len(several := running_bridges()) > 1:
        return _status_of_all(several, arguments)
    with attached(arguments, read_only=True) as engine:
        faults, lines, figures = _status_of(engine)
    for line in [json_line(figures)] if arguments.json else lines:
        print_line(line)
    return FAILURE if faults else OK


def _status_of_all(bridges: list[RunningBridge], arguments: Namespace) -> int:
    """Print the status of each bridge. Return the worst exit code."""
    codes: list[int] = []
    figures: list[dict[str, object]] = []
    for bridge in bridges:
        try:
            if bridge.info is None:
                raise ControlError(bridge.problem)
            with attach(bridge.path, read_only=True) as engine:
                faults, lines, of_bridge = _status_of(engine)
        except (ControlError, EngineError, TimeoutError) as error:
            codes.append(NOT_RUNNING)
            lines = [f"{bridge.name}: pid {bridge.pid}, {bridge.path}", f"  {str(error) or 'it does not answer'}"]
            of_bridge = {"ok": False, "name": bridge.name, "pid": bridge.pid, "error": str(error)}
        else:
            codes.append(FAILURE if faults else OK)
        figures.append(of_bridge)
        for line in () if arguments.json else lines:
            print_line(line)
    if arguments.json:
        print_line(json_line({"ok": not any(codes), "bridges": figures}))
    return max(codes)  # worse ones are higher: 0, 1 with a fault, 3 without an answer


def _unsaved(now: Snapshot) -> str:
    there = formats.unsaved_there(now)
    return f"{', not saved' if now.unsaved else ''}{f', not saved on {there}' if there else ''}"


def _status_of(engine: RemoteEngine) -> tuple[list[str], list[str], dict[str, object]]:
    """Return a bridge's faults, its status as lines, and the same as data."""
    now, bridge = engine.snapshot(), engine.bridge
    faults, known = _faults(now)
    # These wait for their first connection or message.
    waits = [f"link {link.name} {link_fault(link)}" for link in now.links if link.state is State.WAITING]
    waits += [rate_text(route) for route in of_links_that_are_up(now) if route_waits(route)]
    about = {key: getattr(bridge, key) for key in ("role", "pid", "started", "file", "program")}
    figures = {"ok": not faults, "wrong": faults, "acknowledged": known, "waiting": waits, "name": engine.name, **about,
               "address": now.address, "domain_id": now.domain_id,
               "running": now.running, "time": now.time, **status_of(now)}  # fmt: skip
    file = f", {bridge.file}" if bridge.file else ""
    lines = [
        f"{engine.name}: {bridge.role}, {now.address}, domain {now.domain_id}, pid {bridge.pid}",
        f"  since {clock(bridge.started)}{file}{_unsaved(now)}",
        f"  {_in_short(now, faults, known, waits)}",
    ]
    for link in now.links:
        lines.append(f"  link {link.name} {link_word(link)}{where_and_why(link)}{acknowledged_by(link)}")
        lines += [f"    ! {text}" for text in wrong_of(link)]
        if waits_for_link := topics_of_link_that_is_down(now, link):
            lines.append(f"    {waits_for_link}")
    lines += [f"  {refused_text(client)}" for client in now.refused]
    shown = faults_first(of_links_that_are_up(now))
    lines += [f"  {rate_text(route)}{made_by(route)}{acknowledged_by(route)}" for route in shown]
    lines += [f"  {pattern_text(pattern)}{acknowledged_by(pattern)}" for pattern in patterns_of(now)]
    return faults, lines, figures


def _in_short(now: Snapshot, faults: list[str], known: list[str], waits: list[str]) -> str:
    """Return the numbers of faults, acknowledged faults and waiting things in words."""
    if not now.running:
        return "STOPPED"
    parts = [f"{len(faults)} {plural(len(faults), 'thing')} wrong" if faults else "nothing is wrong"]
    if unheard := state_counts(now.routes).get(State.UNHEARD):
        parts.append(f"{unheard} unheard")
    if known:
        parts.append(f"{len(known)} acknowledged")
    if refused := len(now.refused):
        parts.append(f"{refused} {plural(refused, 'client')} refused")
    if waits:
        parts.append(f"{len(waits)} {'waits' if len(waits) == 1 else 'wait'}")
    return ", ".join(parts)

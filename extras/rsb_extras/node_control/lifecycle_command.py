"""The command ``lifecycle``: lists managed nodes and groups, and changes their states."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from msgspec.structs import asdict

from rsb_bridge.feature_api import EngineError, Wording
from rsb_console.feature_console import (
    FAILURE,
    OK,
    UsageError,
    agreed,
    attached,
    chosen_side,
    done,
    json_line,
    print_error,
    print_line,
    print_problems,
    problems_of,
    result,
    side_of,
    table_lines,
)
from rsb_extras.node_control.change_records import ChangeText
from rsb_extras.node_control.change_requests import ANSWERED_WITHIN, ChangeNodes, ListManaged
from rsb_extras.node_control.lifecycle_rows import HEADINGS, LifecycleText, outcomes, rows

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator, Sequence
    from concurrent.futures import Future

    from rsb_bridge.feature_api import RemoteEngine
    from rsb_extras.node_control.change_records import ChangeOutcome, ChangeStep
    from rsb_extras.node_control.change_requests import ManagedSide

_LOOKED_EVERY = 1.0  # s between two looks at the steps of a change. A round figure


class LifecycleUsage(Wording):
    NAME_MISSING = "lifecycle {action}: name the node or the group"
    UNKNOWN = "there is no managed node and no group {name}{problems}; there are: {known}"
    SEVERAL = "{count} sides have {name}; choose one: {options}"


def lifecycle(arguments: Namespace) -> int:
    if arguments.action and arguments.target is None:
        raise UsageError(LifecycleUsage.NAME_MISSING(action=arguments.action))
    with attached(arguments) as engine:
        sides = result(engine.do(ListManaged(arguments.link, arguments.here)))
        if not arguments.action:
            return _list(engine, arguments, sides)
        return _change(engine, arguments, _chosen(arguments, sides))


def _list(engine: RemoteEngine, arguments: Namespace, sides: Sequence[ManagedSide]) -> int:
    role = engine.bridge.role
    problems = problems_of(sides, arguments.link)
    if arguments.json:
        nodes = [{"link": side.link} | asdict(each) for side in sides for each in side.managed.nodes]
        groups = [{"link": side.link} | asdict(each) for side in sides for each in side.managed.groups]
        return done(arguments, nodes=nodes, groups=groups, problems=problems)
    for line in _lines(role, sides):
        print_line(line)
    print_problems(role, problems)
    return OK


def _lines(role: str, sides: Sequence[ManagedSide]) -> Iterator[str]:
    table = [row.cells for row in rows(role, sides)]
    return table_lines(HEADINGS, table) if table else iter([LifecycleText.NONE()])


def _chosen(arguments: Namespace, sides: Sequence[ManagedSide]) -> str:
    """Return the link whose other side has the node or the group, or an empty string for this side."""
    names = [(side.link, each.name) for side in sides for each in side.managed.targets]
    texts = LifecycleUsage
    return chosen_side(arguments.target, names, sides, several=texts.SEVERAL, unknown=texts.UNKNOWN)


def _change(engine: RemoteEngine, arguments: Namespace, link: str) -> int:
    target, action, side = arguments.target, arguments.action, side_of(engine.bridge.role, link)
    question = LifecycleText.ASK(action=action.capitalize(), target=target, side=side)
    if not (arguments.yes or agreed(question, ask=not arguments.json)):
        return FAILURE
    answer = engine.do(ChangeNodes(target, action, link))
    if arguments.json:
        outcome = answer.result(ANSWERED_WITHIN)
        ok = outcome.done
        found = asdict(outcome) | {"target": target, "link": link, "steps": [asdict(each) for each in outcome.steps]}
        error = found.pop("reason")
        del found["is_over"]
        print_line(json_line({"ok": ok} | ({} if ok else {"error": error}) | found))
        return OK if ok else FAILURE
    outcome = _followed(engine, link, target, answer)
    text = LifecycleText.ENDED(target=target, side=side, text=ChangeText.of(action, outcome))
    (print_line if outcome.done else print_error)(text)
    return OK if outcome.done else FAILURE


def _followed(engine: RemoteEngine, link: str, target: str, answer: Future[ChangeOutcome]) -> ChangeOutcome:
    """Print the steps of a change as they come, and return its outcome."""
    printed, until = 0, time.monotonic() + ANSWERED_WITHIN
    while True:
        try:
            outcome = answer.result(_LOOKED_EVERY)
        except TimeoutError:
            if time.monotonic() > until:
                raise
        else:
            _print(outcome.steps[printed:])
            return outcome
        try:
            sides = result(engine.do(ListManaged(link, here=not link)))
        except EngineError:
            continue  # the link is lost: the change goes on, and its answer comes over the next one
        found = outcomes(sides).get(f"{link} {target}")
        if found is not None and not found[1].is_over:
            _print(found[1].steps[printed:])
            printed = max(printed, len(found[1].steps))


def _print(steps: Sequence[ChangeStep]) -> None:
    for each in steps:
        print_line(f"  {ChangeText.of_step(each)}")

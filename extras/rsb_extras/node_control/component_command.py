"""The command ``component``: lists containers, and loads and unloads their components."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import asdict

from rsb_bridge.feature_api import Wording
from rsb_console.feature_console import (
    FAILURE,
    SideText,
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
from rsb_extras.node_control.change_records import ChangeText, Component
from rsb_extras.node_control.change_requests import ANSWERED_WITHIN, ChangeNodes, ListManaged
from rsb_extras.node_control.component_rules import halves, parameter_of
from rsb_extras.node_control.lifecycle_rows import NOTHING, LifecycleText

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator, Sequence

    from rsb_bridge.feature_api import RemoteEngine
    from rsb_extras.node_control.change_records import ComponentAction, Container
    from rsb_extras.node_control.change_requests import ManagedSide
    from rsb_extras.node_control.parameter_records import NewValues


class ComponentText(Wording):
    """Texts of the command."""

    NONE = "neither side has containers"
    UNKNOWN = "there is no container {name}{problems}; there are: {known}"
    SEVERAL = "{count} sides have {name}; choose one: {options}"
    LOAD = "Load {what} into {container} of {side}?"
    UNLOAD = "Unload {what} from {container} of {side}? Its node ends."


def list_all(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        sides, role = _sides(engine, arguments), engine.bridge.role
        wanted = [arguments.node] if arguments.node else []
        if wanted and not (arguments.link or arguments.here):
            _chosen(arguments, sides)
    shown = [(side, each) for side in sides for each in side.managed.containers if each.name in (wanted or [each.name])]
    problems = problems_of(sides, arguments.link)
    rows = [row for side, each in shown for row in _rows(side_of(role, side.link), each)]
    if not arguments.json:
        print_problems(role, problems)
    lines = table_lines(("CONTAINER", "SIDE", "COMPONENT", ""), rows) if rows else [ComponentText.NONE()]
    containers = [{"link": side.link} | asdict(each) for side, each in shown]
    return done(arguments, *lines, containers=containers, problems=problems)


def _rows(side: str, container: Container) -> Iterator[tuple[str, ...]]:
    right = "" if container.allowed else SideText.NO_RIGHT()
    none = NOTHING if container.answers else LifecycleText.NO_ANSWER()
    for at, node in enumerate(container.nodes or (none,)):
        yield (container.name, side, node, right) if at == 0 else ("", "", node, "")


def _sides(engine: RemoteEngine, arguments: Namespace) -> tuple[ManagedSide, ...]:
    return result(engine.do(ListManaged(arguments.link, arguments.here)))


def _chosen(arguments: Namespace, sides: Sequence[ManagedSide]) -> str:
    """Return the link whose other side has the container, or an empty string for this side."""
    names = [(side.link, each.name) for side in sides for each in side.managed.containers]
    return chosen_side(arguments.node, names, sides, several=ComponentText.SEVERAL, unknown=ComponentText.UNKNOWN)


def load_all(arguments: Namespace) -> int:
    component = Component(
        arguments.package, arguments.plugin, arguments.name, arguments.namespace, tuple(arguments.remap),
        arguments.intra_process,
    )  # fmt: skip
    try:
        for rule in arguments.remap:
            halves(rule, "from:=to")
        values = tuple(map(parameter_of, arguments.param))
    except ValueError as error:
        raise UsageError(str(error)) from None
    return _change(arguments, "load", component, values)


def unload_all(arguments: Namespace) -> int:
    return _change(arguments, "unload", Component(name=arguments.component))


def _change(arguments: Namespace, action: ComponentAction, component: Component, values: NewValues = ()) -> int:
    with attached(arguments) as engine:
        link = _chosen(arguments, _sides(engine, arguments))
        side, loads = side_of(engine.bridge.role, link), action == "load"
        what = f"{component.package} {component.plugin}" if loads else component.name
        text = ComponentText.LOAD if loads else ComponentText.UNLOAD
        question = text(what=what, container=arguments.node, side=side)
        if not (arguments.yes or agreed(question, ask=not arguments.json)):
            return FAILURE
        command = ChangeNodes(arguments.node, action, link, values, component)
        outcome = engine.do(command).result(ANSWERED_WITHIN)
    ended = LifecycleText.ENDED(target=arguments.node, side=side, text=ChangeText.of(action, outcome))
    loaded = outcome.steps[0].node if outcome.done and outcome.steps else ""
    facts = {"container": arguments.node, "link": link, "node": loaded, "seconds": outcome.seconds}
    if outcome.done:
        steps = [f"  {ChangeText.of_step(each)}" for each in outcome.steps]
        return done(arguments, *steps, ended, **facts)
    if arguments.json:
        failed = {"ok": False, "error": outcome.reason, "refused": outcome.refused}
        print_line(json_line(failed | facts))
    else:
        print_error(ended)
    return FAILURE

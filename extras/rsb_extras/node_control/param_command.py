"""The command ``param``: reads and sets parameters of nodes, and compares them with files."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from msgspec.structs import asdict

from rsb_bridge.feature_api import EngineError, Wording, dump_yaml, one_line, replace_file, typed_path, why_not_written
from rsb_console.feature_console import (
    FAILURE,
    OK,
    SideText,
    UsageError,
    agreed,
    attached,
    chosen_side,
    done,
    failed,
    json_line,
    json_value,
    parameter_value,
    parameters_text,
    print_error,
    print_line,
    print_lines,
    print_problems,
    problems_of,
    read_parameter_file,
    result,
    shown_value,
    side_of,
    table_lines,
)
from rsb_extras.node_control.change_records import ChangeText
from rsb_extras.node_control.change_requests import ANSWERED_WITHIN, ChangeNodes
from rsb_extras.node_control.lifecycle_rows import LifecycleText
from rsb_extras.node_control.parameter_records import NodeParameter
from rsb_extras.node_control.parameter_requests import ListParameterNodes, ReadParameters
from rsb_extras.node_control.parameter_rules import (
    ParameterText,
    about,
    change_of,
    compare,
    plain_value,
    value_text,
)
from rsb_extras.node_control.target_names import bridged_parameters, own_name

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from rsb_bridge.feature_api import RemoteEngine
    from rsb_extras.node_control.parameter_requests import ParameterSide
    from rsb_extras.node_control.parameter_rules import Comparison, ParameterChange

_ANY_LENGTH = 1 << 30  # characters: a value is printed whole
_READ_WITHIN = 120.0  # s for all pages of a node over a thin line. A round figure


class ParamText(Wording):
    """Texts of the command."""

    NONE = "neither side has nodes with parameters"
    UNKNOWN = "no side that shows its nodes has {name} with parameters{problems}; there are: {known}"
    SEVERAL = "{count} sides have {name}; choose one: {options}"
    MISSING = "{node} has no parameter {names}"
    NEW = "{node} has no parameter {names}: if it takes new ones, give --type"
    NO_VALUE = "{name} of {node} is not set"
    PAIRS = "param set: {name} has no value: give names and values in turn"
    WRONG = "{name} of {node} cannot be set: {reason}"
    TOO_LARGE = "{node}: {names} cannot be read: larger than a link carries"
    ASK = "Set {count} of {node} of {side}?"
    NOTHING = "{node} of {side}: nothing to set"
    SAME = "{node} of {side}: all {count} values of the file are the node's"
    NOT_WRITTEN = "{path}: {problem}"
    WRITTEN = "{path}: {count} parameters of {node}"


def list_all(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        role = engine.bridge.role
        if arguments.node is None:
            return _list_nodes(arguments, role, result(engine.do(ListParameterNodes(arguments.link))))
        link, found = _read(engine, arguments)
    rows = [(each.name, value_text(each), each.value.type, about(each)) for each in found]
    return done(
        arguments, *_table(("NAME", "VALUE", "TYPE", "ABOUT"), rows), node=arguments.node, link=link,
        parameters=[_plain(each) for each in found],
    )  # fmt: skip


def _list_nodes(arguments: Namespace, role: str, sides: Sequence[ParameterSide]) -> int:
    shown = [side for side in sides if not (arguments.here and side.link)]
    problems = problems_of(shown, arguments.link)
    rows = [
        (each.name, side_of(role, side.link), "" if each.allowed else SideText.NO_RIGHT())
        for side in shown
        for each in side.nodes
    ]
    nodes = [{"link": side.link} | asdict(each) for side in shown for each in side.nodes]
    lines = list(_table(("NAME", "SIDE", ""), rows)) if rows else [ParamText.NONE()]
    if not arguments.json:
        print_problems(role, problems)
    return done(arguments, *lines, nodes=nodes, problems=problems)


def _table(headings: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    return table_lines(headings, (tuple(map(one_line, row)) for row in rows))


def _plain(parameter: NodeParameter) -> dict[str, Any]:
    """Return a parameter for programs."""
    found = asdict(parameter) | {"type": parameter.value.type, "value": json_value(plain_value(parameter))}
    bounds = [asdict(each) for each in found.pop("ranges")]
    return found | {"range": bounds[0] if bounds else None}


def _read(
    engine: RemoteEngine, arguments: Namespace, *names: str, whole: bool = False, missing: Wording = ParamText.MISSING
) -> tuple[str, Any]:
    """Return the link to the node's side, or an empty string for this one, and parameters of the node.

    Args:
        missing: raised if it lacks one of the names, unless the command gives a type to new ones.
    """
    link = arguments.link if arguments.link or arguments.here else _chosen(engine, arguments.node)
    answer = engine.do(ReadParameters(own_name(engine, link, arguments.node), names, whole, link))
    found: tuple[NodeParameter, ...] = answer.result(_READ_WITHIN)
    lacking = {*names} - {each.name for each in found}
    if lacking and not getattr(arguments, "type", ""):
        raise EngineError(missing(node=arguments.node, names=", ".join(sorted(lacking))))
    return link, found


def _chosen(engine: RemoteEngine, node: str) -> str:
    sides = result(engine.do(ListParameterNodes()))
    listed = [(side.link, each.name) for side in sides for each in side.nodes]
    names = dict.fromkeys((*listed, *bridged_parameters(engine)))
    return chosen_side(node, names, sides, several=ParamText.SEVERAL, unknown=ParamText.UNKNOWN)


def get_all(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        link, found = _read(engine, arguments, *arguments.names, whole=True)
    if arguments.json:
        return done(arguments, node=arguments.node, link=link, parameters=[_plain(each) for each in found])
    if not _is_whole(arguments, found):
        return FAILURE
    values = {each.name: plain_value(each) for each in found}
    if len(values) > 1:
        print_lines(parameters_text(arguments.node, values).removesuffix("\n"))
        return OK
    ((name, value),) = values.items()
    if value is None:
        raise EngineError(ParamText.NO_VALUE(name=name, node=arguments.node))
    print_line(shown_value(value, _ANY_LENGTH))
    return OK


def describe_all(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        link, found = _read(engine, arguments, *arguments.names)
    described = {each.name: _plain(each) for each in found}
    for each in described.values():
        for of_value in ("name", "value", "size"):
            del each[of_value]
    lines = dump_yaml(described).splitlines() if described else ()
    return done(arguments, *lines, node=arguments.node, link=link, parameters=described)


def _is_whole(arguments: Namespace, found: Iterable[NodeParameter]) -> bool:
    """Whether all values are read; report the others."""
    large = [each.name for each in found if each.size]
    if large:
        print_error(ParamText.TOO_LARGE(node=arguments.node, names=", ".join(large)))
    return not large


def dump_all(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        link, found = _read(engine, arguments, whole=True)
    values = {each.name: plain for each in found if (plain := plain_value(each)) is not None}
    text = parameters_text(arguments.node, values)
    if arguments.output is None and not arguments.json:
        print_lines(text.removesuffix("\n"))
        return OK if _is_whole(arguments, found) else FAILURE
    if arguments.output is not None:
        path = typed_path(str(arguments.output))
        try:
            replace_file(path, text.encode(), mode=0o644)
        except OSError as error:
            problem = ParamText.NOT_WRITTEN(path=path, problem=why_not_written(error, path))
            return failed(arguments, problem, FAILURE)
    written = ParamText.WRITTEN(path=arguments.output, count=len(values), node=arguments.node)
    done(arguments, written, node=arguments.node, link=link, parameters=json_value(values))
    return OK if _is_whole(arguments, found) else FAILURE


def set_all(arguments: Namespace) -> int:
    pairs = arguments.pairs
    if len(pairs) % 2:
        raise UsageError(ParamText.PAIRS(name=pairs[-1]))
    texts = dict(zip(pairs[::2], pairs[1::2], strict=True))
    with attached(arguments) as engine:
        link, found = _read(engine, arguments, *texts, whole=True, missing=ParamText.NEW)
        known = {name: NodeParameter(name) for name in sorted(texts)} | {each.name: each for each in found}
        changes: list[ParameterChange] = []
        for each in known.values():
            try:
                if each.read_only:
                    raise ValueError(ParameterText.READ_ONLY())
                changes.append(change_of(each, partial(_meant, texts[each.name], arguments.type)))
            except ValueError as error:
                raise EngineError(ParamText.WRONG(name=each.name, node=arguments.node, reason=error)) from None
        return _set(engine, arguments, link, changes, {})


def _meant(text: str, given: str, kind: str) -> tuple[str, Any]:
    return parameter_value(text, given or kind)


def diff_all(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        written = read_parameter_file(typed_path(str(arguments.file)), arguments.node)
        link, found = _read(engine, arguments, whole=True)
        side = side_of(engine.bridge.role, link)
    compared = compare(found, written)
    lines = [*map(str, compared.changes), *_left_out({**compared.left_out, **compared.wrong})]
    same = ParamText.SAME(node=arguments.node, side=side, count=compared.equal)
    changed = [_changed(each) for each in compared.changes]
    if arguments.json:
        print_line(json_line(
            {"ok": True, "node": arguments.node, "link": link, "differences": changed,
             "left_out": {**compared.left_out, **compared.wrong}, "equal": compared.equal}
        ))  # fmt: skip
    else:
        for line in lines or [same]:
            print_line(line)
    return FAILURE if lines else OK


def _left_out(reasons: Mapping[str, str]) -> list[str]:
    return [ParameterText.LEFT_OUT(name=name, reason=reason) for name, reason in reasons.items()]


def _changed(change: ParameterChange) -> dict[str, Any]:
    old, new = json_value(change.old), json_value(change.new)
    return {"name": change.name, "type": change.type, "old": old, "new": new}


def load_all(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        written = read_parameter_file(typed_path(str(arguments.file)), arguments.node)
        link, found = _read(engine, arguments, whole=True)
        compared: Comparison = compare(found, written)
        for name, reason in compared.wrong.items():
            raise EngineError(ParamText.WRONG(name=name, node=arguments.node, reason=reason))
        if not arguments.json:
            for line in _left_out(compared.left_out):
                print_error(line)
        return _set(engine, arguments, link, compared.changes, compared.left_out)


def _set(
    engine: RemoteEngine,
    arguments: Namespace,
    link: str,
    changes: Sequence[ParameterChange],
    left_out: Mapping[str, str],
) -> int:
    """Set what differs, after a question."""
    node, side = arguments.node, side_of(engine.bridge.role, link)
    facts = {
        "node": node, "link": link, "changed": [_changed(each) for each in changes], "left_out": {**left_out},
    }  # fmt: skip
    if not changes:
        return done(arguments, ParamText.NOTHING(node=node, side=side), **facts)
    if not arguments.json:
        for each in changes:
            print_line(f"  {each}")
    question = ParamText.ASK(count=len(changes), node=node, side=side)
    if not (arguments.yes or agreed(question, ask=not arguments.json)):
        return FAILURE
    values = tuple(each.value for each in changes)
    target = own_name(engine, link, node)
    outcome = engine.do(ChangeNodes(target, "set", link, values)).result(ANSWERED_WITHIN)
    if not outcome.done:
        facts["changed"] = []
        if arguments.json:
            print_line(json_line({"ok": False, "error": outcome.reason, "refused": outcome.refused, **facts}))
        else:
            print_error(LifecycleText.ENDED(target=node, side=side, text=ChangeText.of("set", outcome)))
        return FAILURE
    return done(
        arguments, LifecycleText.ENDED(target=node, side=side, text=ChangeText.of("set", outcome)),
        seconds=outcome.seconds, **facts,
    )  # fmt: skip

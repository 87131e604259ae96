"""Files of parameters, as `ros2 param dump` writes them and `ros2 param load` and launch files read them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from rsb_bridge.config.yaml_text import SessionError, YamlError, compose, dump_yaml, read_text
from rsb_bridge.model.session import Problem
from rsb_bridge.model.text import join_first, one_line
from rsb_bridge.model.wording import Wording
from rsb_console.session.parameter_values import value_of_node

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

_KEY = "ros__parameters"
_ANY = "/**"
_DEEPEST = 10  # groups in one another: what reads it has `MAX_DEPTH` for all
_NAMED = 5  # nodes in a message


class ParameterFileProblem(Wording):
    EMPTY = "has no parameters: write a node's name, then ros__parameters, then names and values"
    NO_MAPPING = "is no mapping of names"
    KEY = "a name is one word or text"
    OF_OTHERS = "has no parameters of {node}, but of {nodes}"
    TWICE = "{name} has two values"


class WrittenValue(NamedTuple):
    """A value in a file, which means something once its type is known."""

    node: yaml.Node

    def meant(self, kind: str = "") -> tuple[str, Any]:
        """Return the type and the value as plain data; `parameter_values.parameter_value` has the rest."""
        return value_of_node(self.node, kind)


def parameters_text(node: str, values: Mapping[str, Any]) -> str:
    """Return a file with a node's parameters, whose names are nested at their points."""
    nested: dict[str, Any] = {}
    for name, value in values.items():
        *groups, last = name.split(".")
        inner = nested
        # If one of the groups is a parameter itself, the whole name is the key.
        if len(groups) > _DEEPEST or any(".".join(groups[: at + 1]) in values for at in range(len(groups))):
            groups, last = [], name
        for group in groups:
            inner = inner.setdefault(group, {})
        inner[last] = value
    return dump_yaml({node: {_KEY: nested}})


def read_parameter_file(path: Path, node: str) -> dict[str, WrittenValue]:
    """Return the values that a file has for a node, those for any node (``/**``) first, by their names.

    Raises:
        SessionError: the file cannot be read, or has no parameters of the node.
    """
    try:
        root = compose(read_text(path))
    except YamlError as error:
        raise SessionError(path, [Problem("", str(error), error.line)]) from None
    try:
        return _parameters_of(root, node)
    except YamlError as error:
        raise SessionError(path, [Problem("", str(error), error.line)]) from None


def _parameters_of(root: yaml.Node | None, node: str) -> dict[str, WrittenValue]:
    sections = list(_sections(root, "")) if root is not None else []
    if not sections:
        raise YamlError(ParameterFileProblem.EMPTY(), None)
    found: dict[str, WrittenValue] = {}
    for wanted in (_ANY, node):
        own: dict[str, WrittenValue] = {}
        for name, section in sections:
            if name == wanted:
                _collect(section, "", own)
        found |= own
    if not {name for name, _ in sections} & {_ANY, node}:
        others = join_first([one_line(name) for name, _ in sections], _NAMED)
        raise YamlError(ParameterFileProblem.OF_OTHERS(node=node, nodes=others), None)
    return found


def _items(node: yaml.Node) -> Iterator[tuple[str, yaml.Node]]:
    if not isinstance(node, yaml.MappingNode):
        raise YamlError(ParameterFileProblem.NO_MAPPING(), node.start_mark.line + 1)
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise YamlError(ParameterFileProblem.KEY(), key.start_mark.line + 1)
        yield str(key.value), value


def _sections(node: yaml.Node, name: str) -> Iterator[tuple[str, yaml.Node]]:
    """Yield the parameters of each node, whose name may be nested in its namespaces'."""
    for key, value in _items(node):
        if key == _KEY:
            yield name or "/", value
        elif isinstance(value, yaml.MappingNode):
            yield from _sections(value, f"{name}/{key.strip('/')}")


def _collect(node: yaml.Node, prefix: str, into: dict[str, WrittenValue]) -> None:
    for key, value in _items(node):
        name = f"{prefix}{key}"
        if isinstance(value, yaml.MappingNode):
            _collect(value, f"{name}.", into)
        elif name in into:
            raise YamlError(ParameterFileProblem.TWICE(name=name), value.start_mark.line + 1)
        else:
            into[name] = WrittenValue(value)

"""Completes names of managed nodes, groups, containers and components, and of nodes with parameters and these."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.command.completion import asked_of_bridge
from rsb_console.feature_console import result
from rsb_extras.node_control.change_requests import ListManaged
from rsb_extras.node_control.parameter_requests import ListParameterNodes, ReadParameters

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator

    from rsb_bridge.feature_api import RemoteEngine
    from rsb_extras.node_control.change_records import Container


def target_names(parsed_args: Namespace, **_: object) -> list[str]:
    """Return the groups and managed nodes of both sides of a bridge."""

    def names(engine: RemoteEngine) -> list[str]:
        sides = [side.managed for side in result(engine.do(ListManaged()))]
        return [each.name for side in sides for each in side.targets]

    return asked_of_bridge(parsed_args, names)


def containers(parsed_args: Namespace, **_: object) -> list[str]:
    """Return the containers of both sides of a bridge."""
    return asked_of_bridge(parsed_args, lambda engine: [each.name for each in _containers(engine)])


def components(parsed_args: Namespace, **_: object) -> list[str]:
    """Return the components of the container that is named."""

    def names(engine: RemoteEngine) -> list[str]:
        return [node for each in _containers(engine) if each.name == parsed_args.node for node in each.nodes]

    return asked_of_bridge(parsed_args, names)


def _containers(engine: RemoteEngine) -> list[Container]:
    return [each for side in result(engine.do(ListManaged())) for each in side.managed.containers]


def nodes_with_parameters(parsed_args: Namespace, **_: object) -> list[str]:
    """Return the nodes with parameters of both sides of a bridge."""

    def names(engine: RemoteEngine) -> list[str]:
        listed = [each.name for side in result(engine.do(ListParameterNodes())) for each in side.nodes]
        return [*dict.fromkeys((*listed, *(name for _, name in bridged_parameters(engine))))]

    return asked_of_bridge(parsed_args, names)


def parameter_names(parsed_args: Namespace, **_: object) -> list[str]:
    """Return the parameters of the node that is named."""
    node, link, here = parsed_args.node, getattr(parsed_args, "link", ""), getattr(parsed_args, "here", False)

    def names(engine: RemoteEngine) -> list[str]:
        sides = result(engine.do(ListParameterNodes(link)))
        having = [side.link for side in sides if node in {each.name for each in side.nodes}]
        having += [each for each, name in bridged_parameters(engine) if name == node and each == (link or each)]
        chosen = [each for each in having if not (here and each)]
        if not chosen:
            return []
        of_node = own_name(engine, chosen[0], node)
        return [each.name for each in result(engine.do(ReadParameters(of_node, link=chosen[0])))]

    return asked_of_bridge(parsed_args, names)


def bridged_parameters(engine: RemoteEngine) -> Iterator[tuple[str, str]]:
    """Yield the links and the names on this side of the other sides' nodes whose parameters are bridged."""
    for route in engine.snapshot().routes:
        if route.spec.kind == "parameters" and route.outgoing:
            yield route.link, route.topic


def own_name(engine: RemoteEngine, link: str, node: str) -> str:
    """Return the name that a node has on its own side, if it is bridged under another one."""
    for route in engine.snapshot().routes:
        if route.spec.kind == "parameters" and route.outgoing and (route.link, route.topic) == (link, node):
            return route.remote_topic
    return node

"""Rules on the groups of a session and on the right to change nodes, and what `check` says of both."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.name_rules import name_problems
from rsb_bridge.feature_api import Wording, one_line
from rsb_extras.node_control import GROUPS, MAY_CHANGE
from rsb_extras.node_control.change_records import GROUP_NAME, MOST_GROUPS, MOST_OF_GROUP

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.feature_api import Client, Session


class GroupRulesText(Wording):
    TOO_MANY = "has {count} groups: at most {most}"
    NAME = "{name} is no name of a group: 1 to 63 letters, digits, _ and -"
    EMPTY = "has no node: list at least one"
    TOO_MANY_NODES = "has {count} nodes: at most {most}"
    TWICE = "{node} stands in it already: a node has one place in the order"
    NO_GROUP = "{name} is no group of this session: list it under groups, or give a node's full name, /part/part"
    ORDER = "group {name}: up configures and activates {nodes}, one after the other; down goes back in reverse"
    MAY = "{peer} may change states and parameters of: {names}"


def problems(session: Session) -> Iterator[tuple[str, str]]:
    """Yield the mistakes, as `Feature.problems`."""
    groups = GROUPS.of(session)
    if len(groups) > MOST_GROUPS:
        yield GROUPS.name, GroupRulesText.TOO_MANY(count=len(groups), most=MOST_GROUPS)
    for name, nodes in groups.items():
        place = f"{GROUPS.name}.{name}"
        if GROUP_NAME.fullmatch(name) is None:
            yield place, GroupRulesText.NAME(name=one_line(name))
        if not nodes:
            yield place, GroupRulesText.EMPTY()
        if len(nodes) > MOST_OF_GROUP:
            yield place, GroupRulesText.TOO_MANY_NODES(count=len(nodes), most=MOST_OF_GROUP)
        for at, node in enumerate(nodes):
            yield from _node_problems(node, f"{place}[{at}]")
            if node in nodes[:at]:
                yield f"{place}[{at}]", GroupRulesText.TWICE(node=one_line(node))
    holders: list[tuple[str, Session | Client]] = [("may.nodes", session)]
    holders += [(f"clients[{at}].may.nodes", each) for at, each in enumerate(session.listed_clients)]
    for place, holder in holders:
        for at, name in enumerate(MAY_CHANGE.of(holder)):
            if "/" in name:
                yield from _node_problems(name, f"{place}[{at}]")
            elif name not in groups:
                yield f"{place}[{at}]", GroupRulesText.NO_GROUP(name=one_line(name))


def _node_problems(node: str, place: str) -> Iterator[tuple[str, str]]:
    yield from ((each.location, each.message) for each in name_problems(node, place, "parameters"))


def effects(session: Session) -> Iterator[str]:
    """Yield the order of each group, and the peers that may change nodes."""
    for name, nodes in GROUPS.of(session).items():
        yield GroupRulesText.ORDER(name=name, nodes=", ".join(nodes))
    clients = session.accepted_clients if session.role == "server" else ()
    holders = [(client.name, MAY_CHANGE.of(client)) for client in clients] or [("the server", MAY_CHANGE.of(session))]
    for peer, names in holders:
        if names:
            yield GroupRulesText.MAY(peer=peer, names=", ".join(names))

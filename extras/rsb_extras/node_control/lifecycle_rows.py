"""Managed nodes and groups in words, for the command and the screen."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import Wording, plural
from rsb_console.feature_console import SideText, side_of
from rsb_extras.node_control.change_records import (
    LIFECYCLE_ACTIONS,
    ChangeAction,
    ChangeOutcome,
    ComponentAction,
    LifecycleAction,
    ListedGroup,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_extras.node_control.change_records import ManagedNode
    from rsb_extras.node_control.change_requests import ManagedSide

HEADINGS = "NAME", "SIDE", "STATE", "NOW POSSIBLE"
NOTHING = "-"
_OF_GROUPS: tuple[LifecycleAction, ...] = "up", "down"


class LifecycleText(Wording):
    NONE = "neither side has managed nodes or containers, or lists groups in its session file"
    ASK = "{action} {target} of {side}?"
    ENDED = "{target} of {side}: {text}"
    NO_ANSWER = "no answer"
    COMPONENT = "component"
    COMPONENTS = "{count} {noun}"


class LifecycleRow(NamedTuple):
    """A group, a managed node, a container or a component of one side.

    Attributes:
        link: the link to it, or empty for this side.
        state: in words.
        actions: those that are possible now.
        container: the one in which a component is, or that it is itself, or empty.
        of_container: what is possible there.
        may_load: whether the container may be changed.
        is_managed: whether it has states; a container or a component may have none.
    """

    link: str
    side: str
    name: str
    state: str
    allowed: bool
    actions: tuple[LifecycleAction, ...]
    nodes: tuple[str, ...] = ()
    container: str = ""
    of_container: tuple[ComponentAction, ...] = ()
    may_load: bool = False
    is_managed: bool = True

    @property
    def key(self) -> str:
        return f"{self.link} {self.name}"

    @property
    def cells(self) -> tuple[str, ...]:
        possible = " ".join(self.actions) or NOTHING
        return self.name, self.side, self.state, possible if self.allowed else SideText.NO_RIGHT()


def rows(role: str, sides: Sequence[ManagedSide]) -> Iterator[LifecycleRow]:
    """Yield the groups of each side, and its managed nodes."""
    for side in sides:
        managed, name = side.managed, side_of(role, side.link)
        known = {node.name: node for node in managed.nodes}
        under_way = _under_way(side)
        for each in managed.targets:
            nodes: tuple[str, ...] = ()
            if isinstance(each, ListedGroup):
                state, actions, nodes = _group_state(each, known), _OF_GROUPS, each.nodes
            else:
                state, actions = each.state or LifecycleText.NO_ANSWER(), _possible(each.offers)
            if each.name in under_way:
                state, actions = under_way[each.name], ()
            yield LifecycleRow(side.link, name, each.name, state, each.allowed, actions, nodes)


def _components(count: int) -> str:
    return LifecycleText.COMPONENTS(count=count, noun=plural(count, "component"))


def _under_way(side: ManagedSide) -> dict[str, str]:
    changes = side.managed.changes
    return {each.target: f"{each.action} under way" for each in changes if not each.outcome.is_over}


def with_components(role: str, sides: Sequence[ManagedSide]) -> Iterator[LifecycleRow]:
    """Yield the same rows, and those of containers and of components, which may be managed nodes, too."""
    of_node = {
        (side.link, node): each for side in sides for each in side.managed.containers for node in each.nodes
    }  # fmt: skip
    seen = set[tuple[str, str]]()
    for row in rows(role, sides):
        seen.add((row.link, row.name))
        container = of_node.get((row.link, row.name))
        if container is None:
            yield row
        else:
            yield row._replace(container=container.name, of_container=("unload",), may_load=container.allowed)
    for side in sides:
        under_way, name = _under_way(side), side_of(role, side.link)
        for each in side.managed.containers:
            count = _components(len(each.nodes)) if each.answers else LifecycleText.NO_ANSWER()
            state = under_way.get(each.name, count)
            row = LifecycleRow(side.link, name, each.name, state, each.allowed, (), is_managed=False)
            is_free = each.answers and each.name not in under_way
            yield row._replace(container=each.name, of_container=("load",) if is_free else (), may_load=each.allowed)
            for node in each.nodes:
                if (side.link, node) not in seen:
                    state = LifecycleText.COMPONENT()
                    row = LifecycleRow(side.link, name, node, state, each.allowed, (), is_managed=False)
                    yield row._replace(container=each.name, of_container=("unload",), may_load=each.allowed)


def _possible(offers: Sequence[str]) -> tuple[LifecycleAction, ...]:
    return tuple(each for each in LIFECYCLE_ACTIONS if each in offers)


def _group_state(group: ListedGroup, known: dict[str, ManagedNode]) -> str:
    """Return how many of a group's nodes are in each state: ``2 active, 1 inactive``."""
    states = Counter(
        known[name].state or LifecycleText.NO_ANSWER() if name in known else "missing" for name in group.nodes
    )
    return ", ".join(f"{count} {state}" for state, count in states.items())


def outcomes(sides: Sequence[ManagedSide]) -> dict[str, tuple[ChangeAction, ChangeOutcome]]:
    """Return the newest change of each target, by the key of its row."""
    return {
        f"{side.link} {each.target}": (each.action, each.outcome) for side in sides for each in side.managed.changes
    }

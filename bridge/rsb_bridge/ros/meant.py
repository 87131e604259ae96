"""What an operator may have meant by the name of a service, an action or a node that nobody serves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.patterns import is_hidden
from rsb_bridge.ros.graph import Searches, most_similar
from rsb_bridge.ros.graph_entries import CALLED

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.session import Kind
    from rsb_bridge.ros.api import RosInterface

_OTHER: dict[Kind, str] = {
    "service": "a service: list it under services",
    "action": "an action: list it under actions",
    "parameters": "a node: list it under parameters",
}


class Meant:
    """Looks for what has the name and is of another kind, or has a similar name.

    Args:
        ros: whose graph is searched.
        now: gives the time in s.
    """

    def __init__(self, ros: RosInterface, now: Callable[[], float]) -> None:
        self._ros = ros
        self._searches = Searches(self._search, now)

    def by(self, kind: Kind, name: str) -> str:
        """A hint for an operator; empty: there is none, or nobody has looked yet, which takes its turn."""
        return self._searches.of((kind, name))

    def _search(self, asked: tuple[Kind, str]) -> str:
        kind, name = asked
        services = self._ros.services()
        for other in CALLED:
            if other != kind and name + _lead(other) in services and self._ros.servers(name + _lead(other)):
                return f"{name} is {_OTHER[other]}"
        suffix = _lead(kind)
        names = {each.removesuffix(suffix) for each in services if each.endswith(suffix)} - {name, ""}
        visible = (each for each in names if not is_hidden(each))
        similar = most_similar(name, visible, lambda each: self._ros.servers(each + suffix))
        return f"did you mean {similar}?" if similar else ""


def _lead(kind: Kind) -> str:
    """What the first service of a kind has behind the name."""
    return LANES[kind][0].suffix

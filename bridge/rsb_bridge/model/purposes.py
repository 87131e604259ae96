"""The purposes of routes: what a route carries, and which rules apply to it.

A route whose purpose is not `TOPIC` is an internal route: it crosses the link as a topic does, sealed, limited and
counted, and joins no topic of ROS. A feature may add a purpose, and the `rsb_bridge.link.extension.Extension` that
serves it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from rsb_bridge.installed_features import added

if TYPE_CHECKING:
    from collections.abc import Mapping

_NAME_LENGTH = 64


@dataclass(frozen=True, slots=True)
class Purpose:
    """A purpose of routes."""

    name: str  # the purpose in proposals, and the first part of its routes' names
    in_graph: bool = False
    """Whether ROS nodes have its names. Only then, the rules of topics hold: of their names, prefixes and types, of
    rights by pattern, of demands to arm, of loops, and of sessions."""
    is_shown: bool = True  # whether operators see its routes as rows, in the history and in the log
    fills_link: bool = False  # whether it fills the link on purpose, which then does not count as full
    type_name: str = ""  # the type of its messages, which is installed nowhere, or an empty string for topics
    type_hash: str = ""

    def route_name(self, *parts: str) -> str:
        """Return the name of an internal route. It begins with no slash, so that it is no name of a topic."""
        return "/".join((self.name, *parts))

    def has_name(self, name: str) -> bool:
        """Whether `route_name` could have made a name."""
        return len(name) <= _NAME_LENGTH and re.fullmatch(rf"{self.name}(/[a-z0-9-]+)+", name) is not None


TOPIC = Purpose("topic", in_graph=True)  # messages and calls of ROS nodes


@cache
def purposes() -> Mapping[str, Purpose]:
    """Return all purposes by name, features' last."""
    of_features = added("purposes", name_of=lambda purpose: purpose.name, taken=[TOPIC.name])
    return {each.name: each for each in (TOPIC, *of_features)}

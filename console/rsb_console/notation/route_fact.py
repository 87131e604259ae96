"""Lines on topics, services and the like that features add."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from rsb_bridge.installed_features import added

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.model.snapshot import RouteSnapshot


@dataclass(frozen=True, slots=True)
class RouteFact:
    """A fact without a column, among a topic's details and in ``info``.

    Attributes:
        label: its name there.
        line: formats it; an empty one leaves it out.
    """

    label: str
    line: Callable[[RouteSnapshot], str]


OF_CORE: Final = (
    "Type", "Type hash", "State", "Requires arming", "ARMED by", "By hand", "Direction", "Carried by", "Link", "Rate",
    "Bytes", "Waits for", "Drivers", "QoS of the bridge", "Latency", "Ledger",
)  # fmt: skip
"""The core's own names."""
ADDED_FACTS: Final[tuple[RouteFact, ...]] = added("route_facts", name_of=lambda fact: fact.label, taken=OF_CORE)


def facts_of(route: RouteSnapshot) -> Iterator[tuple[str, str]]:
    """Yield the labels and lines of features' facts."""
    for fact in ADDED_FACTS:
        if line := fact.line(route):
            yield fact.label, line

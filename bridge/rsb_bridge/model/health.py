"""What of an engine's state is a fault, for whoever sums it up: `rsb-console status`, a fleet."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.model.snapshot import LinkSnapshot, PatternSnapshot, RouteSnapshot

_NOTHING_WRONG = frozenset({State.WAITING, State.PAUSED, State.DISARMED, State.DISARMING, State.OK})


def state_counts(things: Iterable[RouteSnapshot | LinkSnapshot]) -> dict[State, int]:
    """Count the routes or links in each state, the worst first. A console, a fleet and `status` all show this.

    Empty states and acknowledged faults are left out.
    """
    counts = Counter(thing.state for thing in things if thing.acknowledged is None)
    return {state: counts[state] for state in State if counts[state]}


def link_is_wrong(link: LinkSnapshot) -> bool:
    """Whether a link has a fault, be it up or down. One that waits for its first connection has none."""
    return link.state not in _NOTHING_WRONG or bool(link.warning)


def pattern_is_wrong(pattern: PatternSnapshot) -> bool:
    """Whether a pattern has a fault; one that matches nothing has none."""
    return pattern.state not in _NOTHING_WRONG


def route_is_wrong(route: RouteSnapshot) -> bool:
    """Whether a route has a fault: not what nobody has begun to use, and not what an operator wants."""
    if route.state is State.UNHEARD:
        return route.cause != Cause.NO_SUBSCRIBER
    return route.state not in _NOTHING_WRONG and not route_waits(route)


def route_needs_attention(route: RouteSnapshot) -> bool:
    """Whether a route has a fault that no operator has acknowledged."""
    return route.acknowledged is None and route_is_wrong(route)


def link_needs_attention(link: LinkSnapshot) -> bool:
    """Whether a link has a fault that no operator has acknowledged."""
    return link.acknowledged is None and link_is_wrong(link)


def pattern_needs_attention(pattern: PatternSnapshot) -> bool:
    """Whether a pattern has a fault that no operator has acknowledged."""
    return pattern.acknowledged is None and pattern_is_wrong(pattern)


def route_waits(route: RouteSnapshot) -> bool:
    """Whether it waits for its first message, for however long; unless its entry says how long is too long."""
    if route.state is State.STALE:
        return route.age is None and not route.spec.stale_after
    return route.state is State.WAITING

"""Whether something is wrong with a bridge: what `status` says by its exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.faults import (
    link_is_wrong,
    link_needs_attention,
    pattern_is_wrong,
    pattern_needs_attention,
    route_is_wrong,
    route_needs_attention,
    route_waits,
)
from rsb_bridge.model.snapshot import State
from rsb_console.command.reports import link_fault, of_links_that_are_up, pattern_text, patterns_of, rate_text

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import Snapshot


def wrong(now: Snapshot) -> list[str]:
    """List the faults that nobody has acknowledged, a sentence each: links first, and a lost link once.

    Some states are not faults: a link or a topic that waits for its first connection or message, a topic without a
    subscriber, and the wishes of operators: a pause, a limit, a disarmed topic.
    """
    if not now.running:
        return ["the bridge is stopped"]
    links = [f"link {link.name} {link_fault(link)}" for link in now.links if link_needs_attention(link)]
    patterns = [pattern_text(each) for each in patterns_of(now) if pattern_needs_attention(each)]
    return links + patterns + [rate_text(route) for route in of_links_that_are_up(now) if route_needs_attention(route)]


def acknowledged(now: Snapshot) -> list[str]:
    """List the acknowledged faults, a sentence each."""
    if not now.running:
        return []
    links = [f"link {each.name} {link_fault(each)}" for each in now.links if each.acknowledged and link_is_wrong(each)]
    patterns = [pattern_text(each) for each in patterns_of(now) if each.acknowledged and pattern_is_wrong(each)]
    routes = [route for route in of_links_that_are_up(now) if route.acknowledged and route_is_wrong(route)]
    return links + patterns + [rate_text(route) for route in routes]


def waiting(now: Snapshot) -> list[str]:
    """What waits for its first connection or message, each in a sentence."""
    links = [f"link {link.name} {link_fault(link)}" for link in now.links if link.state is State.WAITING]
    return links + [rate_text(route) for route in of_links_that_are_up(now) if route_waits(route)]

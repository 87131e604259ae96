"""Whether something is wrong with a bridge: what `status` says by its exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_console.command.reports import link_fault, of_links_that_are_up, pattern_text, patterns_of, rate_text

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot, Snapshot

_NOTHING_WRONG = frozenset({State.WAITING, State.PAUSED, State.DISARMED, State.OK})


def wrong(now: Snapshot) -> list[str]:
    """What is wrong, each in a sentence: links first; the topics of a link that is down are not named again.

    What nobody has begun to use is not wrong: a link or a topic that waits for its first connection or message, and a
    topic without a subscriber. Nor is what an operator wants: a pause, a limit, a
    topic that nobody has armed.
    """
    if not now.running:
        return ["the bridge is stopped"]
    links = [f"link {link.name} {link_fault(link)}" for link in now.links if _link_is_wrong(link)]
    patterns = [pattern_text(each) for each in patterns_of(now) if each.state not in _NOTHING_WRONG]
    return links + patterns + [rate_text(route) for route in of_links_that_are_up(now) if _route_is_wrong(route)]


def waiting(now: Snapshot) -> list[str]:
    """What waits for its first connection or message, each in a sentence."""
    links = [f"link {link.name} {link_fault(link)}" for link in now.links if link.state is State.WAITING]
    return links + [rate_text(route) for route in of_links_that_are_up(now) if _waits(route)]


def _link_is_wrong(link: LinkSnapshot) -> bool:
    return link.state not in _NOTHING_WRONG or bool(link.warning)


def _route_is_wrong(route: RouteSnapshot) -> bool:
    if route.state is State.UNHEARD:
        return route.cause != Cause.NO_SUBSCRIBER
    return route.state not in _NOTHING_WRONG and not _waits(route)


def _waits(route: RouteSnapshot) -> bool:
    """Whether it waits for its first message, for however long; unless its entry says how long is too long."""
    if route.state is State.STALE:
        return route.age is None and not route.spec.stale_after
    return route.state is State.WAITING

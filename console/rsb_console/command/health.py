"""Whether something is wrong with a bridge: what `status` says by its exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.health import link_is_wrong, pattern_is_wrong, route_is_wrong, route_waits
from rsb_bridge.model.snapshot import State
from rsb_console.command.reports import link_fault, of_links_that_are_up, pattern_text, patterns_of, rate_text

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import Snapshot


def wrong(now: Snapshot) -> list[str]:
    """What is wrong, each in a sentence: links first; the topics of a link that is down are not named again.

    What nobody has begun to use is not wrong: a link or a topic that waits for its first connection or message, and a
    topic without a subscriber. Nor is what an operator wants: a pause, a limit, a
    topic that nobody has armed.
    """
    if not now.running:
        return ["the bridge is stopped"]
    links = [f"link {link.name} {link_fault(link)}" for link in now.links if link_is_wrong(link)]
    patterns = [pattern_text(each) for each in patterns_of(now) if pattern_is_wrong(each)]
    return links + patterns + [rate_text(route) for route in of_links_that_are_up(now) if route_is_wrong(route)]


def waiting(now: Snapshot) -> list[str]:
    """What waits for its first connection or message, each in a sentence."""
    links = [f"link {link.name} {link_fault(link)}" for link in now.links if link.state is State.WAITING]
    return links + [rate_text(route) for route in of_links_that_are_up(now) if route_waits(route)]

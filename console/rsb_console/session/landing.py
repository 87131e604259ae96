"""Reports of messages and calls by hand, from the other sides of their routes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.text import join_first
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Collection

    from rsb_bridge.model.snapshot import Ledger, RouteSnapshot, Snapshot

REPORTED_WITHIN = 3.0
"""s in which the other side reports a message, unless the link hangs: it reports once a second."""
_NAMED = 3  # nodes in a report; the others are counted. A round figure


class LandingText(Wording):
    """Reports on messages by hand at the other side of a link."""

    DELIVERED = "{link}: given to DDS there{age}; {subscribers}"
    SUBSCRIBED = "subscribed by {nodes}"
    DROPPED = "{link}: dropped: {cause}"
    UNREPORTED = "{link}: not reported within {seconds:g} s"
    ANSWERED = "{link}: answered by {nodes} {where}, after {seconds:.3g} s"
    THERE, HERE = "there", "on this side"


class Landing:
    """Follows messages that are published from now on.

    Args:
        topic: their topic on this side.
        snapshot: the state before the first one.
    """

    def __init__(self, topic: str, snapshot: Snapshot) -> None:
        self._topic = topic
        self._before = {each.key: each.ledger for each in self._routes(snapshot)}

    def _routes(self, snapshot: Snapshot) -> list[RouteSnapshot]:
        return [each for each in snapshot.routes if each.outgoing and each.topic == self._topic and each.calls is None]

    def is_known(self, snapshot: Snapshot, links: Collection[str]) -> bool:
        """Whether all routes of some links have reported at least one message."""
        return all(self._report(each) for each in self._routes(snapshot) if each.link in links)

    def reports(self, snapshot: Snapshot, links: Collection[str]) -> list[tuple[bool, str]]:
        """Return whether messages were given to DDS at the end of each route, with a text."""
        return [
            self._report(each) or (False, LandingText.UNREPORTED(link=each.link, seconds=REPORTED_WITHIN))
            for each in self._routes(snapshot)
            if each.link in links
        ]

    def _report(self, route: RouteSnapshot) -> tuple[bool, str] | None:
        """Return a route's report, or None if it has none yet."""
        before = self._before.get(route.key)
        if cause := _dropped_since(before, route.ledger):
            return False, LandingText.DROPPED(link=route.link, cause=cause)
        if route.ledger.delivered <= (0 if before is None else before.delivered):
            return None
        age = "" if route.latency_p50 is None else f", {route.latency_p50 * 1e3:.0f} ms old"
        nodes = join_first(route.subscribers, _NAMED)
        subscribers = LandingText.SUBSCRIBED(nodes=nodes) if nodes else "no subscription there"
        return True, LandingText.DELIVERED(link=route.link, age=age, subscribers=subscribers)


def answered(route: RouteSnapshot, seconds: float) -> str:
    """Return the report of a call that was answered.

    Args:
        seconds: from the call to its answer.
    """
    nodes = join_first(route.subscribers, _NAMED) or "a node"
    where = LandingText.THERE() if route.outgoing else LandingText.HERE()
    return LandingText.ANSWERED(link=route.link, nodes=nodes, where=where, seconds=seconds)


def _dropped_since(before: Ledger | None, now: Ledger) -> str:
    """Return a cause for which messages were dropped since then, or an empty string."""
    earlier = {} if before is None else before.dropped
    causes = [cause for cause, count in now.dropped.items() if count > earlier.get(cause, 0)]
    if not causes and now.expired > (0 if before is None else before.expired):
        return "too old"
    return causes[0] if causes else ""

"""Publishing by hand with tickets, and reports of where the messages went."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import Clock, EngineError, Wording, join_first
from rsb_bridge.model.audience import NOBODY, Audience
from rsb_bridge.model.by_hand import OLD_AFTER
from rsb_console.notation import formats
from rsb_extras.driving.publish_requests import Publish

if TYPE_CHECKING:
    from collections.abc import Collection

    from rsb_bridge.feature_api import EngineApi, RouteSnapshot, Snapshot
    from rsb_bridge.model.snapshot import Ledger
    from rsb_extras.driving.publish_requests import Published

TRIES = 3
"""Tickets for one message: a slow way to the bridge may make one too old."""
REPORTED_WITHIN = 3.0
"""s in which the other side reports a message, unless the link hangs: it reports once a second."""
_NODES_NAMED = 3  # nodes in a report; the others are counted. A round figure


class ByHandText(Wording):
    """Texts about messages by hand."""

    NO_SESSION = "no session runs"
    TOO_SLOW = "not published on {topic}: the bridge answers too slowly, or this console stood still"


class HearingText(Wording):
    """Texts about who hears a message."""

    HEARD = "heard by {nodes}"
    HEARD_BY_SOME = "heard by {count} of {nodes}"
    NOT_HEARD = "not heard by {node} ({reason})"
    NO_SUBSCRIPTION = "no subscription"


class LandingText(Wording):
    """Reports on messages by hand at the other side of a link."""

    DELIVERED = "{link}: given to DDS there{age}; {hearing}"
    DROPPED = "{link}: dropped: {cause}"
    UNREPORTED = "{link}: not reported within {seconds:g} s"


async def publish(engine: EngineApi | None, topic: str, fields: str, type_name: str = "", ticket: int = 0) -> Published:
    """Publish a message, with a new ticket if the one before has become too old.

    Raises:
        EngineError: the engine refuses it.
    """
    if engine is None:
        raise EngineError(ByHandText.NO_SESSION())
    began = Clock.steady()
    for _ in range(TRIES):
        published = await asyncio.wrap_future(engine.do(Publish(topic, fields, type_name, ticket)))
        if published.is_done:
            return published
        # A console that stood still would get a new ticket for an old command, and a ticket would prove nothing.
        if Clock.steady() - began > OLD_AFTER:
            break
        ticket = published.ticket
    raise EngineError(ByHandText.TOO_SLOW(topic=topic))


class Landed(NamedTuple):
    """A report on messages by hand at the other side of a link.

    Attributes:
        audience: the subscriptions there; empty if no message was given to DDS there, as far as this side knows.
    """

    link: str
    text: str
    audience: Audience = NOBODY

    @property
    def is_heard(self) -> bool:
        return self.audience.count > 0


def hearing(audience: Audience) -> str:
    """Return who hears a message, and who does not, for which reason."""
    found, nodes = [], join_first(audience.nodes, _NODES_NAMED)
    if audience.count >= len(audience.nodes) > 0:
        found.append(HearingText.HEARD(nodes=nodes))
    elif audience.count:
        found.append(HearingText.HEARD_BY_SOME(count=audience.count, nodes=nodes or "the subscriptions"))
    found += [HearingText.NOT_HEARD(node=each.node or "a node", reason=each.reason) for each in audience.deaf]
    return "; ".join(found) or HearingText.NO_SUBSCRIPTION()


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

    def is_settled(self, snapshot: Snapshot, links: Collection[str]) -> bool:
        """Whether they have, and know for good who hears it."""
        reports = [self._report(each) for each in self._routes(snapshot) if each.link in links]
        return all(each is not None and each.audience.is_settled for each in reports)

    def reports(self, snapshot: Snapshot, links: Collection[str]) -> list[Landed]:
        """Describe the fate of messages at the end of each route."""
        return [
            self._report(each) or Landed(each.link, LandingText.UNREPORTED(link=each.link, seconds=REPORTED_WITHIN))
            for each in self._routes(snapshot)
            if each.link in links
        ]

    def _report(self, route: RouteSnapshot) -> Landed | None:
        """Return a route's report, or None if it has none yet."""
        before = self._before.get(route.key)
        if cause := _dropped_since(before, route.ledger):
            return Landed(route.link, LandingText.DROPPED(link=route.link, cause=cause))
        if route.ledger.delivered <= (0 if before is None else before.delivered):
            return None
        latency = route.latency_p50
        age = "" if latency is None else f", {formats.latency(latency, route.latency_uncertainty)} old"
        text = LandingText.DELIVERED(link=route.link, age=age, hearing=hearing(route.audience))
        return Landed(route.link, text, route.audience)


def _dropped_since(before: Ledger | None, now: Ledger) -> str:
    """Return a cause for which messages were dropped since then, or an empty string."""
    earlier = {} if before is None else before.dropped
    causes = [cause for cause, count in now.dropped.items() if count > earlier.get(cause, 0)]
    if not causes and now.expired > (0 if before is None else before.expired):
        return "too old"
    return causes[0] if causes else ""

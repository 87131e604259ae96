"""What every half of a route knows, each of its own side."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.route.arming import SAID, Disarmed
from rsb_bridge.route.stages import accepted_stage
from rsb_bridge.route.verdict import Facts
from rsb_bridge.wire.headers import LEASE_FEATURE

if TYPE_CHECKING:
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.topic_route import TopicRoute


class Standing(NamedTuple):
    """How a route stands, whatever it carries: what `Facts` of topics and of calls have in common, named as there."""

    sends: bool
    topic: str
    domain_id: int
    link_down: str
    refusal: str
    loop: str
    paused: bool
    paused_by: str
    disarmed: str
    disarming: bool
    can_be_armed: bool
    no_path: str
    waits_for: str
    limit: float
    limited_by: str


def standing_of(route: Route) -> Standing:
    """What any half knows."""
    now = route.context.now()
    stands, overdue = route.arming.stands(now), route.arming.overdue(now)
    why_not = _why_not_armable(route)
    return Standing(
        sends=route.outgoing,
        topic=route.local_topic,
        domain_id=route.context.domain_id,
        link_down="" if route.peer.linked else route.peer.down_reason or "the link is down",
        refusal=route.standing_refusal,
        loop=route.notices.loop,
        paused=route.paused,
        paused_by=route.pausing.who,
        disarmed="" if stands else SAID[why_not] if why_not else SAID[overdue] if overdue else route.arming.reason,
        disarming=route.settling.under_way
        or (route.outgoing and route.arming.armed and overdue is not None and not stands),
        can_be_armed=why_not is None,
        no_path=_trouble(route),
        waits_for="" if route.flowing else _first_missing(route),
        limit=route.limit.rate,
        limited_by=route.limit.why,
    )


def _why_not_armable(route: Route) -> Disarmed | None:
    """Return the reason why no operator can arm it now, whoever tries, or None."""
    if LEASE_FEATURE not in route.peer.features:
        return Disarmed.PEER_TOO_OLD
    return Disarmed.LINK_SLOW if route.arming.why is Disarmed.LINK_SLOW else None


def facts_of(route: TopicRoute) -> Facts:
    """What either half of a topic knows; each adds its own."""
    known = route.life.described
    return Facts(
        **standing_of(route)._asdict(),
        endpoints=route.endpoints,
        type_name=route.type_name if known else "",
        qos=route.qos if known else None,
        flowing=route.flowing,
        came=route.came,
        came_before=route.came_before,
        stale_since=_stale_since(route),
        yielded=route.yielding.shown(),
        late=route.late(),
        expired=route.age.late() if route.flowing else None,
        full=route.link_full,
        shown_cause=route.judged.shown_cause,
    )


def _trouble(route: Route) -> str:
    """Return the reason why its channel does not get through; a stream that waits on a full link is none."""
    return "" if route.link_full is not None and route.transport.reliable else route.trouble()


def _first_missing(route: Route) -> str:
    """What has to come before anything can cross; a step that has failed before one that is open."""
    missing = [stage for stage in route.stages() if not stage.done]
    first = next((stage for stage in missing if stage.done is False), None)
    if first is None and route.awaits_report:
        return "the other side's report" if route.accepted else accepted_stage(route).name
    first = first or next(iter(missing), None)
    return (first.detail or first.name) if first else ""


def _stale_since(route: TopicRoute) -> float | None:
    if not route.flowing or not route.silence_counts:
        return None
    return route.silence.stale_since(route.context.now())

"""What both halves of a route know, each of its own side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.route.verdict import Facts

if TYPE_CHECKING:
    from rsb_bridge.route.route import Route


def facts_of(route: Route) -> Facts:
    """What any half knows; each half adds its own."""
    known = route.life.described
    return Facts(
        sends=route.outgoing,
        topic=route.local_topic,
        domain_id=route.context.domain_id,
        endpoints=route.endpoints,
        link_down="" if route.peer.linked else route.peer.down_reason or "the link is down",
        refusal=route.refusal,
        loop=route.notices.loop,
        paused=route.paused,
        no_path=route.trouble(),
        waits_for="" if route.flowing else _first_missing(route),
        type_name=route.type_name if known else "",
        qos=route.qos if known else None,
        flowing=route.flowing,
        came=route.meter.last is not None and route.meter.last >= route.opened_at,
        stale_since=_stale_since(route),
        limit=route.proposal.max_rate,
    )


def _first_missing(route: Route) -> str:
    """What has to come before messages can flow; a step that has failed before one that is open."""
    missing = [stage for stage in route.stages() if not stage.done]
    first = next((stage for stage in missing if stage.done is False), next(iter(missing), None))
    return (first.detail or first.name) if first else ""


def _stale_since(route: Route) -> float | None:
    if not route.flowing or route.is_latched or not route.stale.stale(route.context.now()):
        return None
    return route.stale.quiet_since

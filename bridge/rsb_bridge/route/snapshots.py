"""Routes as user interfaces show them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import RouteSnapshot

if TYPE_CHECKING:
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.topic_route import TopicRoute


def snapshot_of(route: Route) -> partial[RouteSnapshot]:
    """The route as it is now, but for what depends on what it carries."""
    now = route.context.now()
    verdict, from_peer = route.judged.shown(route.verdict())
    return partial(
        RouteSnapshot,
        key=route.key,
        link=route.peer.name,
        topic=route.local_topic,
        remote_topic=route.remote_topic if route.outgoing else route.topic,
        outgoing=route.outgoing,
        spec=route.spec,
        state=verdict.state,
        reason=verdict.said(now),
        type_name=route.type_name,
        type_hash=route.type_hash,
        transport=route.transport.name,
        port=route.proposal.port or route.peer.shared_port(),
        stages=route.stages(),
        rate=route.meter.rate,
        expected_rate=_expected_rate(route),
        bytes_per_second=route.meter.bytes_per_second,
        bytes_total=route.meter.bytes,
        latency_uncertainty=route.peer.clock_uncertainty,
        age=None if route.meter.last is None else now - route.meter.last,
        history=tuple(route.meter.history),
        last_error=route.notices.last_error,
        cause=verdict.cause,
        from_peer=from_peer,
        since=route.context.wall() - (now - route.judged.since(verdict, now)),
        arming=route.arming.snapshot(now),
        allowed_rate=route.limit.allowed or None,
        pattern=route.pattern,
        messages_total=route.meter.count,
        max_age=route.age.max_age,
    )


def snapshot_of_topic(route: TopicRoute) -> RouteSnapshot:
    """A topic's route as it is now."""
    publisher_qos, subscriber_qos = route.end_qos()
    publishers, subscribers = route.end_nodes()
    return snapshot_of(route)(
        qos=route.qos,
        publisher_qos=publisher_qos,
        subscriber_qos=subscriber_qos,
        ledger=route.ledger(),
        latency_p50=route.latency.p50,
        latency_p99=route.latency.p99,
        jitter=route.latency.jitter,
        publishers=publishers,
        subscribers=subscribers,
    )


def _expected_rate(route: Route) -> float | None:
    rate, limit = route.spec.expected_rate or route.meter.usual_rate, route.limit.rate
    return min(rate, limit) if rate and limit else rate

"""The command ``info``: prints all details of one topic, service, action or node's parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.topic_keys import ADDED_KEYS, TOPIC_KEYS, value_of
from rsb_console.command.figures import measured
from rsb_console.command.formatting import clock, link_word, links_of, route_of, without_peer
from rsb_console.command.target import attached, chosen_route, done, other_side
from rsb_console.notation import formats
from rsb_console.notation.route_fact import facts_of

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot
    from rsb_console.command.figures import Figures

_MEASURED = 3.0
"""Seconds over which the delivered rate is measured; the other side reports its counts once a second."""


def print_info(arguments: Namespace) -> int:
    with attached(arguments, read_only=True) as engine:
        route = chosen_route(engine, arguments)
        now = engine.snapshot()
        if arguments.json:
            return done(arguments, **_values(route, now.time), link_status=links_of(now).get(route.link))
        link = next((each for each in now.links if each.name == route.link), None)
        # Where fewer messages arrive than are sent, the rate alone would mislead.
        loses = route.calls is None and route.outgoing and route.rate > 0 and route.ledger.dropped_total > 0
        figures = measured(engine, route, _MEASURED) if loses else None
        return done(arguments, *_lines(route, link, other_side(engine, route.link), figures, now.time))


def _values(route: RouteSnapshot, now: float) -> dict[str, object]:
    limits = None
    if route.limits is not None:
        limits = {"linear": route.limits.linear, "angular": route.limits.angular, "limited_by": route.limited_by}
    return route_of(route) | {
        "type": route.type_name,
        "type_hash": route.type_hash,
        "remote_topic": route.remote_topic,
        "direction": route.spec.direction,
        "transport": route.transport,
        "port": route.port,
        "priority": route.spec.priority,
        "max_age": route.max_age or None,
        "keep": None if route.spec.kept is None else msgspec.structs.asdict(route.spec.kept),
        "beat": route.spec.beat,
        "lazy": route.spec.lazy,
        "renew": route.spec.renew,
        "express": route.spec.express,
        "limits": limits,
        "features": route.spec.features,
        "qos": _qos_values(route.qos),
        "publisher_qos": _qos_values(route.publisher_qos),
        "subscriber_qos": _qos_values(route.subscriber_qos),
        "expected_rate": route.spec.expected_rate,
        "usual_rate": None if route.spec.expected_rate else route.expected_rate,
        "bytes_total": route.bytes_total,
        "messages_total": route.messages_total,
        "latency_uncertainty": route.latency_uncertainty,
        "jitter": route.jitter,
        "age": route.age(now),
        "last_error": route.last_error,
        "last_error_at": round(route.last_error_at, 3) if route.last_error else None,
        "stages": [{"name": stage.name, "done": stage.done, "detail": stage.detail} for stage in route.stages],
    }


def _qos_values(qos: Qos | None) -> object:
    return None if qos is None else msgspec.structs.asdict(qos)


def _lines(
    route: RouteSnapshot, link: LinkSnapshot | None, other: str, figures: Figures | None, now: float
) -> Iterator[str]:
    is_topic = route.calls is None
    yield f"{'Topic' if is_topic else route.spec.kind.capitalize()}: {route.topic}"
    unknown = "ROS's own for parameters" if route.spec.kind == "parameters" else "not known yet"
    yield f"Type: {formats.known_type(route) or unknown}"
    if route.type_hash:
        yield f"Type hash: {route.type_hash}"
    cause = f" ({route.cause})" if route.cause else ""
    yield f"State: {route.state.upper()}{cause} since {clock(route.since)}{f': {route.reason}' if route.reason else ''}"
    if route.arming is not None and route.arming.demanded_by:
        yield f"Requires arming: {', '.join(route.arming.demanded_by)}"
    if route.arming is not None and route.arming.armed:
        left = "" if route.arming.left is None else f", {route.arming.left:.0f} s left without a key"
        yield f"ARMED by: {route.arming.by}{left}"
    if route.limits is not None:
        yield f"By hand: at most {route.limits} ({', '.join(route.limited_by)})"
    towards = "sent to" if route.outgoing else "received from"
    if not is_topic:
        towards = "calls go to" if route.outgoing else "calls come from"
    yield f"Direction: {towards} {other}, where it is {route.remote_topic} ({route.spec.direction} for the client)"
    yield f"Carried by: {', '.join(_carriers(route))}"
    for label, text in facts_of(route):
        yield f"{label}: {text}"
    if link is not None:
        yield f"Link: {', '.join(_link_parts(link))}"
    yield from _ends(route)
    yield f"Rate: {_rate(route, figures, now)}"
    yield f"Bytes: {formats.byte_rate(route.bytes_per_second)}, {formats.byte_count(route.bytes_total)} in all"
    yield from _latency(route)
    yield from _ledger(route, now)
    if missing := [stage for stage in route.stages if not stage.done]:
        detail = f": {missing[0].detail}" if missing[0].detail else ""
        yield f"Waits for: {missing[0].name}{detail}"
    if route.last_error:
        yield f"Last error, at {formats.time_of_day(route.last_error_at)}: {route.last_error}"


def _carriers(route: RouteSnapshot) -> Iterator[str]:
    yield f"{route.transport} {'channel' if route.transport == 'bluetooth' else 'port'} {route.port}"
    if route.calls is None:
        yield f"{route.spec.priority} priority"
    if route.spec.compression not in (None, "none"):
        yield f"{route.spec.compression} compression"
    if route.max_rate is not None:
        yield TOPIC_KEYS["max_rate"].described(route.max_rate, route.spec.kind)
    if route.max_age:
        yield TOPIC_KEYS["max_age"].described(route.max_age, route.spec.kind)
    if route.spec.kept is not None:
        yield f"keeps {route.spec.kept} for the link"
    for name in ("beat", "lazy", "renew", "express", *ADDED_KEYS):
        if (value := value_of(route.spec, name)) is not None and value is not False:
            yield TOPIC_KEYS[name].described(value, route.spec.kind)
    if route.pattern:
        yield f"matches {route.pattern}"


def _link_parts(link: LinkSnapshot) -> Iterator[str]:
    yield f"{link.name} {link_word(link)}{f' {link.peer}' if link.peer else ''}"
    if way := formats.via(link):
        yield way
    if link.rtt is not None:
        yield f"rtt {formats.span(link.rtt)}"
    if loss := formats.loss([link]):
        yield f"loss {loss}"
    if fault := link.reason or link.warning:
        yield without_peer(fault, link)


def _ends(route: RouteSnapshot) -> Iterator[str]:
    here, there = "on this side", "on the other side"
    source, sink = (here, there) if route.outgoing else (there, here)
    if route.calls is not None:
        yield f"Callers {source}: {', '.join(route.publishers) or 'none known'}"
        yield f"Provider {sink} (the {route.spec.provider}'s): {', '.join(route.subscribers) or 'none known'}"
        return
    for name, nodes, verb, qos in (
        (f"Publishers {source}", route.publishers, "offer", route.publisher_qos),
        (f"Subscribers {sink}", route.subscribers, "ask for", route.subscriber_qos),
    ):
        yield f"{name}: {', '.join(nodes) or ('none known' if qos is None else 'nodes not known')}"
        if qos is not None:
            yield f"  {verb} together: {' '.join(formats.qos_parts(qos, depth_known=False))}"
    if route.drivers:
        yield f"Drivers: {', '.join(map(formats.driver, route.drivers))}"
    if route.qos is not None:
        yield f"QoS of the bridge: {' '.join(formats.qos_parts(route.qos))}"


def _rate(route: RouteSnapshot, figures: Figures | None, now: float) -> str:
    if route.calls is not None:
        return f"{formats.hertz(route.rate)} calls/s"
    where = "given to the link's queue" if route.outgoing else "published here"
    text = f"{formats.hertz(route.rate)} Hz {where}"
    if figures is not None and figures.crossing:
        text += f", {figures.crossing}"
    if named := formats.rate_by_name(route):
        text += f", {named}"
    return text if (age := route.age(now)) is None else f"{text}, the last message {formats.age(age)} ago"


def _latency(route: RouteSnapshot) -> Iterator[str]:
    if (calls := route.calls) is not None:
        if calls.way_p50 is not None and calls.node_p50 is not None:
            way, node = formats.span(calls.way_p50), formats.span(calls.node_p50)
            yield f"Latency: p50 {way} there and back, {node} in the node"
    elif route.latency_p50 is not None and route.latency_p99 is not None:
        p50, p99 = (formats.latency(each, route.latency_uncertainty) for each in (route.latency_p50, route.latency_p99))
        error = "" if route.latency_uncertainty is None else f" ± {formats.span(route.latency_uncertainty)}"
        yield f"Latency: p50 {p50}, p99 {p99}{error}, one way, from bridge to bridge"


def _ledger(route: RouteSnapshot, now: float) -> Iterator[str]:
    if (calls := route.calls) is not None:
        refused = sum(calls.refused.values())
        yield (
            f"Ledger: {calls.asked} asked = {calls.answered} answered + {calls.expired} expired + {refused} refused"
            f" + {calls.lost} lost + {calls.in_flight} under way"
        )
        if calls.waiting:
            yield f"  {calls.waiting} of those under way wait until the node has taken earlier ones"
        dropped = calls.refused
    else:
        ledger = route.ledger
        yield (
            f"Ledger: {ledger.offered} offered = {ledger.delivered} delivered + {ledger.throttled} throttled"
            f" + {ledger.dropped_total} dropped + {ledger.expired} expired + {ledger.unknown} unknown"
            f" + {ledger.waiting} waiting + {ledger.in_flight} in flight"
        )
        if ledger.waiting_since is not None:
            yield f"  {ledger.waiting} waiting, the oldest for {formats.age_since(ledger.waiting_since, now)}"
        if ledger.unknown:
            yield f"  {ledger.unknown} unknown: sent to a bridge that ended before it reported whether they arrived"
        if ledger.missed_while_down:
            yield f"  {ledger.missed_while_down} more were published while the topic was closed"
        if ledger.unsubscribed:
            yield f"  {ledger.unsubscribed} more came before the bridge subscribed, or while paused or disarmed"
        if ledger.lost_in_dds:
            yield f"  {ledger.lost_in_dds} more were lost in DDS before the bridge could take them"
        dropped = ledger.dropped
    for cause, count in dropped.items():
        if count:
            yield f"  {count} {cause}"

"""An engine's state and events as lines, for people and for programs."""

from __future__ import annotations

import json
import math
import time
from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeAlias

import msgspec

from rsb_bridge.model.figure_table import Of, Unit, figures
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import escape_json, join_first, plural
from rsb_bridge.model.verdict import LinkCause
from rsb_console.notation import formats

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.model.figure_table import Figure
    from rsb_bridge.model.session import Kind
    from rsb_bridge.model.snapshot import Event, LinkSnapshot, PatternSnapshot, RefusedClient, RouteSnapshot, Snapshot

_SHOWN_IN_STATUS = 8
"""Causes or names in a status line; the others are counted. A round figure."""
_REPEATED_AFTER = 60.0
"""s after which a status line repeats an unchanged cause. A round figure."""
_Subject: TypeAlias = tuple[str, ...]
_Item: TypeAlias = tuple[_Subject, str, str, str]
"""Subject, state and cause, text, and text without the cause (left out if empty)."""
_Printed: TypeAlias = dict[_Subject, tuple[str, float]]
"""States and causes as they were printed last, and when (s since the epoch), by subject."""
_COUNTED: dict[Kind, str] = {
    "topic": "{} topic",
    "service": "{} service",
    "action": "{} action",
    "parameters": "parameters of {} node",
}
_DIGITS = {Unit.HERTZ: 3, Unit.BYTES_PER_SECOND: None, Unit.MOMENT: 3}
"""Decimal places in JSON."""
_OF_LINK = figures(Of.LINK, "state", "cause", "reason", "since", "association_ends")
_MORE_OF_LINK = figures(Of.LINK, "peer", "rtt", "loss", "fingerprint", "next_fingerprint", "acknowledged")
_OF_ROUTE = figures(
    Of.ROUTE, "topic", "kind", "link", "pattern", "outgoing", "state", "cause", "reason", "from_peer", "since",
    "publishers", "drivers", "subscribers", "max_rate", "arming", "acknowledged", "missing", "rate", "bytes_per_second",
    "latency_p50", "latency_p99",
)  # fmt: skip
_OF_CALLS = figures(Of.ROUTE, "provider", "calls")


def clock(moment: float) -> str:
    """Local time to the second."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(moment))


def text_event(event: Event) -> str:
    link = f"{event.link}: " if event.link else ""
    return f"{clock(event.time)} {event.level:<7} {event.source:<8} {link}{event.text}"


class StatusLines:
    """Successive status lines for people: they give a cause when it begins or changes, and then once a minute."""

    def __init__(self) -> None:
        self._printed: _Printed = {}

    def text(self, snapshot: Snapshot) -> str:
        """Return the next line: linked peers, flowing topics, the traffic, and the first faults and topics."""
        received = sum(link.rx_bytes_per_second for link in snapshot.links) / 1000
        sent = sum(link.tx_bytes_per_second for link in snapshot.links) / 1000
        links = [
            (("link", link.name), f"{link.state} {link.cause}", f"{link.name} {link_fault(link)}",
             f"{link.name} {link_word(link)}")
            for link in snapshot.links if link.reason or link.warning
        ]  # fmt: skip
        refused = [
            (("refused", client.name, client.host), client.cause, refused_text(client), "")
            for client in snapshot.refused
        ]
        routes = [
            (("route", route.key), f"{route.state} {route.cause} {route.from_peer}", rate_text(route),
             rate_text(route, why=False))
            for route in faults_first(of_links_that_are_up(snapshot))
        ]  # fmt: skip
        # A cause that is gone is forgotten: when it comes back, it is new.
        before, self._printed = self._printed, {}
        parts = [*_counts(snapshot), f"RX {received:.1f} kB/s TX {sent:.1f} kB/s"]
        for group in (links, refused, routes):
            texts = self._new_texts(snapshot.time, before, group)
            more = len(texts) - _SHOWN_IN_STATUS
            parts += [*texts[:_SHOWN_IN_STATUS], f"and {more} more"] if more > 0 else texts
        return f"{clock(snapshot.time)} status  {' | '.join(parts)}"

    def _new_texts(self, now: float, printed: _Printed, group: Sequence[_Item]) -> list[str]:
        """Return the texts to print: with the cause where it is new or was printed a minute ago, else without."""
        texts = []
        for number, (key, how, text, brief) in enumerate(group):
            before, at = printed.get(key, ("", 0.0))
            # Below 0, the clock was set back: the cause is repeated, and not left out until the clock catches up.
            is_known = before == how and 0 <= now - at < _REPEATED_AFTER
            if number < _SHOWN_IN_STATUS or is_known:  # otherwise the line had no room for it
                self._printed[key] = (how, at if is_known else now)
            texts.append(brief if is_known else text)
        return [text for text in texts if text]


def link_word(link: LinkSnapshot) -> str:
    """Return a link's state in one word, which is not OK while the link has a warning."""
    if link.state is not State.OK or not link.warning:
        return link.state.upper()
    return "FULL" if link.cause == LinkCause.FULL else "WARN"


def link_fault(link: LinkSnapshot) -> str:
    """Return the faults of a link, which may be up."""
    return link.warning if link.state is State.OK else f"{link.state.upper()}: {why_down(link)}"


def why_down(link: LinkSnapshot) -> str:
    """Return the reason a link is down, and what waits for it or when its client tries again, or an empty string."""
    if link.association_ends is not None:
        return f"{link.reason}; topics and calls wait until {clock(link.association_ends)}"
    if link.cause == LinkCause.SHUT_DOWN and link.retry_in is not None:
        return f"{link.reason}; asks again in {math.ceil(link.retry_in)} s"
    return link.reason


def where_and_why(link: LinkSnapshot) -> str:
    """Format a link's peer and fault, each after its separator, with the peer's address only once."""
    fault = why_down(link) or link.warning
    if link.peer and fault.startswith(f"{link.peer} "):
        return f": {fault}"
    where = f" {link.peer}" if link.peer else ""
    if link.ways and (way := formats.via(link)):
        where += f" {way}"
    return f"{where}: {without_peer(fault, link)}" if fault else where


def without_peer(fault: str, link: LinkSnapshot) -> str:
    """Return a link's fault without the peer's address at its start, for lines that already show the address."""
    return fault.removeprefix(f"{link.peer}: ") if link.peer else fault


def of_links_that_are_up(snapshot: Snapshot) -> list[RouteSnapshot]:
    """Return the routes of links that are up: a link's fault is reported once, and not for each of its topics."""
    down = {link.name for link in snapshot.links if link.state is not State.OK}
    return [route for route in snapshot.routes if route.link not in down]


def topics_of_link_that_is_down(snapshot: Snapshot, link: LinkSnapshot) -> str:
    """Return the topics and services that their link leaves unconnected, or an empty string."""
    routes = [route for route in snapshot.routes if route.link == link.name]
    if link.state is State.OK or not routes:
        return ""
    waits = "waits" if len(routes) == 1 else "wait"
    return f"{_of_kinds(routes)} {waits} for it: {join_first([route.topic for route in routes], _SHOWN_IN_STATUS)}"


def summary(snapshot: Snapshot) -> str:
    return ", ".join(_counts(snapshot))


def _counts(snapshot: Snapshot) -> tuple[str, str]:
    linked = sum(link.state is State.OK for link in snapshot.links)
    states = [route.state for route in snapshot.routes]
    counts = ", ".join(f"{states.count(state)} {state}" for state in State if state in states)
    if armed := sum(route.arming is not None and route.arming.armed for route in snapshot.routes):
        counts += f", {armed} ARMED"
    return f"{linked}/{len(snapshot.links)} linked", _of_kinds(snapshot.routes) + (f": {counts}" if counts else "")


def _of_kinds(routes: Sequence[RouteSnapshot]) -> str:
    """Count the routes of each kind: ``3 topics, 1 action, parameters of 2 nodes``."""
    counts = Counter(route.spec.kind for route in routes)
    parts = (plural(counts[kind], text.format(counts[kind])) for kind, text in _COUNTED.items() if counts[kind])
    return ", ".join(parts) or "0 topics"


def faults_first(routes: Sequence[RouteSnapshot]) -> list[RouteSnapshot]:
    """Sort the faults that nobody has acknowledged first: a line has room for only some topics."""

    def rank(route: RouteSnapshot) -> tuple[bool, int]:
        return route.acknowledged is not None or route.state.severity == 0, route.state.rank

    return sorted(routes, key=rank)


def acknowledged_by(of: RouteSnapshot | LinkSnapshot | PatternSnapshot) -> str:
    """Return a note on the operator who has acknowledged a fault, or an empty string."""
    return "" if of.acknowledged is None else f" [acknowledged by {of.acknowledged.by}, {clock(of.acknowledged.at)}]"


def rate_text(route: RouteSnapshot, *, why: bool = True) -> str:
    """Format a topic's rate or a service's calls, or its state with or without the reason."""
    arrow = "→" if route.outgoing else "←"
    armed = f" ARMED ({route.arming.by}):" if route.arming is not None and route.arming.armed else ""
    counts = {"dropped": route.ledger.dropped_total, "unknown": route.ledger.unknown}
    if (calls := route.calls) is not None:
        counts = {"expired": calls.expired, "refused": sum(calls.refused.values()), "lost": calls.lost}
    failed = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    kind = "" if route.spec.kind == "topic" else f"{route.spec.kind} "
    lines = () if route.arming is None or not why else route.arming.demanded_by
    demanded = f" [has to be armed: {', '.join(lines)}]" if lines else ""
    return f"{arrow} {kind}{route.topic}{armed} {_how(route, why=why)}{failed and f' ({failed})'}{demanded}"


def _how(route: RouteSnapshot, *, why: bool) -> str:
    """Return the rate and what is wrong all the same, or the reason why there is no rate."""
    rate = f"{route.rate:.1f} Hz"
    if route.calls is not None:
        under_way = f", {route.calls.in_flight} under way" if route.calls.in_flight else ""
        waiting = f", {route.calls.waiting} of them wait for the node" if route.calls.waiting else ""
        rate = f"{route.rate:.1f} calls/s{under_way}{waiting}"
    how = rate if route.state is State.OK else route.state.upper()
    if route.state is not State.OK and route.state.flows:
        how += f" {rate}"
    return how + (f": {route.reason}" if why and route.reason else "")


def json_line(content: dict[str, object]) -> str:
    return escape_json(json.dumps(content, ensure_ascii=False))


def json_value(value: Any) -> Any:
    """Return plain data for JSON, where NaN, Infinity and -Infinity are strings."""
    if isinstance(value, dict):
        return {name: json_value(each) for name, each in value.items()}
    if isinstance(value, list):
        return [json_value(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def json_event(event: Event) -> str:
    since = None if event.since is None else round(event.since, 3)
    content = asdict(event) | {"source": event.source, "since": since}
    del content["number"]  # counts the events that are not printed, too
    return json_line(content)


def json_status(snapshot: Snapshot) -> str:
    """Format the status as one JSON object, with all topics."""
    return json_line({"time": snapshot.time, "status": status_of(snapshot)})


def status_of(snapshot: Snapshot) -> dict[str, object]:
    """Return the figures for a monitor, without what only the console draws (histories, the details of stages)."""
    return {
        "unsaved": snapshot.unsaved,
        "links": links_of(snapshot),
        "refused": [asdict(client) | {"since": round(client.since, 3)} for client in snapshot.refused],
        "routes": [route_of(route) for route in snapshot.routes],
    }


def refused_text(client: RefusedClient) -> str:
    """Format a refused client, with the remedy."""
    return f"refused {client.name or 'a client'} at {client.host} since {clock(client.since)}: {client.reason}"


def links_of(snapshot: Snapshot) -> dict[str, object]:
    """Return the links as plain data, by name."""
    return {
        link.name: {
            **_values(_OF_LINK, link),
            "full": {
                way: {"carried": round(full.carried), "asked": round(full.asked), "topics": full.topics}
                for way, full in (("out", link.full_out), ("in", link.full_in))
                if full is not None
            },
            **_values(_MORE_OF_LINK, link),
            "via": link.via,
            "ways": [
                {"host": way.host, "device": way.device, "used": way.is_used, "ready": way.is_ready}
                for way in link.ways
            ],
            "unsaved_there": link.unsaved_there,
            "patterns": [pattern_of(pattern) for pattern in link.patterns],
            **msgspec.to_builtins(link.features),
        }
        for link in snapshot.links
    }


def _values(chosen: tuple[Figure, ...], subject: LinkSnapshot | RouteSnapshot) -> dict[str, object]:
    """Return figures as plain data, with the digits that their units have in JSON."""
    found: dict[str, object] = {}
    for each in chosen:
        value = each.read(subject)
        if each.unit in _DIGITS and value is not None:
            value = round(value, _DIGITS[each.unit])
        elif hasattr(value, "__dataclass_fields__"):
            value = asdict(value)
        found[each.name] = value
    return found


def pattern_of(pattern: PatternSnapshot) -> dict[str, object]:
    return {
        "pattern": pattern.spec.topic,
        "kind": pattern.spec.kind,
        "direction": pattern.spec.direction,
        "except": pattern.spec.excepts,
        "state": pattern.state,
        "reason": pattern.reason,
        "routes": pattern.routes,
        "gone": pattern.gone,
        "beyond": pattern.beyond,
        "acknowledged": None if pattern.acknowledged is None else asdict(pattern.acknowledged),
    }


def pattern_text(pattern: PatternSnapshot) -> str:
    """Return a pattern in a few words: what it bridges, and what not."""
    spec = pattern.spec
    what = f"pattern {spec.topic}" if spec.kind == "topic" else f"pattern of {spec.kind} names {spec.topic}"
    return f"{what} ({spec.direction}) {pattern.state.upper()}: {pattern.reason}"


def made_by(route: RouteSnapshot) -> str:
    """Return the pattern that has made a route, or an empty string."""
    return f" [{route.pattern}]" if route.pattern else ""


def patterns_of(snapshot: Snapshot) -> list[PatternSnapshot]:
    """Return all patterns, those with faults first."""
    found = [pattern for link in snapshot.links for pattern in link.patterns]
    return sorted(found, key=lambda pattern: pattern.state.rank)


def route_of(route: RouteSnapshot) -> dict[str, object]:
    if route.calls is None:
        figures = asdict(route.ledger)
    else:
        figures = _values(_OF_CALLS, route) | {"goals": [asdict(goal) for goal in route.goals]}
    return {**_values(_OF_ROUTE, route), **figures, **msgspec.to_builtins(route.features)}

"""An engine's state and events as lines, for people and for programs."""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import plural

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.model.snapshot import Event, LinkSnapshot, RouteSnapshot, Snapshot

_SHOWN_IN_STATUS = 8


def clock(moment: float) -> str:
    """Local time to the second."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(moment))


def text_event(event: Event) -> str:
    """An event as one line."""
    link = f"{event.link}: " if event.link else ""
    return f"{clock(event.time)} {event.level:<7} {event.source:<8} {link}{event.text}"


def text_status(snapshot: Snapshot) -> str:
    """One line: how many peers are linked, how many topics flow, the traffic, and the first faults and topics."""
    received = sum(link.rx_bytes_per_second for link in snapshot.links) / 1000
    sent = sum(link.tx_bytes_per_second for link in snapshot.links) / 1000
    parts = [
        *_counts(snapshot),
        f"RX {received:.1f} kB/s TX {sent:.1f} kB/s",
        *_some([f"{link.name} {_link_fault(link)}" for link in snapshot.links if link.reason or link.warning]),
        *_some([rate_text(route) for route in faults_first(_of_links_that_are_up(snapshot))]),
    ]
    return f"{clock(snapshot.time)} status  {' | '.join(parts)}"


def _some(parts: list[str]) -> list[str]:
    """As many as there is room for in a line."""
    more = len(parts) - _SHOWN_IN_STATUS
    return [*parts[:_SHOWN_IN_STATUS], f"and {more} more"] if more > 0 else parts


def _link_fault(link: LinkSnapshot) -> str:
    return link.warning if link.state is State.OK else f"{link.state.upper()}: {link.reason}"


def _of_links_that_are_up(snapshot: Snapshot) -> list[RouteSnapshot]:
    """What is wrong with a link is said once, and not of each of its topics."""
    down = {link.name for link in snapshot.links if link.state is not State.OK}
    return [route for route in snapshot.routes if route.link not in down]


def summary(snapshot: Snapshot) -> str:
    """How many peers are linked, and how many topics flow."""
    return ", ".join(_counts(snapshot))


def _counts(snapshot: Snapshot) -> tuple[str, str]:
    linked = sum(link.state is State.OK for link in snapshot.links)
    states = [route.state for route in snapshot.routes]
    counts = ", ".join(f"{states.count(state)} {state}" for state in State if state in states)
    topics = f"{len(states)} {plural(len(states), 'topic')}"
    return f"{linked}/{len(snapshot.links)} linked", topics + (f": {counts}" if counts else "")


def faults_first(routes: Sequence[RouteSnapshot]) -> list[RouteSnapshot]:
    """The line has room for some topics only, and faults must be among them."""
    return sorted(routes, key=lambda route: route.state.rank)


def rate_text(route: RouteSnapshot) -> str:
    """A topic in a few words: its rate, or why it has none."""
    arrow = "→" if route.outgoing else "←"
    dropped = route.ledger.dropped_total
    return f"{arrow} {route.topic} {_how(route)}" + (f" ({dropped} dropped)" if dropped else "")


def _how(route: RouteSnapshot) -> str:
    """The rate and what is wrong all the same, or the reason why there is no rate; a pause needs no reason."""
    rate = f"{route.rate:.1f} Hz"
    how = rate if route.state is State.OK else route.state.upper()
    if route.state is not State.OK and route.state.flows:
        how += f" {rate}"
    reason = "" if route.state is State.PAUSED else route.reason
    return how + (f": {reason}" if reason else "")


def json_line(content: dict[str, object]) -> str:
    """An object of one line."""
    return json.dumps(content, ensure_ascii=False)


def json_event(event: Event) -> str:
    """An event as one JSON object."""
    content = asdict(event) | {"source": event.source}
    del content["number"]  # counts the events that are not printed, too
    return json_line(content)


def json_status(snapshot: Snapshot) -> str:
    """As `text_status`, with all topics, as one JSON object."""
    return json_line({"time": snapshot.time, "status": status_of(snapshot)})


def status_of(snapshot: Snapshot) -> dict[str, object]:
    """The figures for a monitor, without what only the console draws (histories, the details of stages)."""
    links = {
        link.name: {
            "state": link.state,
            "cause": link.cause,
            "reason": link.reason or link.warning,
            "since": link.since,
            "peer": link.peer,
            "rtt": link.rtt,
        }
        for link in snapshot.links
    }
    return {"links": links, "routes": [route_of(route) for route in snapshot.routes]}


def route_of(route: RouteSnapshot) -> dict[str, object]:
    """Those of one route."""
    return {
        "topic": route.topic,
        "link": route.link,
        "outgoing": route.outgoing,
        "state": route.state,
        "cause": route.cause,
        "reason": route.reason,
        "from_peer": route.from_peer,
        "publishers": route.publishers,
        "subscribers": route.subscribers,
        "max_rate": route.spec.max_rate,
        "missing": [stage.name for stage in route.stages if not stage.done],
        "rate": round(route.rate, 3),
        "bytes_per_second": round(route.bytes_per_second),
        "latency_p50": route.latency_p50,
        "latency_p99": route.latency_p99,
        **asdict(route.ledger),
    }

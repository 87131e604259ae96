"""A snapshot as ``diagnostic_msgs/DiagnosticArray``: a status a link and a route (REP 107)."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from rsb_bridge.model.calls import Fields
    from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot, Snapshot

_LEVELS = ("0", "1", "2")
"""OK, WARN and ERROR of ``diagnostic_msgs/DiagnosticStatus``, by severity."""


def diagnostics(snapshot: Snapshot) -> Fields:
    """The fields of the message, as `rsb_bridge.ros.ros_interface.RosInterface.serialize` takes them.

    A status is named by the session, and by the link or by the topic and its direction, none of which changes when the
    bridge is started again. What is paused, disarmed or waits for a first message is OK: nothing is wrong.
    """
    links = [_link(snapshot.name, link) for link in snapshot.links]
    return {"header": "auto", "status": links + [_route(snapshot.name, route) for route in snapshot.routes]}


def _link(session: str, link: LinkSnapshot) -> Fields:
    severity = max(link.state.severity, int(bool(link.warning) or not link.encrypted))
    message = link.reason or link.warning or ("linked" if link.encrypted else "linked, not encrypted")
    return _status(f"rsb {session}: link {link.name}", session, severity, message, dict(_of_link(link)))


def _of_link(link: LinkSnapshot) -> Iterator[tuple[str, object]]:
    yield "state", link.state
    yield "cause", link.cause
    yield "peer", link.peer
    yield "peer version", link.peer_version
    yield "cipher", link.cipher if link.encrypted else "none"
    yield "round trip (ms)", _milliseconds(link.rtt)
    yield "clock offset (ms)", _milliseconds(link.clock_offset)
    yield "received (B/s)", f"{link.rx_bytes_per_second:.0f}"
    yield "sent (B/s)", f"{link.tx_bytes_per_second:.0f}"
    yield "failed attempts", link.attempts


def _route(session: str, route: RouteSnapshot) -> Fields:
    name = f"rsb {session}: {route.topic} {'to' if route.outgoing else 'from'} {route.link}"
    message = route.reason or (f"{route.rate:.1f} Hz" if route.state.flows else route.state.value)
    return _status(name, session, route.state.severity, message, dict(_of_route(route)))


def _of_route(route: RouteSnapshot) -> Iterator[tuple[str, object]]:
    yield "state", route.state
    yield "cause", route.cause
    yield "type", route.type_name
    yield "rate (Hz)", f"{route.rate:.1f}"
    yield "expected rate (Hz)", "" if route.expected_rate is None else f"{route.expected_rate:.1f}"
    yield "payload (B/s)", f"{route.bytes_per_second:.0f}"
    yield "latency p50 (ms)", _milliseconds(route.latency_p50)
    yield "latency p99 (ms)", _milliseconds(route.latency_p99)
    if route.calls is None:
        yield "offered", route.ledger.offered
        yield "delivered", route.ledger.delivered
        yield "throttled", route.ledger.throttled
        yield "expired", route.ledger.expired
        for why, count in route.ledger.dropped.items():
            yield f"dropped: {why}", count
        yield "unknown", route.ledger.unknown
        yield "missed while down (estimate)", route.ledger.missed_while_down
    else:
        yield "asked", route.calls.asked
        yield "answered", route.calls.answered
        yield "expired", route.calls.expired
        yield "lost", route.calls.lost
        for why, count in route.calls.refused.items():
            yield f"refused: {why}", count


def _status(name: str, session: str, severity: int, message: str, values: Mapping[str, object]) -> Fields:
    known: list[Fields] = [{"key": key, "value": str(value)} for key, value in values.items() if value != ""]
    return {"level": _LEVELS[severity], "name": name, "message": message, "hardware_id": session, "values": known}


def _milliseconds(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds * 1e3:.1f}"

"""A snapshot as Prometheus metrics, and the HTTP server that makes them when somebody asks.

Nothing is counted here for a message.

A counter may only grow while its route lives, or a rate that Prometheus makes of it jumps. A ledger's figures do not
always: a message that was taken for lost may come after all. So the highest value counts, until the route's first
figure, of what was offered or asked, says that it counts anew.
"""

from __future__ import annotations

import contextlib
import io
import socket
import threading
from collections import Counter
from dataclasses import dataclass
from importlib.metadata import version
from socketserver import TCPServer, ThreadingMixIn
from typing import TYPE_CHECKING, Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from prometheus_client import CollectorRegistry, ProcessCollector, make_wsgi_app
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from wsgiref.types import StartResponse, WSGIApplication, WSGIEnvironment

    from rsb_bridge.model.calls import CallsSnapshot
    from rsb_bridge.model.snapshot import Ledger, LinkSnapshot, RouteSnapshot, Snapshot
    from rsb_bridge.telemetry.event_log import EventLog

OTHER = "other"
"""The label of a cause that is not listed below: a peer may make up any."""
DROPPED = frozenset(
    {
        "already published", "disarmed", "expands too much", "incomplete", "latched full", "link lost",
        "lost on the way", "malformed", "paused", "publish failed", "queue full", "slow subscriber", "thinned",
        "too complex", "too large", "unknown source", "would loop",
    }
)  # fmt: skip
REFUSED = frozenset(
    {
        "bytes under way", "calls a second", "calls under way", "disarmed", "link silent", "malformed", "not arrived",
        "not sent", "paused", "provider gone", "too complex", "too large", "too old",
    }
)  # fmt: skip
_LINK = ("link",)
_TOPIC = (*_LINK, "topic", "direction")
_ROUTE = (*_TOPIC, "kind")
_CONNECTIONS = 8
"""At once; more are closed without an answer."""
_ANSWERED_WITHIN = 10.0
"""s that a connection may last."""
_LOOKS_EVERY = 1.0
_BACKLOG = 16


@dataclass(frozen=True, slots=True)
class Family:
    """Metrics of one name.

    Attributes:
        name: a counter's ends in ``_total``.
        labels: of each.
        text: what it is.
    """

    name: str
    labels: tuple[str, ...]
    text: str

    def empty(self) -> CounterMetricFamily | GaugeMetricFamily:
        """Without any sample."""
        kind = CounterMetricFamily if self.name.endswith("_total") else GaugeMetricFamily
        return kind(self.name, self.text, labels=self.labels)


FAMILIES = tuple(
    Family(f"rsb_{name}", labels, text)
    for labels, families in {
        ("version",): {"build_info": "Always 1; the version of rsb-console."},
        ("session", "role", "domain"): {"session_info": "Always 1; the name, role and ROS domain of the session."},
        (): {
            "running": "1 while the engine runs.",
            "snapshot_timestamp_seconds": "When these figures were taken; the engine takes them once a second.",
        },
        ("level",): {"events_total": "Events that the bridge has reported, by severity."},
        _LINK: {
            "link_up": "1 while the link is up.",
            "link_since_timestamp_seconds": "When it came up or went down.",
            "link_encrypted": "1 if the link is encrypted.",
            "link_warning": "1 if something is wrong though the link is up.",
            "link_failed_attempts": "Attempts to connect that failed since it was last up.",
            "link_round_trip_seconds": "Of the last ping.",
            "link_clock_offset_seconds": "The other side's clock minus this one's.",
            "link_clock_uncertainty_seconds": "Of the offset, and so of every latency.",
            "link_receive_bytes_total": "Wire bytes received, over all connections of the link.",
            "link_transmit_bytes_total": "Wire bytes sent, over all connections of the link.",
        },
        (*_LINK, "direction"): {
            "link_full": "1 while the link carries less than is asked of it, out or in.",
        },
        (*_LINK, "state"): {"link_state": "Always 1; the state of the link."},
        (*_ROUTE, "state"): {"route_state": "Always 1; the state of the route."},
        _ROUTE: {
            "route_level": "How bad its state is: 0 nothing is wrong, 1 a warning, 2 an error.",
            "route_since_timestamp_seconds": "When its state began.",
            "route_rate_hertz": "Messages or calls a second, over the last seconds.",
            "route_expected_rate_hertz": "As the session says, or learned.",
            "route_last_message_timestamp_seconds": "When the last message or call came.",
            "route_payload_bytes_total": "Payload that crossed this side.",
            "calls_asked_total": "Calls taken from callers, or that came over the link.",
            "calls_answered_total": "Calls whose answer went back.",
            "calls_expired_total": "Calls given up after their timeout.",
            "calls_lost_total": "Calls under way when the link or the provider went.",
            "calls_late_total": "Answers to calls that had been given up.",
            "calls_in_flight": "Calls under way.",
        },
        _TOPIC: {
            "messages_offered_total": "Messages taken from ROS on the sending side.",
            "messages_delivered_total": "Messages published on the receiving side.",
            "messages_throttled_total": "Messages left out because an operator allows no more.",
            "messages_expired_total": "Messages dropped because they were too old.",
            "messages_unknown_total": "Messages sent to a process that ended before it reported whether they arrived.",
            "messages_lost_in_dds_total": "Messages lost before the bridge could take them.",
            "messages_missed_while_down_total": "Messages published while the route was down, estimated.",
            "messages_jitter_seconds": "Variation of the latency (RFC 3550).",
            "messages_in_flight": "Messages whose end is not known yet.",
        },
        (*_TOPIC, "percentile"): {
            "messages_latency_seconds": "One way, of the last messages; its error is the clock's uncertainty.",
        },
        (*_ROUTE, "percentile"): {
            "calls_node_seconds": "What the providing node took, of the last calls.",
            "calls_way_seconds": "What the way there and back took, of the last calls.",
        },
        (*_TOPIC, "cause"): {"messages_dropped_total": "Messages dropped, by cause."},
        (*_ROUTE, "cause"): {"calls_refused_total": "Calls refused, by cause."},
    }.items()
    for name, text in families.items()
)


def application(look: Callable[[], Snapshot], events: EventLog) -> WSGIApplication:
    """What serves the metrics of one engine, and of its process, in the formats that Prometheus asks for.

    Args:
        look: gives the newest snapshot.
        events: of the engine.
    """
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(look, events))
    ProcessCollector(registry=registry)
    app: WSGIApplication = make_wsgi_app(registry)
    return app


class SnapshotCollector(Collector):
    """Makes metrics of the newest snapshot; scrapes may come on any thread.

    Args:
        look: gives the newest snapshot.
        events: of the engine.
    """

    def __init__(self, look: Callable[[], Snapshot], events: EventLog) -> None:
        self._look = look
        self._events = events
        self._version = version("rsb-console")
        self._one_at_a_time = threading.Lock()
        self._lives: dict[str, _Life] = {}
        """Of the routes that there are, by key."""

    def collect(self) -> Iterator[CounterMetricFamily | GaugeMetricFamily]:
        with self._one_at_a_time:
            families = _Families()
            snapshot = self._look()
            self._of_session(snapshot, families)
            for link in snapshot.links:
                _of_link((link.name,), link, families)
            self._lives = {route.key: self._lives.get(route.key) or _Life() for route in snapshot.routes}
            for route, labels in zip(snapshot.routes, _labels_of(snapshot.routes), strict=True):
                _of_route((*labels, route.spec.kind), route, snapshot.time, families)
                if route.calls is None:
                    self._of_messages(labels, route, families)
                else:
                    self._of_calls((*labels, route.spec.kind), route.key, route.calls, families)
        yield from families.made.values()

    def _of_session(self, snapshot: Snapshot, families: _Families) -> None:
        families.add("build_info", (self._version,), 1)
        families.add("session_info", (snapshot.name, snapshot.role, str(snapshot.domain_id)), 1)
        families.add("running", (), snapshot.running)
        families.add("snapshot_timestamp_seconds", (), snapshot.time)
        for level, count in self._events.counts.items():
            families.add("events_total", (level.value,), count)

    def _of_messages(self, labels: tuple[str, ...], route: RouteSnapshot, families: _Families) -> None:
        ledger, life = route.ledger, self._lives[route.key]
        life.take(ledger.offered, _counts_of(ledger), _known(ledger.dropped, DROPPED))
        life.show(labels, "messages_dropped_total", families)
        families.add("messages_in_flight", labels, ledger.in_flight)
        families.add("messages_jitter_seconds", labels, route.jitter)
        _percentiles("messages_latency_seconds", labels, route.latency_p50, route.latency_p99, families)

    def _of_calls(self, labels: tuple[str, ...], key: str, calls: CallsSnapshot, families: _Families) -> None:
        life = self._lives[key]
        life.take(calls.asked, _counts_of_calls(calls), _known(calls.refused, REFUSED))
        life.show(labels, "calls_refused_total", families)
        families.add("calls_in_flight", labels, calls.in_flight)
        _percentiles("calls_node_seconds", labels, calls.node_p50, calls.node_p99, families)
        _percentiles("calls_way_seconds", labels, calls.way_p50, calls.way_p99, families)


class _Families:
    """The families of one scrape."""

    def __init__(self) -> None:
        self.made = {family.name.removeprefix("rsb_"): family.empty() for family in FAMILIES}

    def add(self, name: str, labels: Sequence[str], value: float | None) -> None:
        """Add a sample; None: there is no figure, and so no sample."""
        if value is not None:
            self.made[name].add_metric(labels, value)


class _Life:
    """The counts of a route: what a sender's restart begins anew, and nothing else makes smaller."""

    def __init__(self) -> None:
        self._first = 0
        self._counts: dict[str, int] = {}
        self._causes: dict[str, int] = {}

    def take(self, first: int, counts: Mapping[str, int], causes: Mapping[str, int]) -> None:
        """Take the figures as they are now; `first` is the one that no correction makes smaller."""
        if first < self._first:
            self._counts, self._causes = {}, {}
        self._first = first
        self._counts = _highest(self._counts, counts)
        self._causes = _highest(self._causes, causes)

    def show(self, labels: tuple[str, ...], by_cause: str, families: _Families) -> None:
        """Add all counts; those by cause under that name."""
        for name, count in self._counts.items():
            families.add(name, labels, count)
        for cause, count in self._causes.items():
            families.add(by_cause, (*labels, cause), count)


def _highest(before: dict[str, int], now: Mapping[str, int]) -> dict[str, int]:
    return {name: max(before.get(name, 0), now.get(name, 0)) for name in {**before, **now}}


def _known(counts: Mapping[str, int], causes: frozenset[str]) -> Counter[str]:
    """The counts of known causes, and of all others together."""
    known: Counter[str] = Counter()
    for cause, count in counts.items():
        known[cause if cause in causes else OTHER] += count
    return known


def _counts_of(ledger: Ledger) -> dict[str, int]:
    return {
        "messages_offered_total": ledger.offered,
        "messages_delivered_total": ledger.delivered,
        "messages_throttled_total": ledger.throttled,
        "messages_expired_total": ledger.expired,
        "messages_unknown_total": ledger.unknown,
        "messages_lost_in_dds_total": ledger.lost_in_dds,
        "messages_missed_while_down_total": ledger.missed_while_down,
    }


def _counts_of_calls(calls: CallsSnapshot) -> dict[str, int]:
    return {
        "calls_asked_total": calls.asked,
        "calls_answered_total": calls.answered,
        "calls_expired_total": calls.expired,
        "calls_lost_total": calls.lost,
        "calls_late_total": calls.late,
    }


def _of_link(labels: tuple[str, ...], link: LinkSnapshot, families: _Families) -> None:
    families.add("link_state", (*labels, link.state.value), 1)
    families.add("link_up", labels, link.state is State.OK)
    families.add("link_since_timestamp_seconds", labels, link.since)
    families.add("link_encrypted", labels, link.encrypted)
    families.add("link_warning", labels, bool(link.warning))
    for direction, full in (("out", link.full_out), ("in", link.full_in)):
        families.add("link_full", (*labels, direction), full is not None)
    families.add("link_failed_attempts", labels, link.attempts)
    families.add("link_round_trip_seconds", labels, link.rtt)
    families.add("link_clock_offset_seconds", labels, link.clock_offset)
    families.add("link_clock_uncertainty_seconds", labels, link.clock_uncertainty)
    families.add("link_receive_bytes_total", labels, link.rx_bytes_total)
    families.add("link_transmit_bytes_total", labels, link.tx_bytes_total)


def _of_route(labels: tuple[str, ...], route: RouteSnapshot, now: float, families: _Families) -> None:
    families.add("route_state", (*labels, route.state.value), 1)
    families.add("route_level", labels, route.state.severity)
    families.add("route_since_timestamp_seconds", labels, route.since)
    families.add("route_rate_hertz", labels, route.rate)
    families.add("route_expected_rate_hertz", labels, route.expected_rate)
    families.add("route_last_message_timestamp_seconds", labels, None if route.age is None else now - route.age)
    families.add("route_payload_bytes_total", labels, route.bytes_total)


def _percentiles(name: str, labels: tuple[str, ...], p50: float | None, p99: float | None, families: _Families) -> None:
    families.add(name, (*labels, "50"), p50)
    families.add(name, (*labels, "99"), p99)


def _labels_of(routes: Sequence[RouteSnapshot]) -> Iterator[tuple[str, str, str]]:
    """Link, topic and direction of each. Topics that become one on this side are told apart by both their names."""
    named = [(route.link, route.topic, "out" if route.outgoing else "in", route.spec.kind) for route in routes]
    times = Counter(named)
    for each, route in zip(named, routes, strict=True):
        link, topic, direction, _ = each
        yield link, topic if times[each] == 1 else f"{topic} ({route.remote_topic})", direction


class MetricsServer(ThreadingMixIn, WSGIServer):
    """Serves a WSGI application: a thread for each connection, while somebody calls `turn`.

    It is for a few readers, each of which gets little time: it may be open to a whole network.

    Args:
        host: an address or a name.
        port: a TCP port.
        app: what is served.
        steady: the time (s) on a clock that nobody sets.
        failed: is told what the application raises.

    Raises:
        OSError: the address cannot be bound.
    """

    daemon_threads = False  # so that closing waits for them
    request_queue_size = _BACKLOG
    timeout = _LOOKS_EVERY

    def __init__(
        self,
        host: str,
        port: int,
        app: WSGIApplication,
        steady: Callable[[], float],
        failed: Callable[[Exception], None],
    ) -> None:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        self.address_family, _, _, _, address = found[0]
        self._steady = steady
        self._failed = failed
        self._open: dict[socket.socket, float] = {}
        super().__init__(address, _Handler)  # type: ignore[arg-type]  # an IPv6 address has four parts
        self._app = app
        self.set_app(self._answer)

    def _answer(self, environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
        try:
            return self._app(environ, start_response)
        except Exception as error:  # noqa: BLE001 (the last resort: the server goes on, and an operator is told)
            self._failed(error)
            start_response("500 Internal Server Error", [("Content-Type", "text/plain")])
            return [b"internal error: see the bridge's log\n"]

    def server_bind(self) -> None:
        """Without the look-up of the host's name, which may take its time."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])
        self.setup_environ()

    def turn(self) -> None:
        """Take a connection; returns after a second without one, or after `wake`."""
        self.handle_request()
        now = self._steady()
        for request, began in list(self._open.items()):
            if now - began >= _ANSWERED_WITHIN:
                _shut(request)

    def wake(self) -> None:
        """Have `turn` return at once, and take no connection any more; called on any thread."""
        _shut(self.socket)

    def server_close(self) -> None:
        """Close everything; returns once all threads have ended."""
        for request in list(self._open):
            _shut(request)
        super().server_close()

    def verify_request(self, request: Any, client_address: Any) -> bool:
        return len(self._open) < _CONNECTIONS

    def process_request(self, request: Any, client_address: Any) -> None:
        self._open[request] = self._steady()
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A reader that goes, or is too slow, is no error of ours."""


class _Handler(WSGIRequestHandler):
    """One request on a connection. Nothing is printed: standard error may be the terminal of a console."""

    timeout = _ANSWERED_WITHIN

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 (so it is called there)
        """Log nothing."""

    def get_stderr(self) -> io.StringIO:
        return io.StringIO()


def _shut(sock: socket.socket) -> None:
    """Have whoever waits for a socket wait no longer."""
    with contextlib.suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)

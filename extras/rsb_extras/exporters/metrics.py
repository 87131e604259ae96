"""A snapshot as Prometheus metrics, and the HTTP server that makes them when somebody asks.

A counter must not fall while its route exists, or a rate that Prometheus computes from it jumps. A ledger's figures may
fall: a message counted as lost may arrive later. So a counter shows its highest value, until the route's first figure
(messages offered, or calls asked) falls: then the route's counts have started from 0.
"""

from __future__ import annotations

import contextlib
import io
import socket
import threading
from collections import Counter
from importlib.metadata import version
from ipaddress import ip_address
from socketserver import TCPServer, ThreadingMixIn
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias
from urllib.parse import urlsplit
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from prometheus_client import CollectorRegistry, ProcessCollector, make_wsgi_app
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.figure_table import FIGURES, Of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from wsgiref.types import StartResponse, WSGIApplication, WSGIEnvironment

    from rsb_bridge.feature_api import EventLog, LinkSnapshot, RouteSnapshot, Snapshot

OTHER = "other"
"""The label of a cause that is not listed below: a peer may make up any."""
DROPPED = frozenset(
    {
        "already published", "disarmed", "expands too much", "incomplete", "keep full", "latched full", "link lost",
        "lost on the way", "malformed", "outage", "paused", "publish failed", "queue full", "replaced",
        "slow subscriber", "too complex", "too large", "unknown source", "would loop",
    }
)  # fmt: skip
REFUSED = frozenset(Refused) - {Refused.LOST, Refused.OTHER}
_CONNECTIONS = 8  # at once; more are closed without an answer
_ANSWERED_WITHIN = 10.0  # s that a connection may last: as long as Prometheus waits by default
_LOOKS_EVERY = 1.0  # s between looks for overdue connections, if none comes

_TOPIC = ("link", "topic", "direction")
_LABELS = {Of.LINK: ("link",), Of.ROUTE: (*_TOPIC, "kind"), Of.MESSAGES: _TOPIC, Of.CALLS: (*_TOPIC, "kind")}
_CAUSES = {Of.MESSAGES: DROPPED, Of.CALLS: REFUSED}
_Samples: TypeAlias = dict[tuple[str, ...], float]
"""Values by the name of the family and the labels that not all metrics of a link or a route have."""


class Family(NamedTuple):
    """Metrics of one name; a counter's ends in ``_total``."""

    name: str
    labels: tuple[str, ...]
    text: str


_METRICS = {of: [(f"rsb_{of}_{each.metric}", each) for each in FIGURES if each.metric and each.of is of] for of in Of}
FAMILIES = (
    Family("rsb_build_info", ("version",), "Always 1; the version of rsb-console."),
    Family("rsb_session_info", ("session", "role", "domain"), "Always 1; the session's name, role and ROS domain."),
    Family("rsb_running", (), "1 while the engine runs."),
    Family("rsb_snapshot_timestamp_seconds", (), "When these figures were taken; the engine takes them once a second."),
    Family("rsb_events_total", ("level",), "Events that the bridge has reported, by severity."),
    *(
        Family(name, (*_LABELS[of], *([each.by] if each.by else [])), each.help)
        for of, metrics in _METRICS.items()
        for name, each in metrics
        if each.help
    ),
)


def application(look: Callable[[], Snapshot], events: EventLog) -> WSGIApplication:
    """Make the WSGI application that serves the metrics of one engine and its process in Prometheus' formats."""
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(look, events))
    ProcessCollector(registry=registry)
    app: WSGIApplication = make_wsgi_app(registry)
    return app


class SnapshotCollector(Collector):
    """Makes metrics of the newest snapshot; scrapes may come on any thread."""

    def __init__(self, look: Callable[[], Snapshot], events: EventLog) -> None:
        self._look = look
        self._events = events
        self._version = version("rsb-console")  # of what runs, not of what is installed later
        self._one_at_a_time = threading.Lock()
        self._highest: dict[str, _Samples] = {}  # the counters so far, by the route's key

    def collect(self) -> Iterator[CounterMetricFamily | GaugeMetricFamily]:
        made = {
            name: (CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily)(name, text, labels=labels)
            for name, labels, text in FAMILIES
        }

        def add(labels: tuple[str, ...], samples: _Samples) -> None:
            for (name, *own), value in samples.items():
                made[name].add_metric([*labels, *own], value)

        with self._one_at_a_time:
            now = self._look()
            add((), self._of_bridge(now))
            for link in now.links:
                add((link.name,), _samples(Of.LINK, link))
            known, self._highest = self._highest, {}
            for route, labels in zip(now.routes, _labels_of(now.routes), strict=True):
                add((*labels, route.spec.kind), _samples(Of.ROUTE, route))
                of = Of.MESSAGES if route.calls is None else Of.CALLS
                samples = _samples(of, route)
                self._highest[route.key] = counters = _highest(known.get(route.key, {}), samples)
                add(labels if route.calls is None else (*labels, route.spec.kind), samples | counters)
        yield from made.values()  # outside of the lock: a slow reader holds up no other one

    def _of_bridge(self, now: Snapshot) -> _Samples:
        samples: _Samples = {
            ("rsb_build_info", self._version): 1,
            ("rsb_session_info", now.name, now.role, str(now.domain_id)): 1,
            ("rsb_running",): now.running,
            ("rsb_snapshot_timestamp_seconds",): now.time,
        }
        return samples | {("rsb_events_total", level.value): count for level, count in self._events.counts.items()}


def _highest(before: _Samples, samples: _Samples) -> _Samples:
    """Return the highest values so far of the counters in samples; they fall only when the sender restarts."""
    counts = {each: value for each, value in samples.items() if each[0].endswith("_total")}
    # By the order of `FIGURES` the first one is of messages offered or calls asked. No correction makes these fall.
    first = next(iter(counts))
    if counts[first] < before.get(first, 0):
        return counts
    # A cause that is no longer listed counts as 0, and its counter must not fall either.
    return {each: max(before.get(each, 0), counts.get(each, 0)) for each in {**before, **counts}}


def _samples(of: Of, subject: LinkSnapshot | RouteSnapshot) -> _Samples:
    """Read the metrics of a link or a route. Figures that are not known have no sample."""
    found: _Samples = {}
    for name, figure in _METRICS[of]:
        value = figure.read(subject)
        if value is None:
            continue
        if not figure.by:
            found[name,] = value
        elif figure.at:
            found[name, figure.at] = value
        elif isinstance(value, str):
            found[name, value] = 1
        else:
            for label, each in value.items():
                sample = name, label if of not in _CAUSES or label in _CAUSES[of] else OTHER
                found[sample] = found.get(sample, 0) + each
    return found


def _labels_of(routes: Sequence[RouteSnapshot]) -> Iterator[tuple[str, str, str]]:
    """Yield link, topic and direction of each. Topics with one name on this side get the other side's name as well."""
    named = [(route.link, route.topic, "out" if route.outgoing else "in", route.spec.kind) for route in routes]
    times = Counter(named)
    for each, route in zip(named, routes, strict=True):
        link, topic, direction, _ = each
        yield link, topic if times[each] == 1 else f"{topic} ({route.remote_topic})", direction


class MetricsServer(ThreadingMixIn, WSGIServer):
    """Serves a WSGI application: a thread for each connection, while somebody calls `turn`.

    It serves a few readers, each for a short time, because a whole network may reach it.

    Args:
        steady: the time (s) on a clock that nobody sets.
        failed: called with exceptions of the application.

    Raises:
        OSError: the address cannot be bound.
    """

    daemon_threads = False  # so that closing waits for them
    request_queue_size = 16
    timeout = _LOOKS_EVERY

    def __init__(
        self,
        host: str,
        port: int,
        app: WSGIApplication,
        steady: Callable[[], float],
        failed: Callable[[Exception], None],
    ) -> None:
        # The default is IPv4, and the address may be IPv6.
        own = socket.gethostname().lower()
        self._names = {host.lower(), own, f"{own}.local", "localhost"}
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        self.address_family, _, _, _, address = found[0]
        self._steady = steady
        self._open: dict[socket.socket, float] = {}
        super().__init__(address, _Handler)  # type: ignore[arg-type]  # an IPv6 address has four parts

        def answer(environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
            if not self._is_meant(environ.get("HTTP_HOST", "")):
                start_response("421 Misdirected Request", [("Content-Type", "text/plain")])
                return [b"ask by an address, or by the name that metrics gives in the session\n"]
            try:
                return app(environ, start_response)
            except Exception as error:  # noqa: BLE001 (the last resort: the server goes on, and the log has the error)
                failed(error)
                start_response("500 Internal Server Error", [("Content-Type", "text/plain")])
                return [b"internal error: see the bridge's log\n"]

        self.set_app(answer)

    def _is_meant(self, given: str) -> bool:
        """Whether a request's Host names this server.

        A web page can have its own name lead here, and its visitor's browser ask: then Host is the page's name. Nobody
        can give an address as a name.
        """
        try:
            host = urlsplit(f"//{given}").hostname or ""
            if host and host not in self._names:
                ip_address(host)
        except ValueError:
            return False
        return True

    def server_bind(self) -> None:
        """Bind without a reverse DNS lookup, which may block."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])
        self.setup_environ()

    def turn(self) -> None:
        """Take a connection; returns after a second without one, or after `wake`."""
        self.handle_request()
        latest = self._steady() - _ANSWERED_WITHIN
        for request, began in list(self._open.items()):  # a copy: the connections' threads take themselves out
            if began <= latest:
                _shut(request)

    def wake(self) -> None:
        """Have `turn` return at once, and take no connection any more; called on any thread."""
        _shut(self.socket)

    def server_close(self) -> None:
        """Close everything; returns once all threads have ended."""
        for request in list(self._open):  # else closing waits for readers that send nothing
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
    """Prints nothing: standard error may be the terminal of a console."""

    timeout = _ANSWERED_WITHIN

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 (so it is called there)
        pass

    def get_stderr(self) -> io.StringIO:
        return io.StringIO()


def _shut(sock: socket.socket) -> None:
    """Wake all threads that wait for a socket."""
    with contextlib.suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)

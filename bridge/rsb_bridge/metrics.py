"""Serves metrics for Prometheus over HTTP, on threads of their own, at the session's `metrics` address."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.http_address import host_and_port
from rsb_bridge.model.snapshot import Level

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.model.snapshot import Snapshot

_RETRIED_EVERY = 10.0
_ENDS_WITHIN = 2.0


class Metrics:
    """The bridge's metrics. It belongs to the I/O thread, which never waits for a scrape.

    Args:
        context: the session, and the event log.
        look: gives the newest snapshot, on any thread.
    """

    def __init__(self, context: Context, look: Callable[[], Snapshot]) -> None:
        self._context = context
        self._look = look
        self._service: _Service | None = None

    def open(self) -> None:
        """Serve from now on, at the address that the session names now."""
        before, self._service = self._service, None
        if before is not None:
            before.end()
        if self._context.session.metrics is not None:
            self._service = _Service(self._context, self._look, before)
            self._service.thread.start()

    def close(self) -> None:
        """Serve no more. May be called twice."""
        service, self._service = self._service, None
        if service is not None:
            service.end()
            service.thread.join(_ENDS_WITHIN)


class _Service:
    """Serves at one address until `end`. An address that is taken is tried again, and ends nothing else.

    Attributes:
        thread: that does so.
    """

    def __init__(self, context: Context, look: Callable[[], Snapshot], before: _Service | None) -> None:
        self._context = context
        self._look = look
        self._before = before
        self._address = context.session.metrics or ""
        self._ends = threading.Event()
        self._stop: Callable[[], None] = self._ends.set
        self.thread = threading.Thread(target=self._run, name="rsb-metrics", daemon=True)

    def end(self) -> None:
        """Have the thread end soon."""
        self._ends.set()
        self._stop()

    def _run(self) -> None:
        if self._before is not None:
            self._before.thread.join()  # it may have this port
            self._before = None
        try:
            # Here, since they take a while to load, and only bridges with this key need them.
            from rsb_bridge.telemetry.metrics import MetricsServer, application  # noqa: PLC0415
        except ModuleNotFoundError as error:
            if error.name != "prometheus_client":
                raise
            remedy = "it needs prometheus-client: pip install 'rsb-console[metrics]', and restart the bridge"
            self._tell(Level.WARNING, f"no metrics are served: {remedy}")
            return
        app = application(self._look, self._context.events)
        host, port = host_and_port(self._address)
        told = ""
        while not self._ends.is_set():
            try:
                server = MetricsServer(host, port, app, self._context.clock.steady, self._failed)
            except OSError as error:
                if told != (told := error.strerror or str(error)):
                    remedy = f"it is tried again every {_RETRIED_EVERY:.0f} s; or name another address"
                    self._tell(Level.ERROR, f"no metrics are served, and the bridge goes on: {told}; {remedy}")
                self._ends.wait(_RETRIED_EVERY)
                continue
            told = ""
            self._tell(Level.INFO, "metrics are served")
            self._stop = server.wake
            with server:
                while not self._ends.is_set():
                    server.turn()

    def _failed(self, error: Exception) -> None:
        self._tell(Level.ERROR, f"internal error, please report it: {error}")

    def _tell(self, level: Level, text: str) -> None:
        self._context.events.add(level, EventCode.ENGINE_METRICS, f"metrics {self._address}: {text}")

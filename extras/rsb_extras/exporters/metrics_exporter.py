"""Serves the metrics at the address that the session names."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EnginePart, Level, Unable
from rsb_extras.exporters import METRICS
from rsb_extras.exporters.exporter_codes import ExporterCode
from rsb_extras.exporters.rules import host_and_port

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.feature_api import Context, Snapshot

_RETRIED_EVERY = 10.0
"""s until an address that is taken is tried again. A round figure: an operator who has freed it waits so long."""
_ENDS_WITHIN = 1.0
"""s that the end of a bridge waits for a scrape, as for the fault hook: headless, the I/O thread has 2.5 s to end in
all."""


class MetricsExporter(EnginePart):
    """Serves the session's `metrics` over HTTP, on threads of their own; the I/O thread, its owner, awaits no scrape.

    Args:
        look: gives the newest snapshot, on any thread.
    """

    def __init__(self, context: Context, look: Callable[[], Snapshot]) -> None:
        super().__init__()
        self._context = context
        self._look = look
        self._service: _Service | None = None
        self.by_key = (((METRICS.name,), self.open),)

    def open(self) -> None:
        before, self._service = self._service, None
        if before is not None:
            before.end()
        if (address := METRICS.of(self._context.session)) is not None:
            self._service = _Service(self._context, address, self._look, before)
            self._service.thread.start()

    async def close(self) -> None:
        # A scrape that is under way is waited for at the end only: motions have yet to end.
        if self._service is not None:
            self._service.end()

    def join(self) -> None:
        service, self._service = self._service, None
        if service is not None:
            service.thread.join(_ENDS_WITHIN)


class _Service:
    """Serves at one address until `end`. An address that is taken is tried again, and ends nothing else."""

    def __init__(self, context: Context, address: str, look: Callable[[], Snapshot], before: _Service | None) -> None:
        self._context = context
        self._look = look
        self._before = before
        self._address = address
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
            self._before = None  # else each service keeps the one before it
        try:
            # Here, since they take a while to load, and only bridges with this key need them.
            from rsb_extras.exporters.metrics import MetricsServer, application  # noqa: PLC0415
        except ModuleNotFoundError as error:
            # Any other missing module is a broken installation, which the extra would not mend.
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
                    remedy = f"trying again every {_RETRIED_EVERY:.0f} s; or name another address"
                    self._tell(Level.ERROR, f"no metrics are served: {told}; {remedy}; the bridge goes on")
                self._ends.wait(_RETRIED_EVERY)
                continue
            told = ""
            self._tell(Level.INFO, "metrics are served")
            # Before `_ends` is asked: an `end` in between would wake nobody.
            self._stop = server.wake
            with server:
                while not self._ends.is_set():
                    server.turn()

    def _failed(self, error: Exception) -> None:
        self._tell(Level.ERROR, Unable.INTERNAL(problem=error))

    def _tell(self, level: Level, text: str) -> None:
        self._context.events.add(level, ExporterCode.METRICS, f"metrics {self._address}: {text}")

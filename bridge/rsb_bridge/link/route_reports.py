"""Exchanges the routes' counts with the peer: once a second, and earlier for routes that receive much."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.link.control_channel import in_slices
from rsb_bridge.link.extension import Extension
from rsb_bridge.route.calls.calls_route import CallsRoute
from rsb_bridge.route.incoming import IncomingRoute
from rsb_bridge.route.outgoing import OutgoingRoute
from rsb_bridge.wire.codec import ReportParts, report_entries
from rsb_bridge.wire.messages import Report
from rsb_bridge.wire.records import ReceivedReport, SentReport

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterable, Iterator

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.control_channel import Slices
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.records import CallsReport, FullRecord

_REPORTED_AT_ONCE = 250
"""Routes in one message, which must not exceed its limit even with the longest texts (PROTOCOL.md section 1)."""
_EARLY = 0.1
"""Seconds from `RouteReports.add` to the report."""


def _reports(routes: Iterable[Route], full: FullRecord | None = None) -> Iterator[Report]:
    """Yield the counts that the peer does not know yet, and the link's fullness if it has changed."""
    sent: list[SentReport] = []
    received: list[ReceivedReport] = []
    calls: list[CallsReport] = []
    for route in routes:
        if not route.accepted:
            continue  # the other side may not know it yet
        if isinstance(route, OutgoingRoute):
            if (sending := route.news()) is not None:
                sent.append(sending)
        elif isinstance(route, IncomingRoute):
            if (receiving := route.news()) is not None:
                received.append(receiving)
        elif isinstance(route, CallsRoute) and (carrying := route.news()) is not None:
            calls.append(carrying)
    if full is not None:
        yield Report(sent=(), received=(), full=full)
    for first in range(0, max(len(sent), len(received), len(calls)), _REPORTED_AT_ONCE):
        part = slice(first, first + _REPORTED_AT_ONCE)
        yield Report(sent=tuple(sent[part]), received=tuple(received[part]), calls=tuple(calls[part]))


class RouteReports(Extension):
    """The reports of one link's routes. Early ones go together, at most ten times a second."""

    def __init__(self, link: BaseLink) -> None:
        self.messages = {Report: self._take, ReportParts: self._take}
        self._link = link
        self._due: set[Route] = set()
        self._timer: asyncio.TimerHandle | None = None

    def add(self, route: Route) -> None:
        """Report a route within `_EARLY` s. May be called for every batch."""
        self._due.add(route)
        if self._timer is None:
            self._timer = self._link.context.loop.call_later(_EARLY, self._report_early)

    def _report_early(self) -> None:
        self._timer = None
        due, self._due = self._due, set()
        for report in _reports(due):
            self._link.send(report)

    def disconnected(self) -> None:
        self._due.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def tick(self) -> None:
        if self._link.linked:
            for report in _reports(self._link.routes.values(), self._link.fullness.next_record()):
                self._link.send(report)

    def _take(self, report: Report | ReportParts) -> Slices:
        if report.full is not None:
            self._link.contention.take_record(report.full, self._link.peer_name)
        return in_slices(report_entries(report), self._take_entry)

    def _take_entry(self, entry: SentReport | ReceivedReport | CallsReport) -> None:
        route = self._link.ids.open_route(entry.route)
        if isinstance(entry, SentReport):
            if isinstance(route, IncomingRoute):
                route.reported(entry)
        elif isinstance(entry, ReceivedReport):
            if isinstance(route, OutgoingRoute):
                route.reported(entry)
        elif isinstance(route, CallsRoute):
            route.reported(entry)

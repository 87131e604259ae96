"""Exchanges the routes' counts with the peer: once a second, and earlier for routes that receive much."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.link.control_channel import in_slices
from rsb_bridge.link.extension import Extension
from rsb_bridge.wire.codec import ReportParts, report_entries
from rsb_bridge.wire.messages import Report
from rsb_bridge.wire.records import CallsReport, ReceivedReport, SentReport

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterable, Iterator

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.control_channel import Slices
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.records import FullRecord, PathRecord

_REPORTED_AT_ONCE = 250
"""Routes in one message, which must not exceed its limit even with the longest texts (PROTOCOL.md section 1)."""
_EARLY = 0.1
"""Seconds from `RouteReports.add` to the report: messages that a killed receiver had not reported count as unknown."""


def _reports(
    routes: Iterable[Route], full: FullRecord | None = None, path: PathRecord | None = None
) -> Iterator[Report]:
    """Yield the counts that the peer does not know yet, and the link's fullness and path if they have changed."""
    news = [route.news() for route in routes if route.life.accepted]  # the other side may not know the others yet
    sent = [each for each in news if isinstance(each, SentReport)]
    received = [each for each in news if isinstance(each, ReceivedReport)]
    calls = [each for each in news if isinstance(each, CallsReport)]
    if full is not None or path is not None:
        yield Report(sent=(), received=(), full=full, path=path)
    for first in range(0, max(len(sent), len(received), len(calls)), _REPORTED_AT_ONCE):
        part = slice(first, first + _REPORTED_AT_ONCE)
        yield Report(sent=tuple(sent[part]), received=tuple(received[part]), calls=tuple(calls[part]))


class RouteReports(Extension):
    """The reports of one link's routes. Early ones go together, at most ten times a second."""

    def __init__(self, link: BaseLink) -> None:
        self.messages = {Report: self._receive, ReportParts: self._receive}
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
            routes = [route for route in self._link.routes.values() if not route.idle]
            for report in _reports(routes, self._link.fullness.next_record(), self._link.path.next_record()):
                self._link.send(report)

    def _receive(self, report: Report | ReportParts) -> Slices:
        if report.full is not None:
            self._link.fullness_watch.take_record(report.full, self._link.peer_name)
        if report.path is not None:
            self._link.path.take_record(report.path, self._link.peer_name)
        return in_slices(report_entries(report), self._receive_entry)

    def _receive_entry(self, entry: SentReport | ReceivedReport | CallsReport) -> None:
        route = self._link.ids.open_route(entry.route)
        if route is not None and isinstance(entry, route.peer_report):  # a peer may report as the half that is here
            route.reported(entry)

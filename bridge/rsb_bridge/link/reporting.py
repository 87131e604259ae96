"""The two sides of a link tell each other what their halves of the routes have counted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.link.control_channel import in_slices
from rsb_bridge.route.calls.calls_route import CallsRoute
from rsb_bridge.route.incoming import IncomingRoute
from rsb_bridge.route.outgoing import OutgoingRoute
from rsb_bridge.wire.codec import report_entries
from rsb_bridge.wire.messages import Report
from rsb_bridge.wire.records import ReceivedReport, SentReport

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable, Iterator

    from rsb_bridge.link.control_channel import Slices
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.codec import ReportParts
    from rsb_bridge.wire.records import CallsReport, FullRecord

_REPORTED_AT_ONCE = 250
"""Routes in one message, whatever long texts are in it (PROTOCOL.md section 1)."""


_EARLY = 0.1
"""s"""


def reports(routes: Iterable[Route], full: FullRecord | None = None) -> Iterator[Report]:
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


class EarlyReports:
    """Early reports of routes that have received much since the last one: together, at most ten times a second.

    Args:
        loop: the I/O loop.
        send: sends a message to the peer.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, send: Callable[[Report], None]) -> None:
        self._loop = loop
        self._send = send
        self._due: set[Route] = set()
        self._timer: asyncio.TimerHandle | None = None

    def add(self, route: Route) -> None:
        """Report a route within `_EARLY` s."""
        self._due.add(route)
        if self._timer is None:
            self._timer = self._loop.call_later(_EARLY, self._report)

    def _report(self) -> None:
        self._timer = None
        due, self._due = self._due, set()
        for report in reports(due):
            self._send(report)

    def disconnected(self) -> None:
        """Forget the pending reports: no peer can take them."""
        self._due.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def take_report(report: Report | ReportParts, open_route: Callable[[int], Route | None]) -> Slices:
    """Take in the peer's counts."""

    def take(entry: SentReport | ReceivedReport | CallsReport) -> None:
        route = open_route(entry.route)
        if isinstance(entry, SentReport):
            if isinstance(route, IncomingRoute):
                route.reported(entry)
        elif isinstance(entry, ReceivedReport):
            if isinstance(route, OutgoingRoute):
                route.reported(entry)
        elif isinstance(route, CallsRoute):
            route.reported(entry)

    return in_slices(report_entries(report), take)

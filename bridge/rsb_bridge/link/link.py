"""One peer with its routes, their reports, and all other features of a link."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, final

from rsb_bridge.installed_features import added_by
from rsb_bridge.link.base_link import BaseLink
from rsb_bridge.link.control_channel import entries_in_slices
from rsb_bridge.link.extension import Denied, Extension, LinkError
from rsb_bridge.link.fullness import LinkFullness
from rsb_bridge.link.link_entries import LinkEntries
from rsb_bridge.link.link_fault import LinkFault
from rsb_bridge.link.link_patterns import LinkPatterns
from rsb_bridge.link.path_watch import PathWatch
from rsb_bridge.link.pattern_hints import PatternHints
from rsb_bridge.link.proposed_routes import ProposedTopics
from rsb_bridge.link.questions import TopicLists, TypeQuestions
from rsb_bridge.link.route_table import RouteTable
from rsb_bridge.link.subflows import Subflows
from rsb_bridge.model.snapshot import LinkSnapshot
from rsb_bridge.route.sender import Sender
from rsb_bridge.tasks import in_slices
from rsb_bridge.telemetry.meters import ClockOffset, Smoothed
from rsb_bridge.wire.codec import ReportEntry, ReportParts, report_entries
from rsb_bridge.wire.messages import Neighbours, Report, Unsaved
from rsb_bridge.wire.records import CallsReport, ReceivedCounts, ReceivedReport, SentCounts, SentReport

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import Slices
    from rsb_bridge.link.link_end import LinkEnd
    from rsb_bridge.link.link_fault import PresentFault
    from rsb_bridge.model.snapshot import TopicInfo
    from rsb_bridge.route.route import Route

_REPORTED_AT_ONCE = 25
"""Routes in one message. They take up to 1 ms; with the longest texts, a message has room for 250 (PROTOCOL.md, 1)."""
_EARLY = 0.1
"""Seconds from `RouteReports.add` to the report: messages that a killed receiver had not reported count as unknown."""

_LISTS = {
    SentReport: "sent",
    ReceivedReport: "received",
    CallsReport: "calls",
    SentCounts: "sent_counts",
    ReceivedCounts: "received_counts",
}
"""The lists of a report, by the type of their entries."""


class LinkTraffic(Extension):
    """The bytes of a link, with all headers: of all connections, and the rates of the present one."""

    def __init__(self, link: BaseLink) -> None:
        self._link = link
        self.rx_bytes = self.tx_bytes = 0  # received and sent, as of the last second
        self.connected()

    def connected(self) -> None:
        now = self._link.context.now()
        self.rx, self.tx = Smoothed(now), Smoothed(now)
        self._received = self._sent = 0

    resume = connected

    def tick(self) -> None:
        now, carriers = self._link.context.now(), self._link.carriers()
        received, sent = sum([each.received_bytes for each in carriers]), sum([each.sent_bytes for each in carriers])
        # The sums fall when a carrier closes.
        more_received, more_sent = max(0, received - self._received), max(0, sent - self._sent)
        self.rx.add(more_received, now)
        self.tx.add(more_sent, now)
        self.rx_bytes += more_received
        self.tx_bytes += more_sent
        self._received, self._sent = received, sent


class Neighbourhood(Extension):
    """The bridges in the ROS domains of both sides: each side tells the other which are in its own."""

    def __init__(self, link: BaseLink) -> None:
        self.messages = {Neighbours: self._receive}
        self._link = link
        self._announcements = link.context.announcements
        self._told: tuple[str, ...] = ()

    def connected(self) -> None:
        self.tell()

    def tell(self) -> None:
        """Tell the linked peer which bridges are in this domain, unless it knows."""
        if self._announcements.bridges != self._told:
            self._told = self._announcements.bridges
            self._link.send(Neighbours(bridges=self._told))

    def _receive(self, neighbours: Neighbours) -> None:
        if neighbours.bridges != self._link.bridges:
            self._link.bridges = neighbours.bridges
            self._announcements.changed()

    def disconnected(self) -> None:
        self._link.bridges = self._told = ()


class UnsavedChanges(Extension):
    """Changes of a session by the other side's operators that its file lacks: each side tells the other of its own.

    Attributes:
        there: whether the other side's file lacks a change that was made here.
    """

    def __init__(self, link: Link) -> None:
        self.messages = {Unsaved: self._receive}
        self._link = link
        self.there = self._told = False

    def tick(self) -> None:
        link = self._link
        if not (link.linked and link.table.changed_by_peer):
            return
        if (unsaved := link.context.is_unsaved()) is not self._told:
            self._told = unsaved
            link.send(Unsaved(unsaved))
        link.table.changed_by_peer = unsaved

    def disconnected(self) -> None:
        self.there = self._told = False

    def _receive(self, message: Unsaved) -> None:
        self.there = message.unsaved


def _report(routes: Iterable[Route]) -> Report | None:
    """Return what the peer does not know yet, or None if it knows all."""
    news: dict[type, list[Any]] = {}
    for route in routes:
        if route.life.accepted:  # the other side may not know the others yet
            for each in route.half.news():
                news.setdefault(type(each), []).append(each)
    lists: dict[str, Any] = {name: tuple(news[kind]) for kind, name in _LISTS.items() if kind in news}
    return Report(**lists) if lists else None


class RouteReports(Extension):
    """Exchanges the routes' counts with the peer once a second. Early ones go together, at most ten times a second."""

    def __init__(self, link: Link) -> None:
        self.messages = {Report: self._receive, ReportParts: self._receive}
        self._link = link
        self._due: set[Route] = set()
        self._timer: asyncio.TimerHandle | None = None
        self._link.looked_at_there = self._told_looked_at = False

    def add(self, route: Route) -> None:
        """Report a route within `_EARLY` s. May be called for every batch."""
        self._due.add(route)
        if self._timer is None:
            self._timer = self._link.context.loop.call_later(_EARLY, self._report_early)

    def _report_early(self) -> None:
        self._timer = None
        due, self._due = self._due, set()
        self._report(list(due))

    def _report(self, routes: list[Route]) -> None:
        """Report some routes at once, and more of them in slices."""
        if len(routes) <= _REPORTED_AT_ONCE:
            self._report_now(routes)
            return
        connection = self._link.connections

        def report(part: list[Route]) -> None:
            if self._link.linked and self._link.connections == connection:
                self._report_now(part)

        parts = (routes[first : first + _REPORTED_AT_ONCE] for first in range(0, len(routes), _REPORTED_AT_ONCE))
        self._link.spawn(in_slices(parts, report, at_once=1))

    def resume(self) -> None:
        """Report all routes, as the last reports may have been lost with the connection."""
        for route in self._link.ids.open_routes():
            self.add(route)

    def peer_leaves(self) -> None:
        """Take the peer's counts for final, as it leaves with a goodbye."""
        for route in self._link.routes.values():
            if isinstance(route.half, Sender):
                route.half.receiver_left()

    def leaving(self) -> None:
        """Send the last counts: what is not in them has not arrived."""
        routes = [*self._link.routes.values()]
        for route in routes:
            route.idling.goes_on_now = False  # else what it has counted since its last tick is left out
        for first in range(0, len(routes), _REPORTED_AT_ONCE):
            self._report_now(routes[first : first + _REPORTED_AT_ONCE])

    def _report_now(self, routes: Iterable[Route]) -> None:
        if (report := _report(routes)) is not None:
            self._link.send(report)

    def disconnected(self) -> None:
        self._due.clear()
        self._link.looked_at_there = self._told_looked_at = False
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def tick(self) -> None:
        if self._link.linked:
            full, path = self._link.fullness.next_record(), self._link.path.next_record()
            looked_at = self._news_of_looks()
            if full is not None or path is not None or looked_at is not None:
                self._link.send(Report(full=full, path=path, looked_at=looked_at))
            self._report([*self._link.awake])

    def _news_of_looks(self) -> bool | None:
        """Return whether anybody looks all the time here, or None if the peer knows that."""
        looked_at = self._link.context.is_looked_at()
        if looked_at is self._told_looked_at:
            return None
        self._told_looked_at = looked_at
        return looked_at

    def _receive(self, report: Report | ReportParts) -> Slices:
        if report.looked_at is not None:
            self._link.looked_at_there = report.looked_at
        if report.full is not None:
            self._link.fullness.take_record(report.full)
        if report.path is not None:
            self._link.path.take_record(report.path)
        return entries_in_slices(report_entries(report), self._receive_entry)

    def _receive_entry(self, entry: ReportEntry) -> None:
        route = self._link.ids.open_route(entry.route)
        # A peer may report as the half that is here.
        if route is not None and isinstance(entry, route.half.peer_report):
            route.half.reported(entry)


class LinkSnapshots:
    """Makes the snapshots of one link. While nobody looks, its figures alone need no new one each second."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._signs: tuple[object, ...] = ()  # of the last one

    @property
    def only_counts(self) -> bool:
        """Whether nothing but figures, and what features show, may differ from the last snapshot."""
        patterns = self._link.patterns.names.entries  # their states follow from their routes
        return not patterns and self._present_signs(self._link.fault.now()) == self._signs

    def _present_signs(self, fault: PresentFault) -> tuple[object, ...]:
        """Return what changes if anything happens to the link, apart from its figures."""
        link, status = self._link, self._link.status
        return (
            status.cause, status.reason, status.attempts, link.connections, link.suspended_since, link.unsaved.there,
            fault.cause, fault.warning,
        )  # fmt: skip

    def make(self) -> LinkSnapshot:
        """Return the link as it is now."""
        link, fault = self._link, self._link.fault.now()
        self._signs = self._present_signs(fault)
        linked, traffic, peer = link.linked, link.traffic, link.peer
        now, steady = link.context.now(), link.context.clock.steady()
        ends = None if link.association is None else link.association.ends_at
        clock = link.clock if linked else ClockOffset()  # figures of a dead connection are out of date
        current_key, next_key = link.end.fingerprints
        return LinkSnapshot(
            name=link.name,
            peer=link.end.address,
            state=link.status.state,
            reason=link.down_reason,
            since=link.context.wall_of(link.status.since),
            retry_in=link.status.retry_in(now),
            attempts=link.status.attempts,
            association_ends=None if ends is None else link.context.wall_of(steady + ends - now),
            encrypted=link.encrypted,
            cipher=link.channels.connection_keys.suite.name if linked and link.encrypted else "",
            fingerprint=current_key,
            next_fingerprint=next_key,
            rtt=clock.rtt,
            clock_offset=clock.offset,
            clock_uncertainty=clock.uncertainty,
            rx_bytes_per_second=traffic.rx.rate if linked else 0.0,
            tx_bytes_per_second=traffic.tx.rate if linked else 0.0,
            rx_bytes_total=traffic.rx_bytes,
            tx_bytes_total=traffic.tx_bytes,
            peer_version=peer.version if peer else "",
            peer_domain=peer.domain_id if peer else None,
            use_name=link.end.use_name,
            cause=fault.cause,
            warning=fault.warning,
            warning_since=fault.warning_since,
            capacity_out=link.fullness.sending.capacity,
            capacity_in=link.fullness.receiving.capacity,
            loss_out=link.path.loss.share if linked else None,
            loss_in=link.path.into.lost,
            via=link.subflows.used or link.via if linked else "",
            ways=link.subflows.ways or link.end.ways_shown(),
            full_out=link.fullness.out,
            full_in=link.fullness.into,
            unsaved_there=link.unsaved.there,
            patterns=tuple(link.patterns.snapshots()),
            features=link.extensions.link_fields(),
        )


@final
class Link(BaseLink):
    """A peer, its routes and the link's features. It lives on while the peer is away.

    A part of it is an `Extension` that `__init__` registers; those of features come last.
    """

    path: PathWatch
    fullness: LinkFullness

    def __init__(self, context: Context, name: str, end: LinkEnd, *, is_client: bool, encrypted: bool) -> None:
        super().__init__(context, name, end, is_client=is_client, encrypted=encrypted)
        self.traffic = self.extend(LinkTraffic(self))
        self.subflows = self.extend(Subflows(self))
        # Before the link's fullness: a path that loses packets is not taken for a full one.
        self.path = self.extend(PathWatch(self))
        self.fullness = self.extend(LinkFullness(self, self.path))
        self.fault = self.extend(LinkFault(self, self.path, self.fullness))
        self.cause = self.fault.cause
        # Before the proposals: Neighbours decides what would loop (PROTOCOL.md, 3).
        self.neighbourhood = self.extend(Neighbourhood(self))
        self.reports = self.extend(RouteReports(self))
        self.report_soon = self.reports.add
        self.table = self.extend(RouteTable(self))
        self.proposed = self.extend(ProposedTopics(self, self.table))
        self.unsaved = self.extend(UnsavedChanges(self))
        self.patterns = self.extend(LinkPatterns(self, self.table, self.proposed, self.extend(PatternHints(self))))
        self.entries = LinkEntries(self, self.table, self.proposed, self.patterns)
        self.topic_lists = self.extend(TopicLists(self))
        self.type_questions = self.extend(TypeQuestions(self))
        self.compare_types = self.type_questions.compare
        for feature, extension in added_by("extensions", self):
            extension.feature = feature.name
            self.extend(extension)
        context.demands.register(self.entries)
        self._snapshots = LinkSnapshots(self)

    def snapshot(self) -> LinkSnapshot:
        """Return the link as it is now."""
        return self._snapshots.make()

    @property
    def only_counts(self) -> bool:
        """Whether nothing but figures may differ from its last snapshot."""
        return self._snapshots.only_counts


async def topics_of_peer(links: Iterable[Link], name: str) -> list[TopicInfo]:
    """Return the topics and services of the peer's graph.

    Raises:
        LinkError: there is no such link, it is down, or the peer does not answer.
    """
    link = next((each for each in links if each.name == name), None)
    if link is None:
        raise LinkError(Denied.NO_LINK(name=name))
    if not link.linked:
        raise LinkError(Denied.NOT_LINKED(name=link.name, reason=link.down_reason))
    try:
        return await link.topic_lists.ask()
    except LinkError as error:
        raise LinkError(f"{link.name}: {error}") from None


def link_named(name: str, links: Sequence[Link]) -> Link:
    """Return the link of a name, or the only link if the name is empty.

    Raises:
        LinkError: no link has the name, or it is empty and there is not exactly one link.
    """
    found = [link for link in links if name in ("", link.name)]
    if len(found) != 1:
        raise LinkError(Denied.WHICH_CLIENT(clients=", ".join(link.name for link in links)))
    return found[0]

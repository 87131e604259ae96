"""One peer with its routes, and all features of a link. Clients and servers add how it is connected."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

from rsb_bridge.link.base_link import BaseLink
from rsb_bridge.link.errors import Denied, LinkError
from rsb_bridge.link.extension import Extension
from rsb_bridge.link.link_bench import LinkBench
from rsb_bridge.link.link_patterns import LinkPatterns
from rsb_bridge.link.link_views import LinkViews
from rsb_bridge.link.proposed_topics import ProposedTopics
from rsb_bridge.link.questions import TopicLists, TypeQuestions
from rsb_bridge.link.route_channels import RouteChannels
from rsb_bridge.link.route_reports import RouteReports
from rsb_bridge.link.route_table import RouteTable
from rsb_bridge.model.demands import sources_of_entries
from rsb_bridge.model.snapshot import LinkSnapshot
from rsb_bridge.telemetry.meters import ClockOffset
from rsb_bridge.wire.messages import Neighbours

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.demands import DemandSource
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import TopicInfo


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


class Link(BaseLink):
    """A peer, its routes and the link's features. It lives on while the peer is away.

    A new feature is an `Extension` that `__init__` registers.

    Attributes:
        proposed: the topics that this side proposes.
        patterns: the same for patterns of names, and the names that the peer follows here.
        topic_lists: questions of the two sides about their graphs.
        views: pictures of topics, for viewers of both sides.
    """

    def __init__(self, context: Context, name: str, *, is_client: bool, encrypted: bool) -> None:
        super().__init__(context, name, is_client=is_client, encrypted=encrypted)
        # First: Neighbours goes ahead of the proposals, as it decides what would loop (PROTOCOL.md, 3).
        self.neighbourhood = self.extend(Neighbourhood(self))
        self.route_channels = self.extend(RouteChannels(self))
        self.open_channel = self.route_channels.open
        self.report_soon = self.extend(RouteReports(self)).add
        self.table = self.extend(RouteTable(self))
        self.proposed = ProposedTopics(self, self.table)
        self.patterns = self.extend(LinkPatterns(self, self.table, self.proposed))
        self.topic_lists = self.extend(TopicLists(context.ros, self.shows, self.send, self.spawn))
        self.type_questions = self.extend(
            TypeQuestions(context.descriptions, self.ids.open_route, self.send, self.spawn)
        )
        self.table.compare_types = self.type_questions.compare
        self.bench = self.extend(LinkBench(self, self.table, self.proposed))
        self.views = self.extend(LinkViews(self, self.table, self.proposed))
        context.demands.register(self)

    @property
    @abstractmethod
    def fingerprints(self) -> tuple[str, str]:
        """Fingerprints of the current and the next key, or empty strings."""

    @property
    def shut_down(self) -> bool:
        """Whether the link is down on purpose and waits for this side's operator."""
        return False

    @abstractmethod
    def client_names(self, topic: Topic) -> Topic:
        """Return a topic, which this side's operator may name as this side does, with the client's names."""

    # --- entries of the session

    def listed_topics(self) -> tuple[Topic, ...]:
        """Return the topics and patterns that this side proposes. May be called from any thread."""
        return (*self.proposed.all(), *self.patterns.all())

    def add_entry(self, topic: Topic) -> str:
        """Bridge one more topic, or follow one more pattern; return its key.

        Raises:
            LinkError: the entry has a mistake, or exists already.
        """
        return self.patterns.add(topic) if topic.is_pattern else self.proposed.add(topic).key

    def demand_sources(self) -> Iterable[DemandSource]:
        """Yield the entries that demand arming, as operators have left them."""
        use_name = not self.is_client and self.use_name
        return sources_of_entries(self.listed_topics(), self.name, on_server=not self.is_client, use_name=use_name)

    def apply_demands(self) -> None:
        """Reopen the routes whose demands have changed."""
        self.table.apply_demands()

    def demand_dropped(self, source: DemandSource) -> None:
        """Tell the other side that an operator drops a demand."""
        self.table.arming.demand_dropped(source)

    # --- snapshots

    def snapshot(self) -> LinkSnapshot:
        """Return the link as it is now."""
        now = self.context.now()
        keepalive, keys, peer = self.keepalive, self.keys, self.peer
        clock = keepalive.clock if self.linked else ClockOffset()  # figures of a dead connection are out of date
        current_key, next_key = self.fingerprints
        return LinkSnapshot(
            name=self.name,
            peer=self.address,
            state=self.status.state,
            reason=self.down_reason,
            since=self.context.wall_of(self.status.since),
            retry_in=self.status.retry_in(now),
            attempts=self.status.attempts,
            encrypted=self.encrypted,
            cipher=keys.suite.name if keys and self.encrypted else "",
            fingerprint=current_key,
            next_fingerprint=next_key,
            rtt=clock.rtt,
            clock_offset=clock.offset,
            clock_uncertainty=clock.uncertainty,
            rx_bytes_per_second=keepalive.rx.rate if self.linked else 0.0,
            tx_bytes_per_second=keepalive.tx.rate if self.linked else 0.0,
            rx_bytes_total=keepalive.rx_bytes,
            tx_bytes_total=keepalive.tx_bytes,
            peer_version=peer.version if peer else "",
            peer_domain=peer.domain_id if peer else None,
            use_name=self.use_name,
            cause=self.fault.cause,
            warning=self.fault.warning,
            warning_since=self.fault.warning_since(),
            capacity_out=self.fullness_watch.sending.capacity,
            capacity_in=self.fullness_watch.receiving.capacity,
            loss_out=self.path.loss.share if self.linked else None,
            loss_in=self.path.into.lost,
            full_out=self.fullness.out,
            full_in=self.fullness.into,
            patterns=tuple(self.patterns.snapshots()),
        )


async def topics_of_peer(links: Iterable[Link], name: str) -> list[TopicInfo]:
    """Return the topics and services of the peer's graph.

    Raises:
        LinkError: there is no such link, it is down, or the peer does not answer.
    """
    link = next((each for each in links if each.name == name), None)
    if link is None:
        raise LinkError(f"there is no link {name!r}")
    if not link.linked:
        raise LinkError(f"{link.name} is not linked: {link.down_reason}")
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

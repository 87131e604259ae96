"""One peer: its connection, its routes, its keepalive and reports. Clients and servers add who connects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.channel import window
from rsb_bridge.channel.datagram_channel import datagram_channel
from rsb_bridge.link.contention import Contention, LinkFullness
from rsb_bridge.link.control_channel import in_slices
from rsb_bridge.link.data_channels import DataChannels
from rsb_bridge.link.keepalive import Keepalive
from rsb_bridge.link.link_bench import LinkBench
from rsb_bridge.link.link_patterns import LinkPatterns, PatternEntry
from rsb_bridge.link.proposed_topics import ProposedTopics
from rsb_bridge.link.questions import TopicLists, TypeQuestions
from rsb_bridge.link.refused_clients import DuplicateClients
from rsb_bridge.link.route_table import RouteTable
from rsb_bridge.model import profiles
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.demands import sources_of_entries
from rsb_bridge.model.limits import MAX_AGE_FEATURE
from rsb_bridge.model.snapshot import Level, LinkSnapshot, State
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.route.lifecycle import Revisions
from rsb_bridge.route.peer import PeerBudget
from rsb_bridge.tasks import Tasks
from rsb_bridge.telemetry.meters import ClockOffset
from rsb_bridge.transport.streams import CLOSED_BY_PEER
from rsb_bridge.transport.transport import StreamTransport
from rsb_bridge.wire import sealing
from rsb_bridge.wire.codec import ReportParts, TopicListParts, report_entries
from rsb_bridge.wire.messages import (
    AskType,
    BenchAnswer,
    BenchAsk,
    Duplicate,
    Follow,
    Followed,
    ListTopics,
    Neighbours,
    Ping,
    Pong,
    Receipts,
    Report,
    Shutdown,
    TopicList,
    TypeText,
    Welcome,
)
from rsb_bridge.wire.protocol_error import Broken, ProtocolError
from rsb_bridge.wire.records import CallsReport, ReceivedReport, SentReport

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Coroutine, Iterable, Iterator

    from rsb_bridge.channel.channel import Carrier
    from rsb_bridge.channel.multiplexer import SharedStream
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.config.rights import Rights
    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import ControlChannel, Slices
    from rsb_bridge.model.capacity import Fullness
    from rsb_bridge.model.demands import Source
    from rsb_bridge.model.session import Kind, Topic
    from rsb_bridge.route.route import Route
    from rsb_bridge.telemetry.event_log import About
    from rsb_bridge.transport.transport import DatagramTransport
    from rsb_bridge.wire.messages import ControlMessage, Hello, Propose
    from rsb_bridge.wire.records import FullRecord
    from rsb_bridge.wire.sealing import Role, SessionKeys

_REPORTED_AT_ONCE = 250
"""Routes in one message, whatever long texts are in it (PROTOCOL.md section 1)."""


_EARLY = 0.1
"""s"""


def reports(routes: Iterable[Route], full: FullRecord | None = None) -> Iterator[Report]:
    """Yield the counts that the peer does not know yet, and the link's fullness if it has changed."""
    news = [route.news() for route in routes if route.accepted]  # the other side may not know the others yet
    sent = [each for each in news if isinstance(each, SentReport)]
    received = [each for each in news if isinstance(each, ReceivedReport)]
    calls = [each for each in news if isinstance(each, CallsReport)]
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
        if route is not None and isinstance(entry, route.peer_report):
            route.reported(entry)

    return in_slices(report_entries(report), take)


_NOT_YET = "not connected yet"
_NO_GOODBYE = "the other side ended without a goodbye: look whether its process or machine has died"
_CAUSES = {EventCode.LINK_LOST: LinkCause.LOST, EventCode.LINK_SHUT_DOWN: LinkCause.SHUT_DOWN}
"""Why a link is down, by how it ended; any other is closed."""


@dataclass(slots=True)
class LinkStatus:
    """Whether a link is up, since when, and why not.

    Attributes:
        since: s since the epoch, when it came up or went down.
        cause: why it is down.
        reason: likewise, for an operator.
        attempts: to connect that failed, since it was last up.
        retry_at: s, when the next one is due; None: none is planned.
    """

    since: float
    cause: LinkCause = LinkCause.NOT_YET
    reason: str = _NOT_YET
    attempts: int = 0
    retry_at: float | None = None

    def up(self, wall: float) -> None:
        """It is up, at `wall` (s since the epoch)."""
        self.since, self.cause = wall, LinkCause.NONE
        self.attempts, self.retry_at = 0, None

    def down(self, cause: LinkCause, reason: str) -> None:
        """It is down for this reason now."""
        self.cause, self.reason = cause, reason

    def retry_in(self, now: float) -> float | None:
        """S until the next attempt, at `now` (s)."""
        return None if self.retry_at is None else max(0.0, self.retry_at - now)

    @property
    def state(self) -> State:
        """WAITING until the first attempt has ended, then OK or DOWN."""
        if self.cause is LinkCause.NONE:
            return State.OK
        return State.WAITING if self.cause is LinkCause.NOT_YET else State.DOWN


class Neighbourhood:
    """The bridges in the ROS domains of both sides: each side tells the other who is in its own.

    Attributes:
        bridges: the names of the bridge nodes in the peer's domain, its own first; empty: not known yet.
    """

    def __init__(self, context: Context, send: Callable[[Neighbours], None]) -> None:
        self.bridges: tuple[str, ...] = ()
        self._context = context
        self._send = send
        self._told: tuple[str, ...] = ()

    def tell(self) -> None:
        """Tell the linked peer which bridges are in this domain, if it does not know."""
        bridges = self._context.announcements.bridges
        if bridges != self._told:
            self._told = bridges
            self._send(Neighbours(bridges=bridges))

    def heard(self, neighbours: Neighbours) -> None:
        """The peer says which bridges are in its domain."""
        if neighbours.bridges != self.bridges:
            self.bridges = neighbours.bridges
            self._context.announcements.changed()

    def disconnected(self) -> None:
        """The next connection begins with nothing told or known."""
        self.bridges = self._told = ()


class Link(ABC):
    """A peer and its routes. It lives on while the peer is away.

    Attributes:
        transport: what carries the control connection.
        name: the client's name, on both sides.
        is_client: whether this side is the client.
        status: whether it is up, since when, and why not.
        table: the routes.
        proposed: the topics that this side proposes.
        patterns: likewise, those of names, and what the peer follows here.
        topic_lists, type_questions: what the two sides ask each other about graphs and types.
        control: the authenticated connection; None: not linked.
        keys: what the present connection's handshake left; None: not linked.
        connections: how many connections there have been.
        linked_at: s, when the present or last connection was made.
        channels: what carries the routes' messages.
        fullness: whether the link is full.
        contention: divides what the link carries, and `budget` is what the peer may have this side hold and do.
        revisions: numbers the changes made on this side.
        duplicates: further clients of its name, which are refused.
        neighbourhood: the bridges in the ROS domains of both sides.
    """

    def __init__(self, context: Context, name: str, *, is_client: bool, encrypted: bool) -> None:
        self.context = context
        self.transport = context.transports.of_link(context.session.server_ip)
        self.name = name
        self.is_client = is_client
        self.role: Role = "client" if is_client else "server"
        self.control: ControlChannel | None = None
        self.keys: SessionKeys | None = None
        self.peer: Hello | Welcome | None = None
        self.encrypted = encrypted
        self._is_silent = False
        self._shifts_stamps = False
        self.status = LinkStatus(context.wall())
        self.connections = 0
        self.linked_at = 0.0
        self.budget = PeerBudget(context.now())
        self._warned: tuple[LinkCause, float] = (LinkCause.NONE, 0.0)
        self.revisions = Revisions()
        self.duplicates = DuplicateClients(name)
        self.neighbourhood = Neighbourhood(context, self.send)
        self._tasks = Tasks(context.loop, self.fail)
        self.keepalive = Keepalive(context, self.carriers)
        self.table = RouteTable(context, self)
        self.proposed = ProposedTopics(context, self.table, name, self._prefixed, lambda: self.profile)
        self.bench = LinkBench(context, self, self.table, self.proposed, self.carriers)
        self.channels = DataChannels(
            context.loop,
            self._log_udp,
            self.budget.unfinished,
            self.send,
            self._certain_way_back,
            self._shortest_ping,
            self.bench.meter_of,
        )
        self.fullness = LinkFullness(self._log_full)
        self.contention = Contention(context, lambda: tuple(self.routes.values()), self.carriers, self.fullness)
        self.patterns = LinkPatterns(context, self, self.table, self.proposed, self.shows, self._pattern_entry)
        self.topic_lists = TopicLists(context.ros, self.shows, self.send, self.spawn)
        self._early = EarlyReports(context.loop, self.send)
        self.type_questions = TypeQuestions(context.descriptions, self.table.ids.open_route, self.send, self.spawn)
        context.demands.register(self)

    # --- what client and server do differently

    @property
    @abstractmethod
    def address(self) -> str:
        """The peer's address, for people."""

    @property
    @abstractmethod
    def fingerprints(self) -> tuple[str, str]:
        """Of the key in use, or of this side's; and on a server of the next one. Empty: there is none."""

    @abstractmethod
    def shared_port(self) -> int:
        """The port or channel of the link itself."""

    @property
    @abstractmethod
    def use_name(self) -> bool:
        """Whether the server puts the client's name before the names of its topics, as far as is known."""

    def _prefixed(self) -> bool:
        return self.context.session.use_name if self.is_client else self.use_name

    def _pattern_entry(self, topic: Topic) -> PatternEntry:
        theirs = isinstance(self.peer, Welcome) and self.peer.use_name
        return PatternEntry(topic, client=self.name, prefixed=self._prefixed(), always_prefixed=theirs)

    @property
    def shut_down(self) -> bool:
        """Whether the link is down on purpose and waits for this side's operator."""
        return False

    @abstractmethod
    def client_names(self, topic: Topic) -> Topic:
        """A topic as the client sees it, which this side's operator may name as this side does."""

    @property
    def profile(self) -> profiles.LinkProfile:
        """What its network is like, as the session says."""
        return profiles.profile_of(self.context.session.profile)

    @property
    @abstractmethod
    def rights(self) -> Rights:
        """What the peer may do here."""

    def bench_refusal(self, topic: str) -> str:
        return self.bench.refusal(topic, self.rights.bench)

    @abstractmethod
    def with_local_name(self, proposal: Propose) -> Propose:
        """The peer's proposal with this side's name for the topic."""

    @abstractmethod
    def shows(self, topic: str, kind: Kind = "topic") -> bool:
        """Whether the peer may know that a topic, or what else, is in this side's graph. For any thread."""

    @abstractmethod
    async def prepare_port(self, route: Route) -> None:
        """Have the port that a route names ready for the client; ListenError if it cannot be bound."""

    @abstractmethod
    def open_stream(self, route: Route, transport: StreamTransport) -> None:
        """Open the route's stream, or join the one that it shares; a server waits for the client's."""

    @abstractmethod
    def open_udp_channel(self, transport: DatagramTransport, port: int) -> UdpChannel | None:
        """Open datagrams to the peer's port; None: it cannot be done now, or the client's first probe does it."""

    @abstractmethod
    def on_shutdown(self, message: Shutdown) -> None:
        """The peer closes the link on purpose."""

    @abstractmethod
    def on_duplicate(self, message: Duplicate) -> None:
        """The server says whether there is a second client of the name."""

    # --- up and down

    @property
    def linked(self) -> bool:
        """Whether the peer is connected and authenticated."""
        return self.control is not None

    @property
    def down_reason(self) -> str:
        """Why it isn't linked."""
        return "" if self.control else self.status.reason

    @property
    def instance(self) -> str:
        """The peer's process, present or last; empty: there has been none."""
        return self.peer.instance if self.peer is not None else ""

    @property
    def features(self) -> tuple[str, ...]:
        """What the peer, present or last, can do beyond version 2 of the wire format."""
        return self.peer.features if self.peer is not None else ()

    @property
    def sample_secret(self) -> bytes | None:
        """The secret of the sample tags of routes' streams, or None if the peer sends none."""
        if self.keys is None or sealing.FEATURE not in self.features:
            return None
        return self.keys.sample_secret

    @property
    def _peer_role(self) -> str:
        return "the server" if self.is_client else "the client"

    @property
    def peer_at(self) -> str:
        """The peer and where it is, as the log names it."""
        return f"{self._peer_role} at {self.address}"

    @property
    def bridges(self) -> tuple[str, ...]:
        """The names of the bridge nodes in the peer's domain, its own first; empty: not known yet."""
        return self.neighbourhood.bridges

    @property
    def clock_offset(self) -> float | None:
        """s, the peer's clock minus ours."""
        return self.keepalive.clock.offset

    @property
    def clock_uncertainty(self) -> float | None:
        """Seconds by which `clock_offset` may be wrong."""
        return self.keepalive.clock.uncertainty

    @property
    def stamp_offset(self) -> float | None:
        """s, the clock that the peer stamps messages by minus this side's clock of stamps."""
        return self.keepalive.stamps.offset

    @property
    def stamp_uncertainty(self) -> float | None:
        """Seconds by which `stamp_offset` may be wrong."""
        return self.keepalive.stamps.uncertainty

    @property
    def stamp_shift(self) -> int:
        """Nanoseconds to add to a stamp of the wall clock before it is sent."""
        return self.context.stamps.shift if self._shifts_stamps else 0

    def up(self, control: ControlChannel, peer: Hello | Welcome, keys: SessionKeys) -> None:
        """The peer is connected and authenticated."""
        self.control, self.peer, self.keys = control, peer, keys
        self.channels.connected(keys, self.role, receipts=window.FEATURE in peer.features)
        self._is_silent = False
        self._shifts_stamps = MAX_AGE_FEATURE in peer.features
        self.connections += 1
        self.linked_at = self.context.now()
        self.keepalive = self.keepalive.next(self.profile.patience)
        self.keepalive.watch(partial(self._silent, control))
        self.status.up(self.context.wall())
        encryption = f"encrypted with {keys.suite.name}" if self.encrypted else "NOT ENCRYPTED"
        linked = (
            f"linked with {self._peer_role} at {control.stream.peer}, {encryption}, rsb-console {peer.version} there"
        )
        self.log(Level.INFO, EventCode.LINK_UP, linked, link_status=True)
        self.neighbourhood.tell()
        if self._shifts_stamps:
            self.send(self.keepalive.ping())  # the age of messages is unknown until it is answered
        self.table.connected()
        self.patterns.connected()

    def _silent(self, control: ControlChannel) -> None:
        """End a connection over which nothing comes any more."""
        self._is_silent = True
        text = f"the peer is silent: nothing came for {self.keepalive.quiet:.0f} s"
        control.abort(f"{text}: check that it is on, its cable or Wi-Fi, and firewalls")

    def lost(self, reason: str, code: EventCode) -> None:
        """The control connection is over."""
        self.keepalive.stop()
        self.control = self.keys = None
        self._warned = LinkCause.NONE, 0.0
        cause = _CAUSES.get(code, LinkCause.CLOSED)
        if cause is LinkCause.LOST and self.transport.problem:
            cause, reason = LinkCause.ROUTER_LOST, self.transport.problem
        elif cause is LinkCause.LOST and self._is_silent:
            cause = LinkCause.SILENT
        elif cause is LinkCause.LOST and reason == CLOSED_BY_PEER:
            reason = _NO_GOODBYE
        self.status.down(cause, reason)
        self.status.since = self.context.wall()
        self.table.disconnected(reason)
        asked = (self.patterns, self.topic_lists, self.type_questions, self._early)
        for part in (self.neighbourhood, self.channels, *asked, self.bench, self.contention):
            part.disconnected()
        level = Level.INFO if code is EventCode.LINK_CLOSED else Level.WARNING
        how = "lost" if code is EventCode.LINK_LOST else "closed"
        self.log(level, code, f"link with {self.peer_at} {how}: {reason}", link_status=True)

    def destroy(self) -> None:
        """End routes and tasks for good."""
        self._tasks.cancel()
        self.table.destroy()

    def spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        """Run a coroutine beside; it ends with the engine at the latest. If it fails, the connection ends."""
        return self._tasks.spawn(work)

    def guarded(self, work: Callable[[], None]) -> None:
        """Do some of this link's regular work; what fails in it ends this link's connection, not the others'."""
        try:
            work()
        except Exception as error:  # noqa: BLE001 — whatever it is, it is this link's
            self.context.loop.call_exception_handler({"message": f"link {self.name} failed", "exception": error})
            self.fail()

    def fail(self) -> None:
        """Something of this link's own has failed: end its connection, so that both sides begin anew."""
        if self.control is not None:
            self.control.abort("internal error")

    def protocol_error(self, reason: str) -> None:
        """The peer broke the protocol: end the connection."""
        if self.control is not None:
            self.control.abort(f"the peer broke the format: {reason}")

    # --- control messages

    def send(self, message: ControlMessage) -> None:
        """Send a control message; without a connection, nothing happens."""
        if self.control is not None:
            self.control.send(message)

    def message(self, message: ControlMessage | ReportParts | TopicListParts) -> Slices | None:
        """Act on a control message of the peer. Returns the work that is left, or None."""
        match message:
            case Ping():
                self.keepalive.record_ping(message)
                if (pong := self.keepalive.answer(message)) is not None:
                    self.send(pong)
            case Pong():
                self.keepalive.answered(message)
            case ListTopics() | TopicList() | TopicListParts():
                return self.topic_lists.handle(message)
            case Follow() | Followed():
                self.patterns.handle(message)
            case Receipts():
                self.channels.handle_receipts(message, self.table.ids.open_route)
            case Neighbours():
                self.neighbourhood.heard(message)
            case AskType() | TypeText():
                self.type_questions.handle(message)
            case BenchAsk() | BenchAnswer():
                self.bench.handle(message)
            case Report() | ReportParts():
                if message.full is not None:
                    self.fullness.take_record(message.full, self._peer_name)
                    self._judge_again(outgoing=False)
                return take_report(message, self.table.ids.open_route)
            case Duplicate():
                self.on_duplicate(message)
            case Shutdown():
                self.on_shutdown(message)
            case _:
                self.table.handle(message)
        return None

    # --- routes

    @property
    def routes(self) -> dict[str, Route]:
        """The routes, by key."""
        return self.table.routes

    def listed_topics(self) -> tuple[Topic, ...]:
        """What this side proposes, by name and by pattern, as operators have left it. May be called from any thread."""
        return (*self.proposed.all(), *self.patterns.all())

    def add_entry(self, topic: Topic) -> str:
        """Bridge one more topic, or follow one more pattern; its key.

        Raises:
            LinkError: it has a mistake, or is there already.
        """
        return self.patterns.add(topic) if topic.is_pattern else self.proposed.add(topic).key

    def closed(self, route_id: int) -> None:
        """An incarnation of a route is over."""
        self.table.closed(route_id)

    def report_soon(self, route: Route) -> None:
        """Send a route's counts before the next regular report. May be called for every batch."""
        self._early.add(route)

    def open_channel(self, route: Route) -> None:
        """Open what carries a route's messages, or begin to."""
        assert self.control is not None
        assert self.channels.keys is not None
        port, transport = route.proposal.port or self.shared_port(), route.transport
        if self.transport.multiplexed and port == self.shared_port():
            route.channel = self.control.multiplexer.carry(route, self.channels.keys, self.channels.book)
        elif isinstance(transport, StreamTransport):
            self.open_stream(route, transport)
        elif (udp_channel := self.channels.udp.get(port) or self._new_udp_channel(transport, port)) is not None:
            route.channel = datagram_channel(udp_channel, route, self.channels.keys)

    def _new_udp_channel(self, transport: DatagramTransport, port: int) -> UdpChannel | None:
        udp_channel = self.open_udp_channel(transport, port)
        if udp_channel is not None:
            self.channels.udp.open(port, udp_channel)
        return udp_channel

    def udp_ready(self) -> None:
        """A UDP channel has found its path, or can be opened now: the routes that wait for it go on."""
        self.spawn(self.table.advance())

    def join_stream(self, shared: SharedStream, frame: bytes) -> None:
        """The peer wants a further route on a stream; raises ProtocolError or Refusal where that can't be."""
        raise ProtocolError(Broken.PREAMBLE_ON_OPEN_STREAM())

    def is_closed_id(self, route_id: int) -> bool:
        """Whether a route was open under that id, and is not now."""
        return self.table.ids.is_closed(route_id)

    # --- demands to be armed

    def demand_sources(self) -> Iterable[Source]:
        """Yield the entries that demand arming, as operators have left them."""
        use_name = not self.is_client and self.use_name
        return sources_of_entries(self.listed_topics(), self.name, on_server=not self.is_client, use_name=use_name)

    def apply_demands(self) -> None:
        """Reopen the routes whose demands have changed."""
        self.table.apply_demands()

    def demand_dropped(self, source: Source) -> None:
        """Tell the other side that an operator drops a demand."""
        self.table.arming.demand_dropped(source)

    # --- time

    def tick(self) -> None:
        """Once a second, after the routes' own tick: keepalive, reports, retries."""
        self.patterns.tick()
        if self.control is None:
            return
        measures = self.bench.is_measuring
        out = self.full_out
        self.contention.tick(self.keepalive, self.features, self.connections, self._peer_name, measures=measures)
        if self.full_out != out:
            self._judge_again(outgoing=True)
        self.warning_since()  # notice the beginning even if nobody looks
        self.send(self.keepalive.tick())
        self.channels.tick(self.routes.values())
        for report in reports(self.routes.values(), self.fullness.next_record()):
            self.send(report)
        self.table.tick()
        self.bench.tick()

    def _judge_again(self, *, outgoing: bool) -> None:
        """Judge the routes of one direction again: their link has become full or has room, so that both agree."""
        for route in self.routes.values():
            if route.outgoing == outgoing:
                route.judge_again()

    def carriers(self) -> set[Carrier]:
        """All that carries bytes of the present connection."""
        return self.channels.carriers(self.routes.values(), self.control)

    def snapshot(self) -> LinkSnapshot:
        """The link as it is now."""
        now = self.context.now()
        keepalive, keys, peer = self.keepalive, self.keys, self.peer
        clock = keepalive.clock if self.linked else ClockOffset()  # what a dead connection measured holds no more
        return LinkSnapshot(
            name=self.name,
            peer=self.address,
            state=self.status.state,
            reason=self.down_reason,
            since=self.status.since,
            retry_in=self.status.retry_in(now),
            attempts=self.status.attempts,
            encrypted=self.encrypted,
            cipher=keys.suite.name if keys and self.encrypted else "",
            fingerprint=self.fingerprints[0],
            next_fingerprint=self.fingerprints[1],
            rtt=clock.rtt,
            clock_offset=clock.offset,
            clock_uncertainty=clock.uncertainty,
            rx_bytes_per_second=keepalive.rx_rate if self.linked else 0.0,
            tx_bytes_per_second=keepalive.tx_rate if self.linked else 0.0,
            rx_bytes_total=keepalive.rx_bytes,
            tx_bytes_total=keepalive.tx_bytes,
            peer_version=peer.version if peer else "",
            peer_domain=peer.domain_id if peer else None,
            use_name=self.use_name,
            cause=self.cause,
            warning=self.warning,
            warning_since=self.warning_since(),
            capacity_out=self.contention.sending.capacity,
            capacity_in=self.contention.receiving.capacity,
            full_out=self.full_out,
            full_in=self.full_in,
            patterns=tuple(self.patterns.snapshots()),
        )

    @property
    def warning(self) -> str:
        """What is wrong though the link is up, for an operator; or empty."""
        if not self.linked:
            return ""
        taken = self.duplicates.warning(self.context.now(), self.context.wall())
        return "; ".join(filter(None, (taken, self.fullness.warning(self._peer_name), self.unproven)))

    @property
    def unproven(self) -> str:
        """The warning that announced servers did not prove the key, or an empty string."""
        return ""

    def warning_since(self) -> float | None:
        """Return s since the epoch, when the present warning began, or None without one. Called once a second."""
        cause = self.cause if self.warning else LinkCause.NONE
        if cause != self._warned[0]:
            self._warned = cause, self.context.wall()
        return self._warned[1] if cause else None

    @property
    def cause(self) -> LinkCause:
        """Cause of its fault, up or down."""
        if not self.linked:
            return self.status.cause
        if self.duplicates.warning(self.context.now(), self.context.wall()):
            return LinkCause.NAME_TAKEN
        if self.fullness.out is not None or self.fullness.into is not None:
            return LinkCause.FULL
        return LinkCause.UNPROVEN_SERVERS if self.unproven else self.status.cause

    @property
    def full_out(self) -> Fullness | None:
        """The rates from here, or None if the link is not full."""
        return self.fullness.out

    @property
    def fullness_undecided(self) -> bool:
        """Whether the link from here may be full, which is being measured."""
        return self.fullness.undecided

    @property
    def full_in(self) -> Fullness | None:
        """The rates to here, or None if the link is not full."""
        return self.fullness.into

    @property
    def report_delay(self) -> float:
        """About how many s the peer's reports take to get here."""
        return self.keepalive.ping_delay

    def _certain_way_back(self) -> float:
        return max(0.0, self.report_delay - (self.clock_uncertainty or 0.0))

    def _shortest_ping(self) -> float:
        return 2 * (self.clock_uncertainty or 0.0)

    @property
    def ping_wait(self) -> float:
        """Seconds that the oldest unanswered ping has waited; 0 if all are answered."""
        return self.keepalive.ping_wait

    @property
    def _peer_name(self) -> str:
        return "the server" if self.is_client else self.name

    def _log_full(self, level: Level, code: EventCode, text: str) -> None:
        self.log(level, code, text, link_status=True)

    def _log_udp(self, level: Level, code: EventCode, text: str) -> None:
        self.log(level, code, f"{self.peer_at}: {text}")

    def log(self, level: Level, code: EventCode, text: str, *, topic: str = "", link_status: bool = False) -> None:
        """Add an event about this link; `link_status`: it says whether the link is up."""
        about: About = {"link": self.name, "topic": topic}
        if link_status:
            about |= {"state": self.status.state, "since": self.status.since, "cause": self.cause}
        self.context.log(level, code, text, link_status=link_status, **about)

"""The connection to one peer: it comes and goes, and the link's routes and features live on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from rsb_bridge.channel.datagram_channel import DatagramSender, datagram_channel
from rsb_bridge.link.contention import Contention, LinkFullness
from rsb_bridge.link.data_channels import DataChannels
from rsb_bridge.link.extension import Extension
from rsb_bridge.link.keepalive import Keepalive
from rsb_bridge.link.path_watch import STALLED, PathWatch, Pings
from rsb_bridge.link.refused_clients import DuplicateClients
from rsb_bridge.model import profiles
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.verdict import LinkCause, clocks_differ
from rsb_bridge.route.lifecycle import Revisions
from rsb_bridge.route.peer import PeerBudget
from rsb_bridge.tasks import Tasks, in_slices
from rsb_bridge.transport.streams import CLOSED_BY_PEER, Stream
from rsb_bridge.transport.transport import StreamTransport
from rsb_bridge.wire.codec import decode_urgent, encode
from rsb_bridge.wire.messages import Ping, Pong, Receipts
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Coroutine, Iterator

    from rsb_bridge.channel.channel import ChannelCarrier
    from rsb_bridge.channel.data_keys import Meter
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.config.rights import Rights
    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import ControlChannel, Slices
    from rsb_bridge.model.capacity import Fullness
    from rsb_bridge.model.path_fault import PathFault
    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.model.session import Kind
    from rsb_bridge.route.route import Route
    from rsb_bridge.telemetry.event_log import About
    from rsb_bridge.transport.transport import DatagramTransport
    from rsb_bridge.wire.messages import ControlMessage, Hello, Propose, UrgentMessage, Welcome
    from rsb_bridge.wire.records import PathRecord
    from rsb_bridge.wire.sealing import Role, SessionKeys

_E = TypeVar("_E", bound=Extension)

_CLOSED_REMEMBERED = 4
"""Closed ids that are remembered of each route: the peer's messages about one may come while the next ones come and
go."""


class RouteIds:
    """The ids of a link's open routes on the present connection, and of routes that were closed lately.

    Each opening of a route has its own id, and none is used twice. A client gives odd ids, a server even ones.
    """

    def __init__(self, *, is_client: bool) -> None:
        self._is_client = is_client
        self._by_id: dict[int, Route] = {}
        self._closed: dict[int, Route] = {}  # by the ids of their last openings
        # Ids count on across connections, so that late messages from a closed connection match no route.
        self._next = 1 if is_client else 2
        self._newest_of_peer = 0

    def disconnected(self) -> None:
        """Forget all ids: messages of a closed connection cannot come late."""
        for route in self._closed.values():
            route.closed_ids.clear()
        self._by_id.clear()
        self._closed.clear()
        self._newest_of_peer = 0

    def new(self) -> int:
        """Return an id for a route that this side opens."""
        self._next += 2
        return self._next - 2

    def take_of_peer(self, route_id: int) -> bool:
        """Record an id that the peer gives; return False unless it is the peer's to give and newer than the last."""
        if route_id % 2 == self._is_client or route_id <= self._newest_of_peer:
            return False
        self._newest_of_peer = route_id
        return True

    def opened(self, route: Route, route_id: int) -> None:
        """Record that a route is open under an id."""
        self._by_id[route_id] = route

    def closed(self, route_id: int) -> None:
        """Record that an opening of a route is over."""
        route = self._by_id.pop(route_id, None)
        if route is not None:
            self._closed[route_id] = route
            route.closed_ids.append(route_id)
            if len(route.closed_ids) > _CLOSED_REMEMBERED:
                del self._closed[route.closed_ids.popleft()]

    def forget(self, route: Route) -> None:
        """Forget the closed ids of a route that is removed."""
        for route_id in route.closed_ids:
            del self._closed[route_id]

    def open_route(self, route_id: int) -> Route | None:
        """Return the open route with an id, or None."""
        return self._by_id.get(route_id)

    def open_routes(self) -> tuple[Route, ...]:
        """Return all open routes."""
        return tuple(self._by_id.values())

    def find(self, route_id: int) -> Route | None:
        """Return the route that is open under an id, or was lately, or None."""
        return self._by_id.get(route_id) or self._closed.get(route_id)

    def last_of(self, route: Route) -> int:
        """Return the id of a route's last opening on this connection, or 0 without one."""
        return route.id or next(reversed(route.closed_ids), 0)

    def awaits_channel(self, route_id: int) -> bool:
        """Whether a route is open under an id, and has no channel yet."""
        route = self._by_id.get(route_id)
        return route is not None and route.channel is None

    def is_closed_id(self, route_id: int) -> bool:
        """Whether a route was open under an id and is closed: what still arrives for it is late, not wrong."""
        ours = route_id % 2 == self._is_client
        newest = self._next - 2 if ours else self._newest_of_peer
        return 0 < route_id <= newest and route_id not in self._by_id


_NOT_YET = "not connected yet"
_NO_GOODBYE = "the other side closed the connection without a goodbye: check whether its process or machine has died"
_CAUSES = {EventCode.LINK_LOST: LinkCause.LOST, EventCode.LINK_SHUT_DOWN: LinkCause.SHUT_DOWN}
"""Causes by the code of a connection's end; with any other code, `LinkCause.CLOSED`."""


@dataclass(slots=True)
class LinkStatus:
    """Whether a link is up, since when, and why not.

    Attributes:
        since: time of the last change, in s since the epoch.
        cause: cause of its being down, or `LinkCause.NONE`.
        reason: the same in words, for an operator.
        attempts: failed attempts to connect since it was last up.
        retry_at: time of the next attempt in s, or None if none is planned.
    """

    since: float
    cause: LinkCause = LinkCause.NOT_YET
    reason: str = _NOT_YET
    attempts: int = 0
    retry_at: float | None = None

    def up(self, wall: float) -> None:
        """Record that the link is up since `wall`, in s since the epoch."""
        self.since, self.cause = wall, LinkCause.NONE
        self.attempts, self.retry_at = 0, None

    def down(self, cause: LinkCause, reason: str) -> None:
        """Record why the link is down."""
        self.cause, self.reason = cause, reason

    def retry_in(self, now: float) -> float | None:
        """Return the seconds from `now` to the next attempt, or None if none is planned."""
        return None if self.retry_at is None else max(0.0, self.retry_at - now)

    @property
    def state(self) -> State:
        """WAITING until the first attempt has ended, then OK or DOWN."""
        if self.cause is LinkCause.NONE:
            return State.OK
        return State.WAITING if self.cause is LinkCause.NOT_YET else State.DOWN


class BaseLink(ABC):
    """The connection to a peer with the routes that use it, and the features that have registered.

    Attributes:
        transport: transport of the control connection.
        name: name of the client, on both sides.
        is_client: whether this side is the client.
        status: whether it is up, since when, and why not.
        routes: the routes, by key.
        ids: ids of the routes' openings.
        handlers: handlers of control messages, by type.
        control: the authenticated connection, or None without a link.
        keys: keys of the present connection, or None without a link.
        peer: `Hello` or `Welcome` of the present or last peer, or None before the first connection.
        peer_name: name of the peer, for operators.
        instance: process of the present or last peer, or an empty string before the first connection.
        clock: offset of the peer's clock, on the present or last connection.
        stamps: offset of the clock by which the peer stamps messages.
        connections: number of connections so far.
        linked_at: time of the present or last connection, in s.
        bridges: names of the bridge nodes in the peer's domain, its own first; empty as long as they are unknown.
        channels: channels of the routes.
        fullness: whether the link is full.
        contention: divides the link among the routes.
        path: what the path of the present connection loses.
        budget: limits on what the peer may have this side hold and do.
        revisions: numbers the changes made on this side.
        duplicates: refused clients that have the link's name, too.
        report_soon: sends a route's counts before the next regular report. May be called for every batch.
        closed: records that an opening of a route is over.
    """

    report_soon: Callable[[Route], None]

    def __init__(self, context: Context, name: str, *, is_client: bool, encrypted: bool) -> None:
        self.context = context
        self.transport = context.transports.of_link(context.session.server_ip)
        self.name = name
        self.is_client = is_client
        self.role: Role = "client" if is_client else "server"
        self.peer_name = "the server" if is_client else name
        self._peer_role = "the server" if is_client else "the client"
        self.control: ControlChannel | None = None
        self.keys: SessionKeys | None = None
        self.peer: Hello | Welcome | None = None
        self.instance = ""
        self.encrypted = encrypted
        self._is_silent = False
        self._warned: tuple[LinkCause, float] = (LinkCause.NONE, 0.0)
        self.status = LinkStatus(context.wall())
        self.connections = 0
        self.linked_at = 0.0
        self.bridges: tuple[str, ...] = ()
        self.routes: dict[str, Route] = {}
        self.ids = RouteIds(is_client=is_client)
        self.budget = PeerBudget(context.now())
        self.revisions = Revisions()
        self.duplicates = DuplicateClients(name)
        self._tasks = Tasks(context.loop, self.fail)
        self.keepalive = Keepalive(context, self.carriers)
        self.clock, self.stamps = self.keepalive.clock, self.keepalive.stamps
        self.channels = DataChannels(
            context.loop,
            self._log_udp,
            self.budget.unfinished,
            self.send,
            lambda: max(0.0, self.report_delay - (self.clock.uncertainty or 0.0)),
            lambda: 2 * (self.clock.uncertainty or 0.0),
            self._meter_of,
            self.ids,
            self._take_urgent,
        )
        self._awaiting: dict[tuple[str, int], dict[int, Route]] = {}  # routes without streams, by transport and port
        self.fullness = LinkFullness(partial(self.log, link_status=True))
        self.contention = Contention(context, lambda: tuple(self.routes.values()), self.carriers, self.fullness)
        self.path = PathWatch(self._log_path)
        self.handlers: dict[type, Callable[[Any], Slices | None]] = {
            Ping: self._on_ping,
            Pong: self._on_pong,
            Receipts: self.channels.handle_receipts,
        }
        self._extensions: list[Extension] = []

    # --- extensions

    def extend(self, extension: _E) -> _E:
        """Register a feature of this link, and return it."""
        self._extensions.append(extension)
        self.handlers |= extension.messages
        return extension

    def refusal(self, name: str, purpose: Purpose) -> str:
        """Return why the peer may not have an internal route by that name now, or an empty string."""
        return next((each.refusal(name) for each in self._extensions if each.purpose is purpose), "")

    def _meter_of(self, route_id: int) -> Meter | None:
        meters = (each.meter_of(route_id) for each in self._extensions)
        return next((each for each in meters if each is not None), None)

    # --- differences of client and server

    @property
    @abstractmethod
    def address(self) -> str:
        """The peer's address, for operators."""

    @abstractmethod
    def shared_port(self) -> int:
        """Return the port or channel of the link itself."""

    @property
    @abstractmethod
    def use_name(self) -> bool:
        """Whether the server prefixes topics with the client's name, as far as this side knows."""

    @property
    def prefixed(self) -> bool:
        """Whether this side's own session has the server prefix topics with the client's name."""
        return self.context.session.use_name if self.is_client else self.use_name

    @property
    def profile(self) -> profiles.LinkProfile:
        """The session's profile of the link's network."""
        return profiles.profile_of(self.context.session.profile)

    @property
    @abstractmethod
    def rights(self) -> Rights:
        """The peer's rights on this side."""

    @abstractmethod
    def with_local_name(self, proposal: Propose) -> Propose:
        """Return the peer's proposal with this side's name for the topic."""

    @abstractmethod
    def shows(self, topic: str, kind: Kind = "topic") -> bool:
        """Whether the peer may know that this side's graph has a topic, or a service. May be called from any thread."""

    @abstractmethod
    async def prepare_port(self, route: Route) -> None:
        """Prepare the port that a route names for the client.

        Raises:
            ListenError: it cannot be bound.
        """

    @abstractmethod
    def open_streams(self, transport: StreamTransport, port: int) -> None:
        """Open the streams for routes with that port; a server waits for the client's."""

    @abstractmethod
    def open_udp_channel(self, transport: DatagramTransport, port: int) -> UdpChannel | None:
        """Open datagrams to the peer's port. Return None on failure, and on a server: there, a probe opens them."""

    def derive_keys(self, route_id: int, *, proposed_here: bool) -> None:
        """Derive the keys of a route. Call it once for each proposal, in the order in which they cross."""
        if self.keys is not None:
            self.keys.proposed(route_id, "client" if self.is_client is proposed_here else "server")

    def closed(self, route_id: int) -> None:
        """Record that an opening of a route is over."""
        self.ids.closed(route_id)
        if self.keys is not None:
            self.keys.closed(route_id)

    # --- up and down

    @property
    def linked(self) -> bool:
        """Whether the peer is connected and authenticated."""
        return self.control is not None

    @property
    def down_reason(self) -> str:
        """The reason why it is not linked, for an operator, or an empty string."""
        return "" if self.control else self.status.reason

    @property
    def sample_secret(self) -> bytes | None:
        """The secret of the sample tags of data streams, or None without a link or encryption."""
        return None if self.keys is None else self.keys.sample_secret

    @property
    def peer_at(self) -> str:
        """The peer with its address, as the log names it."""
        return f"{self._peer_role} at {self.address}"

    def up(self, control: ControlChannel, peer: Hello | Welcome, keys: SessionKeys) -> None:
        """Begin a connection: the peer is authenticated."""
        self.control, self.peer, self.keys = control, peer, keys
        self.instance = peer.instance
        self.channels.connected(keys, self.role, self.transport.ages)
        if self.transport.multiplexed:
            control.data = self.channels.use_control(control.stream, self.transport.name, self.shared_port())
        self._is_silent = False
        self.connections += 1
        self.linked_at = self.context.now()
        self.keepalive = self.keepalive.next(self.profile.patience)
        self.clock, self.stamps = self.keepalive.clock, self.keepalive.stamps
        self.keepalive.watch(partial(self._silent, control))
        self.status.up(self.context.wall())
        encryption = f"encrypted with {keys.suite.name}" if self.encrypted else "NOT ENCRYPTED"
        linked = (
            f"linked with {self._peer_role} at {control.stream.peer}, {encryption}, rsb-console {peer.version} there"
        )
        self.log(Level.INFO, EventCode.LINK_UP, linked, link_status=True)
        self.send(self.keepalive.ping())  # the age of messages is unknown until it is answered
        for each in self._extensions:
            each.connected()

    def _silent(self, control: ControlChannel) -> None:
        self._is_silent = True
        text = f"the peer is silent: nothing came for {self.keepalive.quiet:.0f} s"
        control.abort(f"{text}: check that it is on, its cable or Wi-Fi, and firewalls")

    def lost(self, reason: str, code: EventCode) -> None:
        """End the connection.

        Args:
            reason: why it is over, for an operator.
        """
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
        for each in reversed(self._extensions):
            each.disconnected()
        self._awaiting.clear()
        self.channels.disconnected()
        self.contention.disconnected()
        self.path.disconnected()
        level = Level.INFO if code is EventCode.LINK_CLOSED else Level.WARNING
        how = "lost" if code is EventCode.LINK_LOST else "closed"
        self.log(level, code, f"link with {self.peer_at} {how}: {reason}", link_status=True)

    def destroy(self) -> None:
        """End routes and tasks for good."""
        self._tasks.cancel()
        self.destroy_routes()

    def destroy_routes(self) -> None:
        """End all routes for good."""
        for route in self.routes.values():
            route.destroy()
        self.routes.clear()

    def spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        """Run a coroutine in a task that ends with the link. If it fails, the connection ends."""
        return self._tasks.spawn(work)

    def guarded(self, work: Callable[[], None]) -> None:
        """Do regular work of this link. If it fails, this link's connection ends, and no other."""
        try:
            work()
        except Exception as error:  # noqa: BLE001 -- any failure is this link's own
            self.context.loop.call_exception_handler({"message": f"link {self.name} failed", "exception": error})
            self.fail()

    def fail(self) -> None:
        """End the connection after an internal error, so that both sides start from the beginning."""
        if self.control is not None:
            self.control.abort("internal error")

    def protocol_error(self, reason: str) -> None:
        """End the connection: the peer broke the protocol."""
        if self.control is not None:
            self.control.abort(f"the peer broke the format: {reason}")

    # --- control messages

    def send(self, message: ControlMessage) -> None:
        """Send a control message; without a connection, nothing happens."""
        if self.control is not None:
            self.control.send(message)

    def send_urgent(self, message: UrgentMessage) -> None:
        """Send a control message, and over the UDP channels besides: there it does not wait for what a stream lost."""
        self.send(message)
        if self.control is not None:
            self.channels.udp.send_urgent(encode(message))

    def _take_urgent(self, content: bytes) -> None:
        """Take a control message that came as a datagram."""
        if self.control is None:
            return
        try:
            message = decode_urgent(content)
        except ProtocolError as error:
            self.protocol_error(str(error))
        else:
            self.control.take_urgent(message)

    def _on_ping(self, ping: Ping) -> None:
        self.keepalive.record_ping(ping)
        if (pong := self.keepalive.answer(ping)) is not None:
            self.send(pong)

    def _on_pong(self, pong: Pong) -> None:
        self.keepalive.answered(pong)

    # --- routes

    def open_channel(self, route: Route) -> None:
        """Open the channel of a route, or begin to."""
        assert self.control is not None
        assert self.channels.keys is not None
        port, transport = route.proposal.port or self.shared_port(), route.transport
        if isinstance(transport, StreamTransport):
            self._use_streams(route, transport, port)
        elif (udp_channel := self.channels.udp.get(port) or self._new_udp_channel(transport, port)) is not None:
            assert self.channels.scheduler is not None
            route.channel = datagram_channel(udp_channel, route, self.channels.keys, self.channels.scheduler)

    def _use_streams(self, route: Route, transport: StreamTransport, port: int) -> None:
        pair = self.channels.pair_of(transport.name, port)
        if pair is not None:
            self.channels.carry(route, pair)
            return
        self._awaiting.setdefault((transport.name, port), {})[route.id] = route
        self.open_streams(transport, port)

    def streams_opened(self, transport: str, port: int) -> None:
        """Open the channels of the routes that wait for streams, if these are complete."""
        pair = self.channels.pair_of(transport, port)
        if pair is None:
            return
        for route in self._take_awaiting(transport, port):
            self.channels.carry(route, pair)
            route.advance()

    def streams_failed(self, transport: str, port: int, reason: str) -> None:
        """Report to the routes that wait for streams that these cannot be opened."""
        for route in self._take_awaiting(transport, port):
            route.channel_lost(reason)

    def _take_awaiting(self, transport: str, port: int) -> Iterator[Route]:
        """Yield the routes that wait for streams, and for which nothing else has come first; none of them waits on."""
        for route_id, route in self._awaiting.pop((transport, port), {}).items():
            if route.id == route_id and route.channel is None:  # else it was closed meanwhile
                yield route

    def _new_udp_channel(self, transport: DatagramTransport, port: int) -> UdpChannel | None:
        udp_channel = self.open_udp_channel(transport, port)
        if udp_channel is not None:
            self.channels.udp.open(port, udp_channel)
        return udp_channel

    def udp_ready(self) -> None:
        """Advance the routes that wait for a UDP channel: one has found its path, or can be opened now."""
        self.spawn(self._advance())

    async def _advance(self) -> None:
        def advance(route: Route) -> None:
            if route.id:  # a slice before this one may have closed it
                route.advance()

        await in_slices(self.ids.open_routes(), advance)

    # --- time and figures

    def tick(self) -> None:
        """Do the regular work once a second, after the routes' own tick."""
        if self.control is not None:
            self._tick_path(self.control)
            self.contention.tick(self.keepalive, self.peer_name, lossy=self.path.lossy_out)
            self.warning_since()  # a warning begins now, even if no console asks for a snapshot
            self.send(self.keepalive.tick())
            self.channels.tick()
        for each in self._extensions:
            each.tick()

    def _tick_path(self, control: ControlChannel) -> None:
        counts = {each: each.packets() for each in self.carriers() if isinstance(each, Stream)}
        before = self.path.fault
        stalled = self.path.tick(
            control.stream,
            {stream: packets for stream, packets in counts.items() if packets is not None},
            [route.channel for route in self.routes.values() if isinstance(route.channel, DatagramSender)],
            Pings(self.keepalive.round_trip, self.keepalive.answers, self.keepalive.quiet),
            self.peer_name,
            self.context.now(),
            large_vanish=any(route.large_vanish for route in self.routes.values()),
        )
        for stream in stalled:
            stream.abort(STALLED)
        self._judge_again_after(before)

    def take_path_record(self, record: PathRecord) -> None:
        """Take the peer's record of what the path to here loses."""
        before = self.path.fault
        self.path.take_record(record, self.peer_name)
        self._judge_again_after(before)

    def _judge_again_after(self, before: PathFault | None) -> None:
        """Judge the routes again if the fault of the path has changed, so that their verdicts agree with the link's."""
        if self.path.fault != before:
            for route in self.routes.values():
                route.judge_again()

    @property
    def path_fault(self) -> PathFault | None:
        """The fault of the path while the link is up, or None."""
        return self.path.fault

    def carriers(self) -> set[ChannelCarrier]:
        """Return all carriers of the present connection's bytes."""
        return self.channels.carriers(self.control)

    @property
    def warning(self) -> str:
        """The fault of a link that is up, for an operator, or an empty string."""
        if not self.linked:
            return ""
        taken = self.duplicates.warning(self.context.now(), self.context.wall())
        # A path that loses packets carries less, too: its loss explains that.
        path = self.path.fault
        narrow = path.text if path is not None else self.fullness.warning(self.peer_name)
        return "; ".join(filter(None, (taken, narrow, self.unproven, self.clocks_differ)))

    def warning_since(self) -> float | None:
        """Return when the present warning began, in s since the epoch, or None without one. Called once a second."""
        cause = self.cause if self.warning else LinkCause.NONE
        if cause != self._warned[0]:
            self._warned = cause, self.context.wall()
        return self._warned[1] if cause else None

    @property
    def unproven(self) -> str:
        """The warning that announced servers did not prove the key, or an empty string."""
        return ""

    @property
    def cause(self) -> LinkCause:
        """The cause of the link's fault, up or down."""
        if not self.linked:
            return self.status.cause
        if self.duplicates.warning(self.context.now(), self.context.wall()):
            return LinkCause.NAME_TAKEN
        if self.path.fault is not None:
            return self.path.fault.cause
        if self.fullness.out is not None or self.fullness.into is not None:
            return LinkCause.FULL
        if self.unproven:
            return LinkCause.UNPROVEN_SERVERS
        return LinkCause.CLOCKS_DIFFER if self.clocks_differ else self.status.cause

    @property
    def clocks_differ(self) -> str:
        """The warning that the clocks of the two sides differ, or an empty string."""
        return clocks_differ(self.peer_name, self.clock.offset, self.clock.uncertainty)

    @property
    def full_out(self) -> Fullness | None:
        """The rates from here, or None if the link is not full."""
        return self.fullness.out

    @property
    def fullness_undecided(self) -> bool:
        """Whether the link from here may be full, and is still being measured."""
        return self.fullness.undecided

    @property
    def full_in(self) -> Fullness | None:
        """The rates to here, or None if the link is not full."""
        return self.fullness.into

    @property
    def report_delay(self) -> float:
        """About how many seconds the peer's reports take to arrive."""
        return self.keepalive.ping_delay

    @property
    def ping_wait(self) -> float:
        """Seconds that the oldest unanswered ping has waited; 0 if all are answered."""
        return self.keepalive.ping_wait

    def _log_udp(self, level: Level, code: EventCode, text: str) -> None:
        self.log(level, code, f"{self.peer_at}: {text}")

    def _log_path(self, level: Level, code: EventCode, text: str) -> None:
        self.log(level, code, f"{self.peer_at}: {text}", link_status=True)

    def log(self, level: Level, code: EventCode, text: str, *, topic: str = "", link_status: bool = False) -> None:
        """Add an event about this link; `link_status` means that it tells whether the link is up."""
        about: About = {"link": self.name, "topic": topic}
        if link_status:
            about |= {"state": self.status.state, "since": self.status.since, "cause": self.cause}
        self.context.log(level, code, text, link_status=link_status, **about)

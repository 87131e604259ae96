"""One peer: its control connection, its routes, its keepalive. `client` and `server` add who calls whom."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.datagram import datagram_channel
from rsb_bridge.channel.path_probe import PathProbe
from rsb_bridge.channel.shared_stream import SharedStream
from rsb_bridge.channel.stream import stream_channel
from rsb_bridge.config.validation import validate_topic
from rsb_bridge.link.keepalive import Keepalive
from rsb_bridge.link.negotiation import LinkError, Negotiation
from rsb_bridge.link.proposals import proposal_of
from rsb_bridge.link.side import Side
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, LinkSnapshot, State
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.token_bucket import TokenBucket
from rsb_bridge.route.incoming import EXPANSION_A_SECOND, EXPANSION_AT_ONCE, IncomingRoute
from rsb_bridge.route.latched import LATCHED_LIMIT
from rsb_bridge.route.outgoing import OutgoingRoute
from rsb_bridge.route.pause import Revisions
from rsb_bridge.route.route import Route, route_key
from rsb_bridge.tasks import Tasks, in_slices
from rsb_bridge.telemetry.meters import ClockOffset
from rsb_bridge.transport.transport import ListenError, StreamTransport
from rsb_bridge.wire.budget import Budget
from rsb_bridge.wire.framing import UNFINISHED_LIMIT, ProtocolError
from rsb_bridge.wire.messages import Close, Pause, Report

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Coroutine

    from rsb_bridge.channel.channel import Carrier
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.model.session import Topic
    from rsb_bridge.transport.streams import Stream, StreamHandler
    from rsb_bridge.transport.transport import Transport
    from rsb_bridge.wire.messages import ControlMessage, Hello, Propose, Welcome
    from rsb_bridge.wire.sealing import Role, SessionKeys

_NOT_YET = "not connected yet"
_PROBE_EVERY, _QUICK_PROBES = 0.25, 8


class Link(Side):
    """A peer and its routes. It lives on while the peer is away.

    Attributes:
        transport: what carries the control connection.
        name: the client's name, on both sides.
        is_client: whether this side is the client.
        routes: by key.
        control: the authenticated connection; None: not linked.
        keys: what the present connection's handshake left; None: not linked.
        data_keys: what seals and opens routes' messages on it; None: not linked.
        shared_streams: multiplexed streams beside the control connection, by transport and channel.
        unfinished: what the peer may have this side hold of messages that are not whole yet.
        latched: likewise for late joiners.
        expansion: bytes by which its compressed messages may grow here.
        revisions: numbers the changes made on this side.
    """

    def __init__(self, context: Context, name: str, *, is_client: bool, fingerprint: str, encrypted: bool) -> None:
        self.context = context
        self.transport = context.transports.of_link(context.session.server_ip)
        self.name = name
        self.is_client = is_client
        self.side: Role = "client" if is_client else "server"
        self.routes: dict[str, Route] = {}
        self.control: ControlChannel | None = None
        self.keys: SessionKeys | None = None
        self.peer: Hello | Welcome | None = None
        self.fingerprint = fingerprint
        self.encrypted = encrypted
        self.reason = _NOT_YET
        self.retry_at: float | None = None
        self.attempts = 0
        self.data_keys: DataKeys | None = None
        self.path_probe: PathProbe | None = None
        self.shared_streams: dict[tuple[str, int], SharedStream] = {}
        self.udp_channels: dict[int, UdpChannel] = {}
        self.unfinished = Budget(UNFINISHED_LIMIT)
        self.latched = Budget(LATCHED_LIMIT)
        self.expansion = TokenBucket(EXPANSION_AT_ONCE, EXPANSION_A_SECOND, context.now())
        self.revisions = Revisions()
        self._by_id: dict[int, Route] = {}
        self._next_id = 1 if is_client else 2  # counts on across connections: what is late on a dead one finds no route
        self._since = self.context.wall()
        self._linked_at = 0.0
        self.keepalive = Keepalive(context, self._carriers)
        self.negotiation = Negotiation(self)
        self._tasks = Tasks(context.loop, self.fail)

    # --- up and down

    @property
    def linked(self) -> bool:
        """Whether the peer is connected and authenticated."""
        return self.control is not None

    @property
    def down_reason(self) -> str:
        """Why it isn't linked."""
        return "" if self.control else self.reason

    def is_at(self, node: str) -> bool:
        """Whether a ROS node of this domain, by its name, is the peer's own."""
        return self.peer is not None and node.endswith(f"_{self.peer.instance}")

    @property
    def instance(self) -> str:
        """The peer's process, present or last; empty: there has been none."""
        return self.peer.instance if self.peer is not None else ""

    @property
    def clock_offset(self) -> float | None:
        """s, the peer's clock minus ours."""
        return self.keepalive.clock.offset

    @property
    def clock_uncertainty(self) -> float | None:
        """Seconds by which `clock_offset` may be wrong."""
        return self.keepalive.clock.uncertainty

    def up(self, control: ControlChannel, peer: Hello | Welcome, keys: SessionKeys) -> None:
        """The peer is connected and authenticated."""
        self.control, self.peer, self.keys = control, peer, keys
        self.data_keys = DataKeys(keys, self.side, self.unfinished)
        self.path_probe = PathProbe(self.data_keys)
        self._linked_at = self.context.now()
        self.keepalive = Keepalive(self.context, self._carriers)
        self.keepalive.watch(partial(control.abort, "the peer is silent"))
        self._since = self.context.wall()
        self.attempts = 0
        self.retry_at = None
        words = f"encrypted with {keys.suite.name}" if self.encrypted else "NOT ENCRYPTED"
        linked = f"linked with {control.stream.peer}, {words}, rsb-console {peer.version} there"
        self.log(Level.INFO, EventCode.LINK_UP, linked, link_status=True)
        for route in tuple(self.routes.values()):
            if route.proposed_here:
                self.propose(route)

    def down(self, reason: str, code: EventCode = EventCode.LINK_LOST) -> None:
        """The connection is over."""
        if self.control is None:
            return
        self.keepalive.stop()
        self.control = self.keys = self.data_keys = self.path_probe = None
        self.reason = reason
        self._since = self.context.wall()
        self._by_id.clear()
        for route in self.routes.values():
            route.close(reason)
        for udp_channel in self.udp_channels.values():
            udp_channel.close()
        self.udp_channels.clear()
        self.shared_streams.clear()
        self.negotiation.end()
        level = Level.INFO if code in (EventCode.LINK_CLOSED, EventCode.LINK_REPLACED) else Level.WARNING
        how = "lost" if code is EventCode.LINK_LOST else "closed"
        self.log(level, code, f"link {how}: {reason}", link_status=True)

    def destroy(self) -> None:
        """End routes and tasks for good."""
        self._tasks.cancel()
        for route in self.routes.values():
            route.destroy()
        self.routes.clear()

    def spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        """Run a coroutine beside; it ends with the engine at the latest. If it fails, the connection ends."""
        return self._tasks.spawn(work)

    def fail(self) -> None:
        """Something of this link's own has failed: end its connection, so that both sides begin anew."""
        if self.control is not None:
            self.control.abort("internal error")

    def send(self, message: ControlMessage) -> None:
        """Send a control message; without a connection, nothing happens."""
        if self.control is not None:
            self.control.send(message)

    # --- routes

    def transport_of(self, topic: Topic) -> Transport:
        """What carries a topic's messages; the link's own transport unless the topic names another."""
        return self.context.transports[topic.protocol] if topic.protocol else self.transport

    def add_topic(self, topic: Topic) -> Route:
        """Bridge one more topic, which this side proposes.

        Raises:
            LinkError: the topic has a mistake, or there is such a route.
        """
        session = self.context.session
        use_name = session.use_name if self.is_client else self.use_name
        for problem in validate_topic(topic, session, client=self.name if use_name else None):
            raise LinkError(str(problem))
        proposal = proposal_of(topic, self.transport_of(topic), client_name=self.name, use_name=use_name)
        return self.add(topic, proposal, proposed_here=True)

    def add(self, spec: Topic, proposal: Propose, *, proposed_here: bool) -> Route:
        """Make a route's half here; with `proposed_here` the peer is asked for its half at once.

        Args:
            spec: the topic, validated.
            proposal: of it, with this side's names.
            proposed_here: whether this side proposes it.

        Raises:
            LinkError: there is such a route.
        """
        key = route_key(self.name, proposal)
        if key in self.routes:
            raise LinkError(f"{proposal.topic} is bridged in that direction already: edit or remove that route")
        kind = OutgoingRoute if proposal.from_client == self.is_client else IncomingRoute
        route = kind(self.context, self, spec, proposal, proposed_here=proposed_here)
        self.routes[key] = route
        if proposed_here and self.linked:
            self.propose(route)
        return route

    def move(self, route: Route, at: int) -> None:
        """Give a route its place among the others, in whose order a session has its topics."""
        routes = [each for each in self.routes.values() if each is not route]
        routes.insert(at, route)
        self.routes = {each.key: each for each in routes}

    def remove(self, route: Route, reason: str) -> None:
        """End a route on both sides."""
        if route.id:
            self.send(Close(route=route.id, reason=sanitize_text(reason), removed=True))
        self.forget(route, EventCode.ROUTE_REMOVED, reason)

    def forget(self, route: Route, code: EventCode, reason: str) -> None:
        """End a route on this side."""
        self.routes.pop(route.key, None)
        route.destroy()
        route.log(Level.INFO, code, reason)

    def pause(self, route: Route, paused: bool) -> None:
        """Pause or resume a route on both sides."""
        route.pause(paused)
        self.send_pause(route)

    def send_pause(self, route: Route) -> None:
        """Tell the peer whether a route is paused."""
        if route.id:
            self.send(Pause(route=route.id, paused=route.paused, revision=route.pausing.revision))

    @property
    def shut_down(self) -> bool:
        """Whether it is down on purpose, and this side is the one to call again."""
        return False

    def retry_routes(self) -> None:
        """Open at once what was refused."""
        for route in tuple(self.routes.values()):
            if self.linked and route.proposed_here and not route.id:
                self.propose(route)

    def end_opening(self, route: Route, code: EventCode, reason: str) -> None:
        """There is no such route for now, as one of the sides says; it is tried again if it was proposed here."""
        route.refuse(code, reason)

    def closed(self, route_id: int) -> None:
        """An opening is over."""
        self._by_id.pop(route_id, None)

    def open_route(self, route_id: int) -> Route | None:
        """The open route of that id."""
        return self._by_id.get(route_id)

    def is_closed_id(self, route_id: int) -> bool:
        """Whether an opening of that id is over: of what is late on it, nothing need be said."""
        ours = route_id % 2 == self.is_client
        newest = self._next_id - 2 if ours else self.negotiation.newest_route
        return 0 < route_id <= newest and route_id not in self._by_id

    def propose(self, route: Route) -> None:
        """Ask the peer to open a route, anew if it was open."""
        self.reopen(route, self._next_id)
        self._next_id += 2
        self.spawn(self._propose(route, route.id))

    async def _propose(self, route: Route, route_id: int) -> None:
        try:
            await self.prepare_port(route)
        except ListenError as error:
            if route.id == route_id:
                self.end_opening(route, EventCode.ROUTE_PORT_UNAVAILABLE, str(error))
        if route.id == route_id:
            pausing = route.pausing
            self.send(
                msgspec.structs.replace(
                    route.proposal, route=route_id, paused=pausing.paused, pause_revision=pausing.revision
                )
            )

    def reopen(self, route: Route, route_id: int) -> None:
        """Begin a route's opening of that id."""
        route.close("opened anew")
        route.open(route_id)
        self._by_id[route_id] = route

    def open_channel(self, route: Route) -> None:
        """Set a route's channel going."""
        assert self.control is not None
        assert self.data_keys is not None
        port, transport = route.proposal.port or self.shared_port(), route.transport
        if self.transport.multiplexed and port == self.shared_port():
            route.channel = self.control.multiplexer.carry(route, self.data_keys)
            return
        if isinstance(transport, StreamTransport):
            self.open_stream(route, transport)
            return
        udp_channel = self.udp_channels.get(port)
        if udp_channel is None or udp_channel.over:
            udp_channel = self.open_udp_channel(transport, port)
            if udp_channel is None:
                return
            self.udp_channels[port] = udp_channel
            self._probe(udp_channel)
        route.channel = datagram_channel(udp_channel, route, self.data_keys)

    def attach_stream(self, route: Route, stream: Stream, beginning: bytes, *, multiplexed: bool) -> None:
        """A stream is let in that was opened for the route; `beginning` came behind its preamble."""
        assert self.data_keys is not None
        handler: StreamHandler
        if multiplexed:
            handler = shared = SharedStream(stream, self, route.proposal.port, self.unfinished)
            self.shared_streams[route.transport.name, route.proposal.port] = shared
            route.channel = shared.carry(route, self.data_keys)
        else:
            handler = route.channel = stream_channel(stream, route, self.data_keys)
        if beginning:
            handler.received(beginning)
        route.advance()

    def join_stream(self, shared: SharedStream, frame: bytes) -> None:
        """The peer wants a further route on a stream; raises ProtocolError or Refusal where that can't be."""
        raise ProtocolError("unexpected preamble frame on an open stream")

    def udp_ready(self) -> None:
        """A UDP channel has found its path, or can be opened now: the routes that wait for it go on."""

        def advance(route: Route) -> None:
            if route.id and not route.flowing:
                route.advance()

        self.spawn(in_slices(tuple(self._by_id.values()), advance))

    # --- time

    def guarded(self, work: Callable[[], None]) -> None:
        """Do some of this link's regular work; what fails in it ends this link's connection, not the others'."""
        try:
            work()
        except Exception as error:  # noqa: BLE001 — whatever it is, it is this link's
            self.context.loop.call_exception_handler({"message": f"link {self.name} failed", "exception": error})
            self.fail()

    async def tick_routes(self) -> None:
        """Once a second: the routes' own tick."""
        await in_slices(tuple(self.routes.values()), lambda route: self.guarded(route.tick))

    def tick(self) -> None:
        """Once a second, after the routes' own tick: keepalive, reports, retries."""
        now = self.context.now()
        if self.control is None:
            return
        self.udp_channels = {
            port: udp_channel for port, udp_channel in self.udp_channels.items() if not udp_channel.over
        }
        self.send(self.keepalive.tick())
        for udp_channel in self.udp_channels.values():
            self._tick_udp_channel(udp_channel)
        self._report()
        for route in tuple(self.routes.values()):
            if route.proposed_here and not route.id and now >= route.retry_at:
                self.propose(route)
            elif not route.proposed_here and not route.id and now > route.awaited_until(self._linked_at):
                self.forget(route, EventCode.ROUTE_ABANDONED, "the other side no longer asks for it")

    def _carriers(self) -> set[Carrier]:
        """All that carries bytes of the present connection."""
        carriers: set[Carrier] = {route.channel.carrier for route in self.routes.values() if route.channel is not None}
        carriers.update(self.udp_channels.values())
        if self.control is not None:
            carriers.add(self.control.stream)
        return carriers

    def _probe(self, udp_channel: UdpChannel, probes: int = 1) -> None:
        """Probe a new UDP channel more often than once a second, as long as a firewall does not seem to drop it all."""
        if probes <= _QUICK_PROBES and not udp_channel.ready and not udp_channel.over:
            udp_channel.tick()
            self.context.loop.call_later(_PROBE_EVERY, self._probe, udp_channel, probes + 1)

    def _tick_udp_channel(self, udp_channel: UdpChannel) -> None:
        before = udp_channel.trouble
        udp_channel.tick()
        if udp_channel.trouble and not before:
            self.log(Level.WARNING, EventCode.LINK_UDP_BLOCKED, udp_channel.trouble)
        elif before and not udp_channel.trouble:
            self.log(Level.INFO, EventCode.LINK_UDP_RESTORED, "UDP gets through again")

    def _report(self) -> None:
        routes = [route for route in self.routes.values() if route.id]
        sent = tuple(r.sent_report() for r in routes if isinstance(r, OutgoingRoute))
        received = tuple(r.received_report() for r in routes if isinstance(r, IncomingRoute))
        if sent or received:
            self.send(Report(sent=sent, received=received))

    # --- how it is

    def snapshot(self) -> LinkSnapshot:
        """The link as it is now."""
        now = self.context.now()
        keepalive, keys, peer = self.keepalive, self.keys, self.peer
        clock = keepalive.clock if self.linked else ClockOffset()  # what a dead connection measured holds no more
        return LinkSnapshot(
            name=self.name,
            peer=self.address,
            state=self._state(),
            reason=self.down_reason,
            since=self._since,
            retry_in=None if self.retry_at is None else max(0.0, self.retry_at - now),
            attempts=self.attempts,
            encrypted=self.encrypted,
            cipher=keys.suite.name if keys and self.encrypted else "",
            fingerprint=self.fingerprint,
            rtt=clock.rtt,
            clock_offset=clock.offset,
            clock_uncertainty=clock.uncertainty,
            rx_bytes_per_second=keepalive.rx_rate if self.linked else 0.0,
            tx_bytes_per_second=keepalive.tx_rate if self.linked else 0.0,
            peer_version=peer.version if peer else "",
            peer_domain=peer.domain_id if peer else None,
            use_name=self.use_name,
        )

    def _state(self) -> State:
        """One that nobody has joined yet, and nothing is known against, is no fault."""
        return State.OK if self.linked else State.WAITING if self.reason is _NOT_YET else State.DOWN

    def log(self, level: Level, code: EventCode, text: str, *, topic: str = "", link_status: bool = False) -> None:
        """Add an event about this link."""
        self.context.log(level, code, text, link=self.name, topic=topic, link_status=link_status)

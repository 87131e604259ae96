"""One peer: its connection, its routes, its keepalive. `client` and `server` add who connects to whom."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.datagram import datagram_channel
from rsb_bridge.channel.path_probe import PathProbe
from rsb_bridge.channel.shared_stream import SharedStream
from rsb_bridge.channel.stream import stream_channel
from rsb_bridge.config.validation import validate_topic
from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.keepalive import Keepalive
from rsb_bridge.link.neighbourhood import Neighbourhood
from rsb_bridge.link.proposals import proposal_of
from rsb_bridge.link.route_table import RouteTable
from rsb_bridge.link.topic_lists import TopicLists
from rsb_bridge.link.type_questions import TypeQuestions
from rsb_bridge.link.udp_channels import UdpChannels
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, LinkSnapshot, State, TopicInfo
from rsb_bridge.model.token_bucket import TokenBucket
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.ros.graph import topics_of
from rsb_bridge.route.incoming import EXPANSION_A_SECOND, EXPANSION_AT_ONCE
from rsb_bridge.route.latched import LATCHED_LIMIT
from rsb_bridge.route.pause import Revisions
from rsb_bridge.tasks import Tasks
from rsb_bridge.telemetry.meters import ClockOffset
from rsb_bridge.transport.transport import StreamTransport
from rsb_bridge.wire.budget import Budget
from rsb_bridge.wire.framing import UNFINISHED_LIMIT, ProtocolError
from rsb_bridge.wire.messages import AskType, ListTopics, Neighbours, Ping, Pong, Shutdown, TopicList, TypeText

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from rsb_bridge.channel.channel import Carrier
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.model.session import Topic
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.streams import Stream, StreamHandler
    from rsb_bridge.transport.transport import DatagramTransport, Transport
    from rsb_bridge.wire.messages import ControlMessage, Hello, Propose, Welcome
    from rsb_bridge.wire.sealing import Role, SessionKeys

_FURTHER_PUBLISHERS = 256
_NOT_YET = "not connected yet"


class Link(ABC):
    """A peer and its routes. It lives on while the peer is away.

    Attributes:
        transport: what carries the control connection.
        name: the client's name, on both sides.
        is_client: whether this side is the client.
        table: the routes.
        control: the authenticated connection; None: not linked.
        keys: what the present connection's handshake left; None: not linked.
        data_keys: what seals and opens routes' messages on it; None: not linked.
        connections: how many connections there have been.
        linked_at: s, when the present or last connection was made.
        shared_streams: multiplexed streams beside the control connection, by transport and channel.
        udp_channels: those of the present connection.
        unfinished: what the peer may have this side hold of messages that are not whole yet.
        latched: likewise for late joiners.
        expansion: bytes by which its compressed messages may grow here.
        revisions: numbers the changes made on this side.
        further_publishers: how many the peer may have here beyond one a topic.
        neighbourhood: the bridges in the ROS domains of both sides.
    """

    def __init__(self, context: Context, name: str, *, is_client: bool, fingerprint: str, encrypted: bool) -> None:
        self.context = context
        self.transport = context.transports.of_link(context.session.server_ip)
        self.name = name
        self.is_client = is_client
        self.role: Role = "client" if is_client else "server"
        self.control: ControlChannel | None = None
        self.keys: SessionKeys | None = None
        self.peer: Hello | Welcome | None = None
        self.fingerprint = fingerprint
        self.encrypted = encrypted
        self.reason = _NOT_YET
        self.cause = LinkCause.NOT_YET
        self.retry_at: float | None = None
        self.attempts = 0
        self.connections = 0
        self.linked_at = 0.0
        self.data_keys: DataKeys | None = None
        self.path_probe: PathProbe | None = None
        self.shared_streams: dict[tuple[str, int], SharedStream] = {}
        self.unfinished = Budget(UNFINISHED_LIMIT)
        self.latched = Budget(LATCHED_LIMIT)
        self.expansion = TokenBucket(EXPANSION_AT_ONCE, EXPANSION_A_SECOND, context.now())
        self.revisions = Revisions()
        self.further_publishers = Budget(_FURTHER_PUBLISHERS)
        self.neighbourhood = Neighbourhood(context, self.send)
        self._since = context.wall()
        self._tasks = Tasks(context.loop, self.fail)
        self.keepalive = Keepalive(context, self._carriers)
        self.udp_channels = UdpChannels(context.loop, self.log)
        self.table = RouteTable(context, self)
        self._topic_lists = TopicLists(self._local_topics, self.send, self.spawn)
        self._type_questions = TypeQuestions(context.descriptions, self.table.open_route, self.send, self.spawn)

    # --- what client and server do differently

    @property
    @abstractmethod
    def address(self) -> str:
        """The peer's address, for people."""

    @abstractmethod
    def shared_port(self) -> int:
        """The port or channel of the link itself."""

    @property
    @abstractmethod
    def use_name(self) -> bool:
        """Whether the server puts the client's name before the names of its topics, as far as is known."""

    @property
    def shut_down(self) -> bool:
        """Whether the link is down on purpose and waits for this side's operator."""
        return False

    @abstractmethod
    def authorize(self, proposal: Propose) -> Propose:
        """The peer's proposal with this side's name for the topic; LinkError if the peer may not have it."""

    @abstractmethod
    def shows(self, topic: str) -> bool:
        """Whether the peer may know that a topic is in this side's graph. May be called from any thread."""

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

    # --- up and down

    @property
    def linked(self) -> bool:
        """Whether the peer is connected and authenticated."""
        return self.control is not None

    @property
    def down_reason(self) -> str:
        """Why it isn't linked."""
        return "" if self.control else self.reason

    @property
    def instance(self) -> str:
        """The peer's process, present or last; empty: there has been none."""
        return self.peer.instance if self.peer is not None else ""

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

    def up(self, control: ControlChannel, peer: Hello | Welcome, keys: SessionKeys) -> None:
        """The peer is connected and authenticated."""
        self.control, self.peer, self.keys = control, peer, keys
        self.data_keys = DataKeys(keys, self.role, self.unfinished)
        self.path_probe = PathProbe(self.data_keys)
        self.connections += 1
        self.linked_at = self.context.now()
        self.keepalive = Keepalive(self.context, self._carriers)
        self.keepalive.watch(partial(control.abort, "the peer is silent"))
        self._since = self.context.wall()
        self.attempts = 0
        self.retry_at = None
        self.cause = LinkCause.NONE
        encryption = f"encrypted with {keys.suite.name}" if self.encrypted else "NOT ENCRYPTED"
        linked = f"linked with {control.stream.peer}, {encryption}, rsb-console {peer.version} there"
        self.log(Level.INFO, EventCode.LINK_UP, linked, link_status=True)
        self.neighbourhood.tell()
        self.table.connected()

    def lost(self, reason: str, code: EventCode) -> None:
        """The control connection is over."""
        self.keepalive.stop()
        self.control = self.keys = self.data_keys = self.path_probe = None
        self.neighbourhood.disconnected()
        self.set_down(LinkCause.LOST if code is EventCode.LINK_LOST else LinkCause.CLOSED, reason)
        self._since = self.context.wall()
        self.table.disconnected(reason)
        self.udp_channels.close()
        self.shared_streams.clear()
        self._topic_lists.disconnected()
        self._type_questions.disconnected()
        level = Level.INFO if code is EventCode.LINK_CLOSED else Level.WARNING
        how = "lost" if code is EventCode.LINK_LOST else "closed"
        self.log(level, code, f"link with {self.address} {how}: {reason}", link_status=True)

    def set_down(self, cause: LinkCause, reason: str) -> None:
        """Say why the link is down; `reason` is for an operator."""
        self.cause, self.reason = cause, reason

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

    def message(self, message: ControlMessage) -> None:
        """The peer sent a control message."""
        match message:
            case Ping():
                self.send(self.keepalive.answer(message))
            case Pong():
                self.keepalive.answered(message)
            case ListTopics() | TopicList():
                self._topic_lists.handle(message)
            case Neighbours():
                self.neighbourhood.heard(message)
            case AskType() | TypeText():
                self._type_questions.handle(message)
            case Shutdown():
                self.on_shutdown(message)
            case _:
                self.table.handle(message)

    async def remote_topics(self) -> list[TopicInfo]:
        """The topics of the peer's graph.

        Raises:
            LinkError: there is no peer now, or it does not answer.
        """
        if not self.linked:
            raise LinkError(f"{self.name} is not linked: {self.reason}")
        try:
            return await self._topic_lists.ask()
        except LinkError as error:
            raise LinkError(f"{self.name}: {error}") from None

    async def describe(self, route: Route) -> str:
        """The text of the description of a route's type.

        Raises:
            LinkError: neither side knows it.
        """
        return await self._type_questions.describe(route, linked=self.linked)

    async def _local_topics(self) -> list[TopicInfo]:
        def shown() -> list[TopicInfo]:
            return [topic for topic in topics_of(self.context.ros) if self.shows(topic.topic)]

        return await asyncio.to_thread(shown)

    # --- routes

    @property
    def routes(self) -> dict[str, Route]:
        """The routes, by key."""
        return self.table.routes

    @property
    def proposed_topics(self) -> tuple[Topic, ...]:
        """What this side proposes, as operators have left it. May be called from any thread."""
        topics = [route.spec for route in tuple(self.routes.values()) if route.proposed_here]
        return (*topics, *tuple(self.table.yielded.values()))

    def transport_of(self, topic: Topic) -> Transport:
        """What carries a topic's messages; the link's own transport unless the topic names another."""
        return self.context.transports[topic.protocol] if topic.protocol else self.transport

    def add_topic(self, topic: Topic) -> Route:
        """Bridge one more topic, which this side proposes.

        Raises:
            LinkError: the topic has a mistake, or there is such a route.
        """
        return self.table.add(topic, self._proposal(topic), proposed_here=True)

    def can_amend(self, route: Route, topic: Topic) -> bool:
        """Whether a route can go on, with its counts, if another topic takes its place.

        Raises:
            LinkError: the topic has a mistake.
        """
        return self.table.can_amend(route, self._proposal(topic))

    def replace_topic(self, route: Route, topic: Topic) -> Route:
        """Put another topic in a route's place; the route goes on if only limits differ, else there is a new one.

        Raises:
            LinkError: the topic has a mistake, or there is such a route; the old one stays.
        """
        proposal = self._proposal(topic)
        if self.table.can_amend(route, proposal):
            self.table.amend(route, topic, proposal)
            return route
        at = list(self.routes).index(route.key)
        self.table.remove(route, "edited")
        try:
            new = self.table.add(topic, proposal, proposed_here=True)
        except LinkError:
            self.table.move(self.add_topic(route.spec), at)
            raise
        self.table.move(new, at)
        return new

    def _proposal(self, topic: Topic) -> Propose:
        session = self.context.session
        use_name = session.use_name if self.is_client else self.use_name
        for problem in validate_topic(topic, session, client=self.name if use_name else None):
            raise LinkError(str(problem))
        return proposal_of(topic, self.transport_of(topic), client_name=self.name, use_name=use_name)

    def closed(self, route_id: int) -> None:
        """An incarnation of a route is over."""
        self.table.closed(route_id)

    def open_channel(self, route: Route) -> None:
        """Open what carries a route's messages, or begin to."""
        assert self.control is not None
        assert self.data_keys is not None
        port, transport = route.proposal.port or self.shared_port(), route.transport
        if self.transport.multiplexed and port == self.shared_port():
            route.channel = self.control.multiplexer.carry(route, self.data_keys)
        elif isinstance(transport, StreamTransport):
            self.open_stream(route, transport)
        elif (udp_channel := self.udp_channels.get(port) or self._new_udp_channel(transport, port)) is not None:
            route.channel = datagram_channel(udp_channel, route, self.data_keys)

    def _new_udp_channel(self, transport: DatagramTransport, port: int) -> UdpChannel | None:
        udp_channel = self.open_udp_channel(transport, port)
        if udp_channel is not None:
            self.udp_channels.add(port, udp_channel)
            self.udp_channels.probe(udp_channel)
        return udp_channel

    def udp_ready(self) -> None:
        """A UDP channel has found its path, or can be opened now: the routes that wait for it go on."""
        self.spawn(self.table.advance())

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

    def is_closed_id(self, route_id: int) -> bool:
        """Whether a route was open under that id and is no longer."""
        return self.table.is_closed_id(route_id)

    # --- time

    def tick(self) -> None:
        """Once a second, after the routes' own tick: keepalive, reports, retries."""
        if self.control is None:
            return
        self.send(self.keepalive.tick())
        self.udp_channels.tick()
        self.table.report()
        self.table.tick()

    def _carriers(self) -> set[Carrier]:
        """All that carries bytes of the present connection."""
        carriers: set[Carrier] = {route.channel.carrier for route in self.routes.values() if route.channel is not None}
        carriers.update(self.udp_channels.all())
        if self.control is not None:
            carriers.add(self.control.stream)
        return carriers

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
            cause=self.cause if not self.linked else LinkCause.NAME_TAKEN if self.warning else LinkCause.NONE,
            warning=self.warning,
        )

    @property
    def warning(self) -> str:
        """What is wrong though the link is up, for an operator; or empty."""
        return ""

    def _state(self) -> State:
        """A link that never connected is WAITING, not DOWN."""
        return State.OK if self.linked else State.WAITING if self.reason is _NOT_YET else State.DOWN

    def log(self, level: Level, code: EventCode, text: str, *, topic: str = "", link_status: bool = False) -> None:
        """Add an event about this link; `link_status`: it says whether the link is up."""
        self.context.log(level, code, text, link=self.name, topic=topic, link_status=link_status)

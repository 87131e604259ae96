"""An association's connections: the control channel and its keys, and the routes' streams and UDP channels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.data_stream import StreamPair, stream_channel, take_receipts
from rsb_bridge.channel.datagram_channel import DatagramEnd
from rsb_bridge.channel.reliable_datagrams import datagram_channel
from rsb_bridge.channel.scheduler import Scheduler
from rsb_bridge.channel.udp_channel import PathProbe
from rsb_bridge.channel.window import ReceiptBook, Window
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.snapshot import Level
from rsb_bridge.tasks import in_slices
from rsb_bridge.transport.transport import RECEIVE_BUFFER, StreamTransport
from rsb_bridge.wire.codec import decode_urgent
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Collection, Coroutine, Iterator

    from rsb_bridge.channel.data_keys import Meter
    from rsb_bridge.channel.data_stream import DataStream
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.link.keepalive import ChannelCarrier, Keepalive
    from rsb_bridge.link.route_ids import RouteIds
    from rsb_bridge.route.peer_budget import PeerBudget
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.transport.transport import DatagramTransport
    from rsb_bridge.wire.events import StreamName
    from rsb_bridge.wire.messages import ControlMessageBase, Receipts
    from rsb_bridge.wire.sealing import ConnectionKeys, Role

_PROBE_EVERY, _QUICK_PROBES = 0.25, 8  # s, and how many: `tick` comes once a second only. Round figures
CONTROL_NUMBER = 0  # of the control connection where it is a data stream, too


class CarriedLink(Protocol):
    """The members of a link (`rsb_bridge.link.base_link.BaseLink`) that its connection uses."""

    context: Context
    transport: StreamTransport
    role: Role
    ids: RouteIds
    budget: PeerBudget
    keepalive: Keepalive
    outlive: float
    shortages_told: set[bool]  # kernel buffers of this side (True) or the peer that are logged already

    def shared_port(self) -> int: ...

    def meter_of(self, route_id: int) -> Meter | None: ...

    def send(self, message: ControlMessageBase) -> object: ...

    def spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]: ...

    def log_of_peer(self, level: Level, code: EventCode, text: str) -> None: ...


class DataChannels:
    """Made when an association begins, and closed when it ends. A client opens the streams, a server accepts them.

    Attributes:
        control: the authenticated connection, or the last one while the link is suspended.
        is_silent: whether it ends because nothing comes any more.
        connection_keys: its keys.
        keys: seal and open the routes' messages.
        scheduler: shares the streams among the routes.
        book: sends receipts.
        probe: the datagram that finds a UDP path.
        awaiting: the routes that wait for streams, by their transport and port, then by the ids of their openings.
    """

    def __init__(self, link: CarriedLink, control: ControlChannel, keys: ConnectionKeys) -> None:
        self._link = link
        self.is_silent = False
        # What its streams and UDP channels ask for.
        self.ids, self.now, self.send_receipts = link.ids, link.context.now, link.send
        self.book = ReceiptBook(link.context.loop, self)
        self.scheduler = Scheduler(self.book, Window(link.transport.ages))
        self.awaiting: dict[tuple[str, int], dict[int, Route]] = {}
        self._pairs: dict[tuple[str, int], StreamPair] = {}
        self._udp: dict[int, UdpChannel] = {}
        self._newest = 0  # number of a stream
        self._trouble: tuple[object, ...] = ()  # of the pairs and UDP channels, at the last tick
        self._connect(control, keys)
        keys.resumed(())

    def _connect(self, control: ControlChannel, keys: ConnectionKeys) -> None:
        link = self._link
        self.control, self.connection_keys = control, keys
        self.keys = DataKeys(keys, link.role, link.budget.unfinished, meter_of=link.meter_of)
        self.probe = PathProbe(self.keys)
        if link.transport.multiplexed:  # the stream carries the routes of its own port, too, as streams are scarce
            pair = self._pair(link.transport, link.shared_port())
            control.data = pair.add(control.stream, CONTROL_NUMBER, large=True, small=True)
            control.stream.joined = link.context.ros_queue.joined

    def suspend(self, reason: str) -> None:
        """End the lost connection's streams; routes wait for the next. None that has to be armed is open any more."""
        for pair in tuple(self._pairs.values()):
            pair.suspend(Reason(reason, EndCode.BROKE))
        for channel in self._udp.values():
            channel.close()
        self._udp.clear()

    def resume(self, control: ControlChannel, keys: ConnectionKeys, proposed: Collection[int]) -> None:
        """Resume on the association's next connection.

        Args:
            proposed: ids of routes that the other side does not know yet, and that are proposed again.
        """
        self.is_silent = False
        keys.resumed(route.id for route in self.ids.open_routes() if route.id not in proposed)
        self._connect(control, keys)
        for pair in self._pairs.values():
            if not pair.over:
                pair.resume(self.keys)

    @property
    def outlive(self) -> float:
        """Seconds for which lost streams may be opened again: as many as the association outlives its connection."""
        return self._link.outlive

    def open_all(self) -> None:
        """Open the streams and UDP channels that routes wait for."""
        for pair in self._pairs.values():
            if not pair.over and any(pair.lacks()):
                self.open_streams(pair.transport, pair.port)
        self._link.spawn(self._advance())

    def is_accepted(self, route_id: int) -> bool:
        """Whether the other side has accepted an opening of a route, which still is open."""
        route = self.ids.open_route(route_id)
        return route is not None and route.life.accepted

    def ping(self) -> float:
        return 2 * (self._link.keepalive.clock.uncertainty or 0.0)

    def way_back(self) -> float:
        # Certain only beyond the error of the peer's clock, which is half of the shortest round trip.
        keepalive = self._link.keepalive
        return max(0.0, keepalive.ping_delay - (keepalive.clock.uncertainty or 0.0))

    def close(self) -> None:
        """Call it when no route uses a channel any more."""
        for pair in self._pairs.values():
            if not pair.over:
                pair.end("the link is over")
        for channel in self._udp.values():
            channel.close()
        # After all streams and sockets, which leave both at their end.
        self.book.close()
        self.scheduler.close()

    # --- the routes' channels

    def open(self, route: Route) -> None:
        """Open the channel of a route, or begin to."""
        transport, port = route.transport, route.proposal.port or self._link.shared_port()
        if isinstance(transport, StreamTransport):
            if (pair := self.pair_of(transport.name, port)) is not None:
                self._carry(route, pair)
            else:
                self.awaiting.setdefault((transport.name, port), {})[route.id] = route
                self.open_streams(transport, port)
            return
        # One whose last route has left is over at once, and stays in the table until the next tick.
        channel = self._udp.get(port)
        if channel is None or channel.over:
            channel = self._open_udp(transport, port)
        # Without one, a client tries again, and a server waits for its client's probe; both then call `udp_ready`.
        if channel is None:
            return
        carried = route.half.carried
        if isinstance(carried.channel, DatagramEnd):
            carried.channel.resume(channel, self.keys)
        else:
            carried.channel = datagram_channel(channel, route, self.keys)

    def _carry(self, route: Route, pair: StreamPair) -> None:
        route.half.carried.channel = stream_channel(pair, route)
        pair.take_held()  # its first frames may have overtaken the control message that has opened it

    def _take_awaiting(self, transport: str, port: int) -> Iterator[Route]:
        """Yield the routes that wait for streams, and for which nothing else has come first; none of them waits on."""
        for route_id, route in self.awaiting.pop((transport, port), {}).items():
            if route.id == route_id and route.half.carried.channel is None:  # else it was closed meanwhile
                yield route

    def udp_ready(self) -> None:
        """Advance the routes that wait for a UDP channel: one has found its path, or can be opened now."""
        self.scheduler.run()
        self._link.spawn(self._advance())

    async def _advance(self) -> None:
        def advance(route: Route) -> None:
            # A slice before this one has closed it, or the connection was lost before this one's turn: the next one has
            # its own keys and sockets, and its own turn.
            if not route.id or self.control.over:
                return
            if isinstance(route.half.carried.channel, DatagramEnd) and route.half.carried.channel.is_suspended:
                self.open(route)
            route.advance()

        await in_slices(self.ids.open_routes(), advance)  # hundreds may wait for the same path

    # --- streams

    def open_streams(self, transport: StreamTransport, port: int) -> None:
        """Open the streams for routes with that port; a server waits for the client's."""

    def pair_of(self, transport: str, port: int) -> StreamPair | None:
        """Return the streams for routes with that port, or None if they are not both open."""
        pair = self._pairs.get((transport, port))
        return pair if pair is not None and pair.ready and not pair.over else None

    def attach(self, stream: Stream, name: StreamName, transport: StreamTransport, port: int, beginning: bytes) -> None:
        """Use an accepted stream; `beginning` are the bytes that arrived after its preamble."""
        pair = self._pair(transport, port)
        if (old := pair.large if name.large else pair.small) is not None:
            pair.lose(old, Reason("the other side opened it again", EndCode.BROKE))
            pair = self._pair(transport, port)  # maybe another one: a pair without routes ends with its streams
        pair.kept = not name.port  # the link's own, which stay while no route uses them (PROTOCOL.md, 1.5)
        both = transport.multiplexed
        stream.joined = self._link.context.ros_queue.joined
        stream.handler = added = pair.add(stream, name.number, large=name.large or both, small=both or not name.large)
        if reason := pair.resume_routes():
            text = f"a data connection broke ({reason.text}) and was opened again; only best-effort messages are lost"
            self._link.log_of_peer(Level.WARNING, EventCode.LINK_STREAM_REOPENED, text)
        if beginning and not added.over:
            added.received(beginning)

    async def streams_opened(self, transport: str, port: int) -> None:
        """Open the channels of the routes that wait for streams, if these are complete, in slices."""

        def carry(route: Route) -> None:
            self.open(route)  # which waits again if a slice before has lost the streams
            if route.half.carried.channel is not None:
                route.advance()

        if self.pair_of(transport, port) is not None:
            await in_slices(self._take_awaiting(transport, port), carry)

    def _pair(self, transport: StreamTransport, port: int) -> StreamPair:
        pair = self._pairs.get((transport.name, port))
        if pair is None or pair.over:
            pair = self._pairs[transport.name, port] = StreamPair(self, transport, port)
        return pair

    def _streams(self) -> Iterator[DataStream]:
        for pair in self._pairs.values():
            if not pair.over:
                yield from pair.streams()

    def take_receipts(self, receipts: Receipts) -> None:
        take_receipts(receipts, self._streams(), self.scheduler)

    # --- UDP

    def _open_udp(self, transport: DatagramTransport, port: int) -> UdpChannel | None:
        """Open datagrams to the peer's port. Return None on failure, and on a server: there, a probe opens them."""
        return None

    def _probe(self, channel: UdpChannel, left: int = _QUICK_PROBES) -> None:
        """Probe the path of a new channel every 0.25 s; from the 9th time on, only `tick` does."""
        if left and not channel.ready and not channel.over:
            channel.tick()
            self._link.context.loop.call_later(_PROBE_EVERY, self._probe, channel, left - 1)

    def send_urgent(self, content: bytes) -> None:
        """Send an encoded control message over all channels that have found their path."""
        for channel in self._udp.values():
            if channel.ready and not channel.over:
                channel.send_urgent(content)

    def take_urgent(self, content: bytes) -> None:
        """Take a control message that came as a datagram."""
        if self.control.over:  # another datagram of the same batch has ended the link
            return
        try:
            message = decode_urgent(content)
        except ProtocolError as error:
            self.control.broken(error)
        else:
            self.control.take_urgent(message)

    def _tick_udp(self) -> None:
        """Probe, and log when a path breaks or recovers, or a kernel buffer is too small."""
        # A late datagram, or that of a stranger who has seen the link's id, opens a channel that no route uses: its
        # silence is no fault, and its socket may be closed.
        for channel in self._udp.values():
            if channel.is_unused:
                channel.close()
        self._udp = {port: channel for port, channel in self._udp.items() if not channel.over}
        log = self._link.log_of_peer
        for channel in self._udp.values():
            before = channel.trouble
            channel.tick()
            if channel.trouble and not before:
                log(Level.WARNING, EventCode.LINK_UDP_BLOCKED, channel.trouble)
            elif before and not channel.trouble:
                log(Level.INFO, EventCode.LINK_UDP_RESTORED, "UDP gets through again")
            for here, short in channel.shortages.items():
                if here not in self._link.shortages_told:  # the remedy is the same for all channels of a machine
                    self._link.shortages_told.add(here)
                    whose, where = ("this machine's", "here") if here else ("the other side's", "there")
                    log(
                        Level.WARNING,
                        EventCode.LINK_UDP_BUFFER,
                        f"{whose} kernel buffers only {short.granted:,} bytes of UDP, and messages have "
                        f"{short.message:,}: they come late, or are lost. Run {where}: "
                        f"sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER}",
                    )

    # --- both

    def tick(self) -> None:
        """Send pending receipts, and close the window of a stalled link. Called once a second."""
        # Openings closed meanwhile are dropped: a client may try again for months, and never get its streams.
        if self.awaiting:
            waiting = {
                key: {at: each for at, each in its.items() if each.id == at} for key, its in self.awaiting.items()
            }
            self.awaiting = {key: its for key, its in waiting.items() if its}
        self._tick_udp()
        self.scheduler.tick()
        self.book.report()
        self._pairs = {key: pair for key, pair in self._pairs.items() if not pair.over}
        for pair in tuple(self._pairs.values()):
            pair.tick(self._link.keepalive.control_quiet)
        before = self._trouble
        self._trouble = *(each.trouble for each in self._pairs.values()), *(each.trouble for each in self._udp.values())
        if self._trouble != before:
            for route in self.ids.open_routes():
                route.judge_again()

    def carriers(self) -> set[ChannelCarrier]:
        """Return all streams and UDP channels, including the control connection's."""
        found: set[ChannelCarrier] = {self.control.stream, *self._udp.values()}
        for pair in self._pairs.values():  # a generator would take a call for each stream, several times a second
            if not pair.over:
                found.update([each.stream for each in (pair.small, pair.large) if each is not None and not each.over])
        return found

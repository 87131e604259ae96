"""The streams and UDP channels of one connection of a link, which carry the messages of its routes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.data_stream import StreamPair, stream_channel, take_receipts
from rsb_bridge.channel.scheduler import Scheduler
from rsb_bridge.channel.udp_channel import PathProbe
from rsb_bridge.channel.window import ReceiptBook, Window
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.snapshot import Level
from rsb_bridge.transport.transport import RECEIVE_BUFFER
from rsb_bridge.wire.events import StreamName

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.channel.data_keys import Meter
    from rsb_bridge.channel.data_stream import DataStream, RouteNumbers
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.link.keepalive import ChannelCarrier, Keepalive
    from rsb_bridge.route.peer import PeerBudget
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.transport.transport import StreamTransport
    from rsb_bridge.wire.messages import Receipts
    from rsb_bridge.wire.sealing import Role, SessionKeys

_PROBE_EVERY, _QUICK_PROBES = 0.25, 8  # s, and how many: `tick` comes once a second only. Round figures
CONTROL_NUMBER = 0  # of the control connection where it is a data stream, too
_OUT_OF_ORDER = 1024
"""How far below the newest a stream's number may be (PROTOCOL.md, 1.3): the streams of several ports open at once, and
arrive in any order. Older numbers are refused, so none of them is remembered."""


class CarriedLink(Protocol):
    """The link whose routes use the channels (`rsb_bridge.link.base_link.BaseLink`).

    Attributes:
        shortages_told: of kernel buffers, here (True) or there, that the operator was told of.
    """

    context: Context
    transport: StreamTransport
    role: Role
    budget: PeerBudget
    keepalive: Keepalive
    shortages_told: set[bool]

    @property
    def ids(self) -> RouteNumbers:
        """The ids of its routes."""

    @property
    def udp_ready(self) -> Callable[[], None]:
        """Advances the routes that wait for a UDP channel."""

    def send(self, message: Receipts) -> None:
        """Send a control message."""

    def take_urgent(self, content: bytes) -> None:
        """Take a control message that came as a datagram."""

    def open_streams(self, transport: StreamTransport, port: int) -> None:
        """Open the streams for routes with that port."""

    def meter_of(self, route_id: int) -> Meter | None:
        """Return the meter of a route that has one."""

    def log_of_peer(self, level: Level, code: EventCode, text: str) -> None:
        """Add an event."""


class DataChannels:
    """Made when a link comes up, and closed when it is lost.

    Attributes:
        keys: seal and open the routes' messages.
        scheduler: shares the streams among the routes.
        book: sends receipts.
        probe: the datagram that finds a UDP path.
    """

    def __init__(self, link: CarriedLink, keys: SessionKeys) -> None:
        self._link = link
        # What its streams and UDP channels ask of the link.
        self.ids, self.now, self.udp_ready = link.ids, link.context.now, link.udp_ready
        self.send_receipts, self.take_urgent, self.open_streams = link.send, link.take_urgent, link.open_streams
        self.book = ReceiptBook(link.context.loop, self)
        self.scheduler = Scheduler(self.book, Window(link.transport.ages))
        self.keys = DataKeys(keys, link.role, link.budget.unfinished, meter_of=link.meter_of)
        self.probe = PathProbe(self.keys)
        self._pairs: dict[tuple[str, int], StreamPair] = {}
        self._udp: dict[int, UdpChannel] = {}
        self._newest = 0
        self._taken: set[int] = set()

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

    # --- streams

    def use_control(self, stream: Stream, transport: StreamTransport, port: int) -> DataStream:
        """Have the control connection's stream carry the routes of its own port, as streams are scarce."""
        return self._pair(transport, port).add(stream, CONTROL_NUMBER, large=True, small=True)

    def next_name(self, port: int, *, large: bool) -> StreamName:
        self._newest += 1
        return StreamName(self._newest, port, large)

    def is_new(self, name: StreamName) -> bool:
        """Whether a client may open a stream of that name now: none has had its number."""
        return max(0, self._newest - _OUT_OF_ORDER) < name.number and name.number not in self._taken

    def pair_of(self, transport: str, port: int) -> StreamPair | None:
        """Return the streams for routes with that port, or None if they are not both open."""
        pair = self._pairs.get((transport, port))
        return pair if pair is not None and pair.ready and not pair.over else None

    def lacks(self, transport: str, port: int) -> tuple[bool, bool]:
        """Return whether the streams of small and of large messages for that port are not open."""
        pair = self._pairs.get((transport, port))
        return (True, True) if pair is None or pair.over else pair.lacks()

    def carry(self, route: Route, pair: StreamPair) -> None:
        route.channel = stream_channel(pair, route, self.keys)
        pair.resume()  # its first frames may have overtaken the control message that has opened it

    def attach(self, stream: Stream, name: StreamName, transport: StreamTransport, port: int, beginning: bytes) -> None:
        """Use an accepted stream; `beginning` are the bytes that arrived after its preamble."""
        self._newest = max(self._newest, name.number)
        self._taken.add(name.number)
        if len(self._taken) > 2 * _OUT_OF_ORDER:  # twice as many: it is rebuilt once in a thousand streams
            self._taken = {each for each in self._taken if each > self._newest - _OUT_OF_ORDER}
        pair = self._pair(transport, port)
        if (old := pair.large if name.large else pair.small) is not None:
            pair.cut(old, Reason("the other side opened it again", EndCode.BROKE))
            pair = self._pair(transport, port)  # maybe another one: a pair without routes ends with its streams
        pair.kept = not name.port  # the link's own, which stay while no route uses them (PROTOCOL.md, 1.5)
        both = transport.multiplexed
        stream.handler = added = pair.add(stream, name.number, large=name.large or both, small=both or not name.large)
        if reason := pair.go_on():
            text = f"a data connection broke ({reason.text}) and was opened again; messages that were on it may be lost"
            self._link.log_of_peer(Level.WARNING, EventCode.LINK_STREAM_REOPENED, text)
        if beginning and not added.over:
            added.received(beginning)

    def give_up(self, transport: str, port: int, reason: Reason) -> None:
        """Close the routes that wait for streams for that port in place of lost ones."""
        if (pair := self._pairs.get((transport, port))) is not None:
            pair.give_up(reason)

    def end_unused(self, transport: str, port: int) -> None:
        """Close the streams for routes with that port if none uses them: they hold descriptors that others need."""
        if (pair := self._pairs.get((transport, port))) is not None:
            pair.end_unused()

    def _pair(self, transport: StreamTransport, port: int) -> StreamPair:
        pair = self._pairs.get((transport.name, port))
        if pair is None or pair.over:
            pair = self._pairs[transport.name, port] = StreamPair(self, transport, port)
        return pair

    def _streams(self) -> Iterator[DataStream]:
        for pair in self._pairs.values():
            if not pair.over:
                yield from pair.streams()

    def handle_receipts(self, receipts: Receipts) -> None:
        take_receipts(receipts, self._streams(), self.scheduler)

    # --- UDP

    def udp(self, port: int) -> UdpChannel | None:
        """Return the open channel of a port."""
        # One whose last route has left is over at once, and stays in the table until the next tick.
        channel = self._udp.get(port)
        return channel if channel is not None and not channel.over else None

    def add_udp(self, port: int, channel: UdpChannel, *, probe: bool = False) -> None:
        """Add a new channel; a client probes its path every 0.25 s, and from the 9th time on only in `tick`."""
        self._udp[port] = channel
        if probe:
            self._probe(channel, _QUICK_PROBES)

    def _probe(self, channel: UdpChannel, left: int) -> None:
        if left and not channel.ready and not channel.over:
            channel.tick()
            self._link.context.loop.call_later(_PROBE_EVERY, self._probe, channel, left - 1)

    def send_urgent(self, content: bytes) -> None:
        """Send an encoded control message over all channels that have found their path."""
        for channel in self._udp.values():
            if channel.ready and not channel.over:
                channel.send_urgent(content)

    def _tick_udp(self) -> None:
        """Probe, and log when a path breaks or recovers, or a kernel buffer is too small."""
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
        self._tick_udp()
        self.scheduler.tick()
        self.book.report()
        self._pairs = {key: pair for key, pair in self._pairs.items() if not pair.over}
        for pair in tuple(self._pairs.values()):
            pair.tick(self._link.keepalive.control_quiet)

    def carriers(self, control: ControlChannel) -> set[ChannelCarrier]:
        """Return all streams and UDP channels, including the control connection's."""
        return {control.stream, *(each.stream for each in self._streams()), *self._udp.values()}

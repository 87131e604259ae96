"""The streams and UDP channels that carry the messages of a link's routes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.multiplexer import SharedStream
from rsb_bridge.channel.receipts import ReceiptBook, ReceiptSender, WindowedSender
from rsb_bridge.channel.stream import stream_channel
from rsb_bridge.channel.udp_channel import PathProbe
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.transport.transport import RECEIVE_BUFFER

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable

    from rsb_bridge.channel.channel import Carrier
    from rsb_bridge.channel.data_keys import Meter
    from rsb_bridge.channel.multiplexer import SharedStreamOwner
    from rsb_bridge.channel.udp_channel import BufferShortage, UdpChannel
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.streams import Stream, StreamHandler
    from rsb_bridge.wire.framing import Budget
    from rsb_bridge.wire.messages import Receipts
    from rsb_bridge.wire.sealing import Role, SessionKeys

_PROBE_EVERY, _QUICK_PROBES = 0.25, 8


class UdpChannels:
    """A link's UDP channels by port, probed and watched as long as they are open.

    Args:
        loop: sets the timers.
        log: adds an event about the link.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, log: Callable[[Level, EventCode, str], None]) -> None:
        self._loop = loop
        self._log = log
        self._channels: dict[int, UdpChannel] = {}
        self._shortages_told: set[bool] = set()

    def get(self, port: int) -> UdpChannel | None:
        """Return the open channel of a port."""
        channel = self._channels.get(port)
        return channel if channel is not None and not channel.over else None

    def add(self, port: int, channel: UdpChannel) -> None:
        """Add a new channel."""
        self._channels[port] = channel

    def open(self, port: int, channel: UdpChannel) -> None:
        """Add a new channel, and probe its path."""
        self.add(port, channel)
        self._probe(channel)

    def _probe(self, channel: UdpChannel, probes: int = 1) -> None:
        """Probe a new channel every 0.25 s; after 8 probes without an answer, only `tick` probes."""
        if probes <= _QUICK_PROBES and not channel.ready and not channel.over:
            channel.tick()
            self._loop.call_later(_PROBE_EVERY, self._probe, channel, probes + 1)

    def tick(self) -> None:
        """Probe, and log when a path breaks or recovers, or a kernel buffer is too small. Called once a second."""
        self._channels = {port: channel for port, channel in self._channels.items() if not channel.over}
        for channel in self._channels.values():
            before = channel.trouble
            channel.tick()
            if channel.trouble and not before:
                self._log(Level.WARNING, EventCode.LINK_UDP_BLOCKED, channel.trouble)
            elif before and not channel.trouble:
                self._log(Level.INFO, EventCode.LINK_UDP_RESTORED, "UDP gets through again")
            for here, shortage in channel.shortages.items():
                if here not in self._shortages_told:
                    self._shortages_told.add(here)
                    self._log(Level.WARNING, EventCode.LINK_UDP_BUFFER, _shortage_message(shortage))

    def close(self) -> None:
        """Close them all."""
        for channel in self._channels.values():
            channel.close()
        self._channels.clear()

    def all(self) -> list[UdpChannel]:
        """Return all channels."""
        return list(self._channels.values())


def _shortage_message(shortage: BufferShortage) -> str:
    """Return the reason why large messages are slow, and the remedy, for an operator."""
    whose, where = ("this machine's", "here") if shortage.here else ("the other side's", "there")
    return (
        f"{whose} kernel buffers only {shortage.granted:,} bytes of UDP, and messages have {shortage.message:,}: they "
        f"come late, or are lost. Run {where}: sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER}"
    )


class DataChannels:
    """The streams and UDP channels of one link besides its control connection.

    Args:
        loop: sets the timers.
        log: adds an event about the link.
        unfinished: the budget for incomplete messages of the peer.
        send_receipts: sends receipts to the peer.
        way_back: gives the s that a message of the peer takes to get here.
        ping: gives the s of the connection's shortest ping, or 0 if it is unknown.
        meter_of: gives the meter of a route by its id, or None for a route that has none.

    Attributes:
        book: for receipts of streams, or None without a link or if the peer does not support them.
        keys: to seal and open routes' messages, or None without a link.
        probe: the datagram that finds a UDP path, or None without a link.
        shared_streams: multiplexed streams, by transport and channel.
        udp: the UDP channels.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        log: Callable[[Level, EventCode, str], None],
        unfinished: Budget,
        send_receipts: Callable[[Receipts], None],
        way_back: Callable[[], float],
        ping: Callable[[], float],
        meter_of: Callable[[int], Meter | None],
    ) -> None:
        self.book: ReceiptBook | None = None
        self.keys: DataKeys | None = None
        self.probe: PathProbe | None = None
        self.shared_streams: dict[tuple[str, int], SharedStream] = {}
        self.udp = UdpChannels(loop, log)
        self._unfinished = unfinished
        self._loop = loop
        self._send_receipts = send_receipts
        self._way_back, self._ping = way_back, ping
        self._meter_of = meter_of

    def connected(self, keys: SessionKeys, role: Role, *, receipts: bool) -> None:
        """Begin a connection with its keys; `receipts` says whether both sides support them."""
        self.book = ReceiptBook(self._loop, self._send_receipts, self._way_back, self._ping) if receipts else None
        self.keys = DataKeys(keys, role, self._unfinished, meter_of=self._meter_of)
        self.probe = PathProbe(self.keys)

    def disconnected(self) -> None:
        """Forget the connection, which is over. Call it when no route uses a channel any more."""
        self.keys = self.probe = None
        if self.book is not None:
            self.book.close()
            self.book = None
        self.udp.close()
        self.shared_streams.clear()

    def attach(self, route: Route, stream: Stream, beginning: bytes, owner: SharedStreamOwner) -> None:
        """Use an accepted stream for a route.

        Args:
            route: to be carried.
            stream: opened for the route.
            beginning: bytes that arrived after the stream's preamble.
            owner: gets the preambles of further routes if the transport is multiplexed.
        """
        assert self.keys is not None
        handler: StreamHandler
        if route.transport.multiplexed:
            handler = shared = SharedStream(stream, owner, route.proposal.port, self._unfinished)
            self.shared_streams[route.transport.name, route.proposal.port] = shared
            route.channel = shared.carry(route, self.keys, self.book)
        else:
            handler = route.channel = stream_channel(stream, route, self.keys, self.book)
        if beginning:
            handler.received(beginning)
        route.advance()

    def handle_receipts(self, receipts: Receipts, open_route: Callable[[int], Route | None]) -> None:
        """Hand the peer's receipts and intervals to the channels."""
        for route_id, every in receipts.every:
            route = open_route(route_id)
            if route is not None and isinstance(route.channel, ReceiptSender):
                route.channel.set_interval(every)
        for route_id, received in receipts.received:
            route = open_route(route_id)
            if route is not None and isinstance(route.channel, WindowedSender):
                route.channel.acknowledge(received)

    def tick(self, routes: Iterable[Route]) -> None:
        """Send pending receipts, and close the windows of stalled channels. Called once a second."""
        self.udp.tick()
        if self.book is None:
            return
        for route in routes:
            channel = route.channel
            if isinstance(channel, ReceiptSender):
                channel.send_receipt()
            if isinstance(channel, WindowedSender):
                channel.check_window()

    def carriers(self, routes: Iterable[Route], control: ControlChannel | None) -> set[Carrier]:
        """Return all streams and UDP channels, including the control connection's."""
        carriers: set[Carrier] = {route.channel.carrier for route in routes if route.channel is not None}
        if control is not None:
            carriers.add(control.stream)
        return carriers.union(self.udp.all())

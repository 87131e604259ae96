"""The streams and UDP channels that carry the messages of a link's routes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, TypeAlias

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
    import asyncio
    from collections.abc import Callable, Iterator

    from rsb_bridge.channel.data_keys import Meter
    from rsb_bridge.channel.data_stream import DataStream, RouteNumbers
    from rsb_bridge.channel.udp_channel import BufferShortage, UdpChannel
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.model.transports import Ages
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.transport.transport import StreamTransport
    from rsb_bridge.wire.framing import Budget
    from rsb_bridge.wire.messages import Receipts
    from rsb_bridge.wire.sealing import Role, SessionKeys

_PROBE_EVERY, _QUICK_PROBES = 0.25, 8
"""s between the first probes of a channel, and how many: its topics wait for an answer, and `tick` comes once a second
only. Round figures: nothing was measured."""
ChannelCarrier: TypeAlias = "Stream | UdpChannel"
"""The stream or socket of one or several channels; counts wire bytes."""
CONTROL_NUMBER = 0
"""The number of the control connection where it is a data stream, too."""
_OUT_OF_ORDER = 1024
"""How far below the newest a stream's number may be (PROTOCOL.md, 1.3): the streams of several ports open at once, and
arrive in any order. Older numbers are refused, so none of them is remembered."""


class UdpChannels:
    """A link's UDP channels by port, probed and watched as long as they are open.

    Args:
        report: sends receipts of the link's streams.
        urgent: takes an urgent control message as it was encoded.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        log: Callable[[Level, EventCode, str], None],
        report: Callable[[], None],
        urgent: Callable[[bytes], None],
    ) -> None:
        self._loop = loop
        self._log = log
        self._report = report
        self._urgent = urgent
        self._channels: dict[int, UdpChannel] = {}
        self._shortages_told: set[bool] = set()

    def get(self, port: int) -> UdpChannel | None:
        """Return the open channel of a port."""
        # One whose last route has left is over at once, and stays in the table until the next tick.
        channel = self._channels.get(port)
        return channel if channel is not None and not channel.over else None

    def add(self, port: int, channel: UdpChannel) -> None:
        """Add a new channel."""
        self._channels[port] = channel
        channel.on_asked = self._report
        channel.on_urgent = self._urgent

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
                if here not in self._shortages_told:  # the remedy is the same for all channels of a machine
                    self._shortages_told.add(here)
                    self._log(Level.WARNING, EventCode.LINK_UDP_BUFFER, _shortage_message(here, shortage))

    def send_urgent(self, content: bytes) -> None:
        """Send a control message as it is encoded over all channels that have found their path."""
        for channel in self._channels.values():
            if channel.ready and not channel.over:
                channel.send_urgent(content)

    def close(self) -> None:
        """Close them all."""
        for channel in self._channels.values():
            channel.close()
        self._channels.clear()

    def all(self) -> list[UdpChannel]:
        """Return all channels."""
        return list(self._channels.values())


def _shortage_message(here: bool, shortage: BufferShortage) -> str:
    """Return the reason why large messages are slow, and the remedy, for an operator."""
    whose, where = ("this machine's", "here") if here else ("the other side's", "there")
    return (
        f"{whose} kernel buffers only {shortage.granted:,} bytes of UDP, and messages have {shortage.message:,}: they "
        f"come late, or are lost. Run {where}: sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER}"
    )


class DataChannels:
    """The streams and UDP channels that carry the messages of one link's routes.

    Args:
        unfinished: the budget for incomplete messages of the peer.
        way_back: gives the s that a message of the peer takes to get here.
        ping: gives the s of the connection's shortest ping, or 0 if it is unknown.
        meter_of: gives the meter of a route by its id, or None for a route that has none.
        urgent: takes an urgent control message as it was encoded.
        reopen: opens the streams of a transport and port again.

    Attributes:
        keys: to seal and open routes' messages, or None without a link.
        scheduler: shares the link's streams among its routes, or None without a link.
        probe: the datagram that finds a UDP path, or None without a link.
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
        routes: RouteNumbers,
        urgent: Callable[[bytes], None],
        reopen: Callable[[StreamTransport, int], None],
    ) -> None:
        self.keys: DataKeys | None = None
        self.scheduler: Scheduler | None = None
        self.probe: PathProbe | None = None
        self.udp = UdpChannels(loop, log, self._report, urgent)
        self._book: ReceiptBook | None = None
        self._pairs: dict[tuple[str, int], StreamPair] = {}
        self._newest = 0
        self._taken: set[int] = set()
        self._unfinished = unfinished
        self._loop = loop
        self._send_receipts = send_receipts
        self._way_back, self._ping = way_back, ping
        self._meter_of = meter_of
        self._routes = routes
        self._log = log
        self._reopen = reopen

    def connected(self, keys: SessionKeys, role: Role, ages: Ages) -> None:
        """Begin a connection with its keys."""
        self._book = ReceiptBook(self._loop, self._send_receipts, self._way_back, self._ping)
        self.scheduler = Scheduler(self._book, Window(ages))
        self.keys = DataKeys(keys, role, self._unfinished, meter_of=self._meter_of)
        self.probe = PathProbe(self.keys)
        self._newest = 0
        self._taken.clear()

    def disconnected(self) -> None:
        """Forget the connection, which is over. Call it when no route uses a channel any more."""
        for pair in self._pairs.values():
            if not pair.over:
                pair.end("the link is over")
        self._pairs.clear()
        self.udp.close()
        # After all streams and sockets, which leave both at their end.
        if self._book is not None and self.scheduler is not None:
            self._book.close()
            self.scheduler.close()
        self.keys = self.scheduler = self.probe = self._book = None

    # --- streams

    def use_control(self, stream: Stream, transport: StreamTransport, port: int) -> DataStream:
        """Have the control connection's stream carry the routes of its own port, as streams are scarce."""
        pair = self._pair(transport, port)
        return pair.add(stream, CONTROL_NUMBER, large=True, small=True)

    def next_name(self, port: int, *, large: bool) -> StreamName:
        """Return the name of a stream that this client opens next."""
        self._newest += 1
        return StreamName(self._newest, port, large)

    def is_new(self, name: StreamName) -> bool:
        """Whether a client may open a stream of that name now: none has had its number."""
        return max(0, self._newest - _OUT_OF_ORDER) < name.number and name.number not in self._taken

    def pair_of(self, transport: str, port: int) -> StreamPair | None:
        """Return the streams for routes with that port, or None if they are not both open."""
        pair = self._pairs.get((transport, port))
        return pair if pair is not None and pair.ready and not pair.over else None

    def carry(self, route: Route, pair: StreamPair) -> None:
        """Open the channel of a route on a pair of streams."""
        assert self.keys is not None
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
        added = pair.add(stream, name.number, large=name.large or both, small=both or not name.large)
        stream.handler = added
        if reason := pair.go_on():
            text = f"a data connection broke ({reason.text}) and was opened again; messages that were on it may be lost"
            self._log(Level.WARNING, EventCode.LINK_STREAM_REOPENED, text)
        if beginning and not added.over:
            added.received(beginning)

    def give_up(self, transport: str, port: int, reason: Reason) -> None:
        """Close the routes that wait for streams for that port in place of lost ones."""
        if (pair := self._pairs.get((transport, port))) is not None:
            pair.give_up(reason)

    def lacks(self, transport: str, port: int) -> tuple[bool, bool]:
        """Return whether the streams of small and of large messages for that port are not open."""
        pair = self._pairs.get((transport, port))
        return (True, True) if pair is None or pair.over else pair.lacks()

    def end_unused(self, transport: str, port: int) -> None:
        """Close the streams for routes with that port if none uses them: they hold descriptors that others need."""
        if (pair := self._pairs.get((transport, port))) is not None:
            pair.end_unused()

    def _pair(self, transport: StreamTransport, port: int) -> StreamPair:
        assert self.scheduler is not None
        assert self._book is not None
        assert self.keys is not None
        pair = self._pairs.get((transport.name, port))
        if pair is None or pair.over:
            reopen = partial(self._reopen, transport, port)
            pair = StreamPair(self._routes, self.scheduler, self._book, self.keys, reopen)
            self._pairs[transport.name, port] = pair
        return pair

    def _streams(self) -> Iterator[DataStream]:
        for pair in self._pairs.values():
            if not pair.over:
                yield from pair.streams()

    def handle_receipts(self, receipts: Receipts) -> None:
        """Hand the peer's receipts and intervals to the streams."""
        if self.scheduler is not None:
            take_receipts(receipts, self._streams(), self.scheduler)

    def tick(self, control_quiet: float) -> None:
        """Send pending receipts, and close the window of a stalled link. Called once a second.

        Args:
            control_quiet: s since the last byte on the control connection.
        """
        self.udp.tick()
        if self.scheduler is not None:
            self.scheduler.tick()
        self._report()
        for key, pair in tuple(self._pairs.items()):
            if pair.over:
                del self._pairs[key]
            else:
                pair.tick(control_quiet)

    def _report(self) -> None:
        if self._book is not None:
            self._book.report()

    def carriers(self, control: ControlChannel | None) -> set[ChannelCarrier]:
        """Return all streams and UDP channels, including the control connection's."""
        carriers: set[ChannelCarrier] = {each.stream for each in self._streams()}
        if control is not None:
            carriers.add(control.stream)
        return carriers.union(self.udp.all())

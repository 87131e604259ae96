"""Channels whose messages go as datagrams, over a UDP channel that they share."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.channel.channel import Counts
from rsb_bridge.transport.streams import BATCH_BYTES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.channel import RouteSink
    from rsb_bridge.channel.data_keys import DataKeys
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.wire.datagram import DatagramReader, DatagramWriter
    from rsb_bridge.wire.framing import Message

_EXPIRE = 1.0
"""s after which a message whose fragments did not all come is given up."""


class _DatagramChannel:
    """What both ends share.

    Attributes:
        carrier: the UDP channel.
    """

    def __init__(self, udp_channel: UdpChannel, route: RouteSink) -> None:
        self.carrier = udp_channel
        self._route = route
        self._route_id = route.id

    @property
    def ready(self) -> bool:
        return self.carrier.ready

    def trouble(self) -> str:
        return self.carrier.trouble

    def close(self, reason: str) -> None:
        self.carrier.remove(self._route_id)


class DatagramSender(_DatagramChannel):
    """The sending end."""

    batch_bytes = BATCH_BYTES

    def __init__(self, udp_channel: UdpChannel, route: RouteSink, codec: DatagramWriter) -> None:
        super().__init__(udp_channel, route)
        self._codec = codec
        udp_channel.add_sender(route.id, route.flush)

    @property
    def congested(self) -> bool:
        return self.carrier.socket.congested

    def datagrams(self, size: int) -> int:
        """How many datagrams a message of `size` bytes takes now; only once it is ready."""
        return self._codec.datagrams(size, self.carrier.datagram_size())

    def send(self, batch: Sequence[Message]) -> None:
        size = self.carrier.datagram_size()
        for payload, stamp, flags in batch:
            self.carrier.send(self._codec.write(payload, stamp, flags, size))


class DatagramReceiver(_DatagramChannel):
    """The receiving end."""

    def __init__(self, udp_channel: UdpChannel, route: RouteSink, codec: DatagramReader) -> None:
        super().__init__(udp_channel, route)
        self._codec = codec
        self._whole: list[Message] = []
        udp_channel.add_receiver(route.id, self)

    def counts(self) -> Counts | None:
        return Counts(self._codec.newest, self._codec.pending, self._codec.expired)

    def close(self, reason: str) -> None:
        self._codec.close()
        super().close(reason)

    def received(self, datagram: bytes, now: float) -> bool:
        """As `DatagramSink.received`."""
        message = self._codec.receive(datagram, now)
        if message is None:
            return False
        self._whole.append(message)
        return True

    def hand_over(self) -> None:
        """Deliver the messages that are whole."""
        whole, self._whole = self._whole, []
        if whole:
            self._route.deliver(whole)

    def expire(self, now: float) -> None:
        """Give up messages whose fragments did not come in time."""
        self._codec.expire(now, _EXPIRE)


def datagram_channel(udp_channel: UdpChannel, route: RouteSink, keys: DataKeys) -> DatagramSender | DatagramReceiver:
    """This side's end of a route's channel on a UDP channel."""
    if route.outgoing:
        return DatagramSender(udp_channel, route, keys.datagram_writer(route.id))
    return DatagramReceiver(udp_channel, route, keys.datagram_reader(route.id))

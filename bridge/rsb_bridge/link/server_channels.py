"""The server's end of a link's connections: its client opens the streams, and sends the first datagrams."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.channel.udp_channel import ServerUdpChannel
from rsb_bridge.link.data_channels import DataChannels
from rsb_bridge.transport.transport import StreamTransport
from rsb_bridge.wire.events import RefusalCode
from rsb_bridge.wire.preamble import Refusal
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.link.link import Link
    from rsb_bridge.link.topic_ports import DescriptorShare
    from rsb_bridge.transport.streams import Address, Stream
    from rsb_bridge.transport.transport import DatagramSocket
    from rsb_bridge.wire.connection import ServerConnection
    from rsb_bridge.wire.events import Attach
    from rsb_bridge.wire.sealing import ConnectionKeys

_OUT_OF_ORDER = 1024
"""How far below the newest a stream's number may be (PROTOCOL.md, 1.3): the streams of several ports open at once, and
arrive in any order. Older numbers are refused, so none of them is remembered."""
UNKNOWN_ROUTE = "unknown route"  # the same for all, so that a stranger does not learn which links exist


class ServerChannels(DataChannels):
    """The server's end of one connection."""

    _link: Link

    def __init__(self, link: Link, descriptors: DescriptorShare, control: ControlChannel, keys: ConnectionKeys) -> None:
        super().__init__(link, control, keys)
        self._descriptors = descriptors
        self._taken: set[int] = set()  # numbers of streams

    @property
    def streams_awaited(self) -> int:
        """Number of permitted streams that the client has yet to open."""
        waiting = (transport for (transport, _), waits in self._stream_users().items() if waits)
        awaited = sum(1 if transport.multiplexed else 2 for transport in waiting)
        # The room costs a call of the kernel.
        return min(awaited, max(0, self._descriptors.room)) if awaited else 0

    def _stream_users(self) -> dict[tuple[StreamTransport, int], bool]:
        """Return the transports and ports of routes over streams, and whether one of these waits for them."""
        users = {
            (route.transport, route.proposal.port or self._link.shared_port())
            for route in self.ids.open_routes()
            if isinstance(route.transport, StreamTransport)
        }
        return {(each, port): self.pair_of(each.name, port) is None for each, port in users}

    def accept(self, stream: Stream, connection: ServerConnection, event: Attach) -> None:
        """Attach a stream that the client opens; raise Refusal if no route needs it, or it may not have it."""
        link, name = self._link, event.name
        # Before any refusal: on a data stream a server tags everything (PROTOCOL.md, 12).
        stream.authenticate(self.connection_keys.sample_secret, opener=False)
        try:
            self.connection_keys.check_attach_proof(event.header, name.number, event.proof)
        except SealError as error:
            raise Refusal(RefusalCode.NO_SUCH_ROUTE, str(error)) from None
        shared = link.shared_port()
        port = name.port or shared
        is_own = not name.port  # a channel of another transport may have the number of the link's own port
        # Of routes that have their streams, too: the client may have lost one, and the kernel here not know that yet.
        fitting = [
            (transport, waits)
            for (transport, at), waits in self._stream_users().items()
            if at == port and (port != shared or is_own == (transport is link.transport))
        ]
        is_new = max(0, self._newest - _OUT_OF_ORDER) < name.number and name.number not in self._taken
        if not fitting or not is_new:
            raise Refusal(RefusalCode.NO_SUCH_ROUTE, UNKNOWN_ROUTE, link.name)
        # Several transports may have the port: the choice must not depend on the order of the routes.
        transport, _ = min(fitting, key=lambda each: (not each[1], each[0] is not link.transport, each[0].name))
        if refusal := self._descriptors.refusal:
            raise Refusal(RefusalCode.BUSY, refusal, link.name)
        self._newest = max(self._newest, name.number)
        self._taken.add(name.number)
        if len(self._taken) > 2 * _OUT_OF_ORDER:  # twice as many: it is rebuilt once in a thousand streams
            self._taken = {each for each in self._taken if each > self._newest - _OUT_OF_ORDER}
        stream.when_gone = self._descriptors.take()
        stream.write(connection.accept_attach())
        self.attach(stream, name, transport, port, connection.leftover())
        link.spawn(self.streams_opened(transport.name, port))

    def new_udp_channel(self, socket: DatagramSocket, address: Address) -> ServerUdpChannel | None:
        """Open a UDP channel on the socket and from the address of its first datagram, or return None.

        A datagram of the other IP version is ignored: a forged one must not take over the UDP channel.
        """
        stream = self.control.stream
        if len(address) != len(stream.address):
            return None
        channel = self._udp[socket.port] = ServerUdpChannel(self, socket, stream.own_address)
        # The client may send messages together with its answer to the first challenge: routes have to take them then.
        self.udp_ready()
        return channel

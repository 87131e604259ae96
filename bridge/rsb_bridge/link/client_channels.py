"""The client's end of a link's connections: it opens the streams and sockets."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.channel.udp_channel import ClientUdpChannel
from rsb_bridge.link.connecting import Failure
from rsb_bridge.link.data_channels import DataChannels
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.snapshot import Level
from rsb_bridge.transport import descriptors
from rsb_bridge.transport.streams import Stream, StreamProblem, os_error_message
from rsb_bridge.wire.connection import DataConnection
from rsb_bridge.wire.events import Accepted, Established, Event, StreamName

if TYPE_CHECKING:
    from rsb_bridge.link.connecting import LetIn
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.link.data_channels import CarriedLink
    from rsb_bridge.transport.transport import DatagramTransport, StreamTransport
    from rsb_bridge.wire.sealing import ConnectionKeys

_ROUNDS = 3  # times that data streams are opened if others are lost meanwhile: a round figure
_UDP_RETRIED_AFTER = 1.0  # s until a socket for datagrams is tried again: its topics wait as long. A round figure


class StreamDialer(Protocol):
    """The members of a client's end (`rsb_bridge.link.client_end.ClientEnd`) that its connections use."""

    udp_failure: str

    async def open(
        self,
        transport: StreamTransport,
        host: str,
        port: int,
        connection: DataConnection,
        let_in: LetIn,
        rank: int | None = None,
        sample_secret: bytes | None = None,
    ) -> Failure | None: ...


class ClientChannels(DataChannels):
    """The client's end of a connection, which opens the streams and sockets."""

    def __init__(self, link: CarriedLink, dialer: StreamDialer, control: ControlChannel, keys: ConnectionKeys) -> None:
        super().__init__(link, control, keys)
        self._dialer = dialer
        self._opening: dict[tuple[str, int], asyncio.Task[None]] = {}
        self._wanted = 0  # streams that these tasks open, and that have their descriptors yet to take
        self._udp_retry: asyncio.TimerHandle | None = None

    def close(self) -> None:
        super().close()
        self._give_up_opening()

    def suspend(self, reason: str) -> None:
        self._give_up_opening()  # first: a pair that loses its streams asks for new ones
        super().suspend(reason)

    def _give_up_opening(self) -> None:
        for opening in self._opening.values():
            opening.cancel()
        self._opening = {}
        if self._udp_retry is not None:
            self._udp_retry.cancel()
            self._udp_retry = None

    def open_streams(self, transport: StreamTransport, port: int) -> None:
        if (transport.name, port) not in self._opening:
            self._opening[transport.name, port] = self._link.spawn(self._open_lacking(transport, port))

    async def _open_lacking(self, transport: StreamTransport, port: int) -> None:
        """Open the streams that are lacking, and let the waiting routes use them."""
        key = transport.name, port
        failure: Failure | None = None
        try:
            # A firewall that has forgotten one connection has mostly forgotten the other one, too, and that may show a
            # little later.
            for _ in range(_ROUNDS):
                pair = self._pairs.get(key)
                lacks = (True, True) if pair is None or pair.over else pair.lacks()
                wanted = [large for large in ((True,) if transport.multiplexed else (False, True)) if lacks[large]]
                if not wanted or (failure := await self._open_each(transport, port, wanted)) is not None:
                    break
        finally:
            if self._opening.get(key) is asyncio.current_task():  # else the link was suspended meanwhile
                del self._opening[key]
        if failure is None and self.pair_of(*key) is None:
            failure = Failure(StreamProblem.CLOSED_HERE())
        if failure is None:
            await self.streams_opened(*key)
        else:
            reason = Reason(failure.reason, EndCode.BROKE)
            for route in self._take_awaiting(*key):
                route.channel_lost(reason)
            if key in self._pairs:
                self._pairs[key].failed(reason)
        # Where descriptors are scarce, halves of pairs would be all that there is, and no route would have both.
        if key in self._pairs:
            self._pairs[key].end_unused()

    async def _open_each(self, transport: StreamTransport, port: int, wanted: list[bool]) -> Failure | None:
        """Open the wanted streams, by whether they are for large messages. The small one comes first."""
        # Where all topics open their first streams before any opens its second one, none may get that.
        if descriptors.left() < self._wanted + len(wanted):
            return Failure(descriptors.scarcity_message("client"))
        self._wanted += len(wanted)
        try:
            while wanted:
                if (failure := await self._open_stream(transport, port, large=wanted[0])) is not None:
                    return failure
                del wanted[0]
                self._wanted -= 1
        finally:
            self._wanted -= len(wanted)
        return None

    async def _open_stream(self, transport: StreamTransport, port: int, *, large: bool) -> Failure | None:
        if descriptors.scarce():  # again: the handshake of the first stream may have taken seconds
            return Failure(descriptors.scarcity_message("client"))
        link, control = self._link, self.control
        self._newest += 1
        # Channel 11 is not port 11: the link's own streams are on its own transport only.
        is_own = transport is link.transport and port == link.shared_port()
        name = StreamName(self._newest, 0 if is_own else port, large)
        connection = DataConnection(self.connection_keys, name)

        def let_in(stream: Stream, event: Established | Accepted, more: list[Event]) -> None:
            if control.over:  # lost in this turn of the loop; the attempt is cancelled in the next one
                stream.abort("the link was lost")
            else:
                self.attach(stream, name, transport, port, connection.leftover())

        # The address that the control connection reached: the server's name may resolve to another by now.
        host = control.stream.host if transport is link.transport else transport.host(link.context.session)
        # Ranks as of topics: over some transports, small messages go ahead of large ones.
        rank = -1 if large and not transport.multiplexed else 0
        secret = self.connection_keys.sample_secret
        return await self._dialer.open(transport, host, port, connection, let_in, rank, secret)

    def _open_udp(self, transport: DatagramTransport, port: int) -> ClientUdpChannel | None:
        link, address = self._link, self.control.stream.address
        server = (address[0], port, *address[2:])  # with flow and scope, without which no link-local one is reached
        failure = ""
        if descriptors.scarce():
            failure = descriptors.scarcity_message("client")
        else:
            try:
                channel = ClientUdpChannel(self, transport, server)
            except OSError as error:
                failure = f"UDP to {transport.format_address(server)}: {os_error_message(error)}"
        if failure and failure != self._dialer.udp_failure:  # it is tried each second; one event is enough
            link.log_of_peer(Level.ERROR, EventCode.LINK_UDP_BLOCKED, failure)
        self._dialer.udp_failure = failure
        if failure:
            self._udp_retry = self._udp_retry or link.context.loop.call_later(_UDP_RETRIED_AFTER, self._retry_udp)
            return None
        self._udp[port] = channel
        self._probe(channel)
        return channel

    def _retry_udp(self) -> None:
        self._udp_retry = None
        self.udp_ready()

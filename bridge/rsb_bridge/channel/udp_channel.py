"""A connection's datagrams on one UDP socket: probes that find the path, and the routes that share it.

A datagram's route is found in two steps: by socket and link id (`UdpDemultiplexer`; on a client the socket
is the channel's own), and by route id (`UdpChannel`).
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, NamedTuple, Protocol

from rsb_bridge.channel.datagram_carrier import DatagramCarrier
from rsb_bridge.model.wording import Wording
from rsb_bridge.transport.transport import RECEIVE_BUFFER
from rsb_bridge.wire.datagram import DatagramReader, Probe, Receipt, Urgent, by_addressee, receipts, unpack_probe
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.sealing import PROBE_ROUTE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.channel.data_keys import DataKeys
    from rsb_bridge.channel.scheduler import Scheduler
    from rsb_bridge.channel.window import ReceiptBook
    from rsb_bridge.transport.streams import Address
    from rsb_bridge.transport.transport import Datagrams, DatagramSocket, DatagramTransport, SendPath
    from rsb_bridge.wire.datagram import Arrived, OfProbeRoute
    from rsb_bridge.wire.sealing import Buffer

# s; more than a whole link may be silent (`keepalive.DEAD_AFTER`), or a firewall would be blamed for a cut cable.
_SILENT = 6.0
# How often an urgent message is sent, and a command of an armed topic that is one datagram: a link that loses every
# third one then loses every eleventh command, and robots stand still after two or three. The receiver opens one.
TIMES = 2
# s, and addresses of one client: it has one, unless its network changes, or somebody delivers its probes.
_CHALLENGED_FOR, _MOST_CHALLENGED = 10.0, 4


class PathProbe:
    """Seals and opens the probes of one connection, over all its UDP channels: one key, one sequence each way.

    Attributes:
        link_id: the connection's, in every datagram.
    """

    def __init__(self, keys: DataKeys) -> None:
        self.link_id = keys.keys.link_id
        self._writer = keys.datagram_writer(PROBE_ROUTE)
        self._reader = keys.datagram_reader(PROBE_ROUTE, DatagramReader)

    def write(self, probe: OfProbeRoute, size: int) -> list[bytes]:
        """Return the probe, receipt or urgent message as datagrams of at most `size` bytes."""
        return self._writer.write(probe.pack(), 0, 0, size)

    def read(self, datagram: Buffer, now: float) -> OfProbeRoute | None:
        """Return what a datagram contains, or None if it is forged, replayed or none of these."""
        message = self._reader.receive(datagram, now)
        if message is None:
            return None
        try:
            return unpack_probe(message[0])
        except ProtocolError:
            return None

    def expire(self, now: float) -> None:
        """Give up messages whose fragments did not come in time."""
        self._reader.expire(now)

    def forget(self) -> None:
        """Give up all messages that are incomplete: none of an honest peer's is cut."""
        self._reader.close()


class Silence(Wording):
    """Silences of a UDP channel, by what may cause them."""

    NO_ANSWER = "no answer from UDP port {port} of {host}: does a firewall drop it?"
    NOTHING_MORE = "nothing more from UDP port {port} of {host}"
    NOTHING_THROUGH_ROUTERS = (
        "no datagram comes through the routers: are they congested, or does their access control forbid them?"
    )


class _Challenge(NamedTuple):
    opaque: int
    since: float


class BufferShortage(NamedTuple):
    """A kernel's receive buffer is smaller than a topic's messages need.

    Attributes:
        granted: bytes that the kernel grants.
        message: bytes of the message that showed it.
    """

    granted: int
    message: int


class DatagramSink(Protocol):
    """The receiving end of a route's channel."""

    def received(self, datagrams: Sequence[Buffer], now: float) -> bool:
        """Take datagrams of the route; return whether they completed a message, which is authentic then."""

    def news(self) -> Arrived | None:
        """Return the route's part of a receipt, or None if nothing came since the last one."""

    def expire(self, now: float) -> None: ...


class UdpOwner(Protocol):
    """The connection that UDP channels belong to."""

    scheduler: Scheduler
    book: ReceiptBook
    probe: PathProbe

    @property
    def now(self) -> Callable[[], float]: ...

    def udp_ready(self) -> None:
        """Use a channel that has just found its path."""

    def take_urgent(self, content: bytes) -> None:
        """Take a control message, as it was encoded, that came as a datagram."""


class UdpChannel(ABC):
    """One end of a UDP channel: the parts that client and server share.

    Attributes:
        ready: whether datagrams are known to get through.
        over: whether it is closed or its last route has left: the next route needs another UDP channel.
        trouble: the reason why no datagrams arrive, for an operator, or an empty string.
        received_at: time (s) of the last authentic datagram, or of the channel's start.
        on_close: called at its end, or None.
        receivers: receiving ends of its routes, by the route's id; the carrier has the sending ends.
        shortages: shortages of receive buffers; the key is whether this side lacks the memory.
        receive_buffer: bytes that the kernel grants of this socket's receive buffer, as of the last second.
    """

    def __init__(self, owner: UdpOwner, socket: DatagramSocket) -> None:
        self.socket = socket
        self.ready = False
        self.over = False
        self.trouble = ""
        self.received_bytes = self.sent_bytes = 0
        self.on_close: Callable[[], object] | None = None
        self.receivers: dict[int, DatagramSink] = {}
        self.shortages: dict[bool, BufferShortage] = {}
        self.receive_buffer = socket.receive_buffer
        self._owner = owner
        self._probe = owner.probe
        self._now = owner.now
        self._peer: Address | None = None
        self._path: SendPath | None = None
        self.received_at = self._heard_at = self._now()  # the second one of the peer's own address only
        self._carrier: DatagramCarrier | None = None

    def sending(self) -> DatagramCarrier:
        """Return the carrier of what is sent on this channel; from the first call on it takes part in turns."""
        if self._carrier is None:
            self._carrier = DatagramCarrier(self, self._owner.scheduler)
        return self._carrier

    def remove(self, route_id: int) -> None:
        """Remove a route; the last one closes the UDP channel."""
        self.receivers.pop(route_id, None)
        if self._carrier is not None:
            self._carrier.senders.pop(route_id, None)
        if self.is_unused:
            self.close()

    @property
    def is_unused(self) -> bool:
        return not self.receivers and (self._carrier is None or not self._carrier.senders)

    def send(self, datagrams: Sequence[bytes]) -> None:
        """Send datagrams; nothing happens while the peer's address is not known."""
        if self._peer is not None:
            self.sent_bytes += sum(map(len, datagrams))
            self.socket.send(datagrams, self._path)

    def datagram_size(self) -> int:
        """Return the bytes that one datagram to the peer may have."""
        assert self._peer is not None, "a UDP channel sends only once it is ready"
        return self.socket.datagram_size(self._peer)

    def asked(self) -> None:
        """Send a receipt: the peer has asked for one."""
        self.send_receipts()
        self._owner.book.report()

    def send_receipts(self) -> None:
        """Say what has come of all routes since the last receipt."""
        if self._peer is None:
            return
        news = [each for receiver in self.receivers.values() if (each := receiver.news()) is not None]
        if news:
            at = int(self.socket.arrived_at() * 1e6)
            for receipt in receipts(self.receive_buffer, at, news):
                self.send(self._probe.write(receipt, self.datagram_size()))

    def send_urgent(self, content: bytes) -> None:
        """Send a control message as `rsb_bridge.wire.codec` encodes it; nothing happens without the peer's address."""
        if self._peer is not None:
            self.send(self._probe.write(Urgent(content), self.datagram_size()) * TIMES)

    def received(self, route_id: int, datagrams: Sequence[Buffer], address: Address) -> None:
        """Take datagrams of one route that name this connection, and came together from one address."""
        now = self._now()
        self.received_bytes += sum(map(len, datagrams))
        receiver = self.receivers.get(route_id)
        if receiver is not None:
            if receiver.received(datagrams, now):
                self._heard_authentic(address, now)
        elif route_id == PROBE_ROUTE:
            self._received_probes(datagrams, address, now)
        # else the route was closed before the datagrams arrived, or the peer may not send on it

    def _received_probes(self, datagrams: Sequence[Buffer], address: Address, now: float) -> None:
        was_ready = self.ready
        for datagram in datagrams:
            probe = self._probe.read(datagram, now)
            if isinstance(probe, Receipt):
                self._heard_authentic(address, now)
                if self._carrier is not None:
                    self._carrier.receipt(probe)
            elif isinstance(probe, Urgent):
                self._heard_authentic(address, now)
                self._owner.take_urgent(probe.content)
            elif probe is not None and self._probed(probe, address):
                self._heard_at = self.received_at = now
                self.ready = True
        if self.ready and not was_ready:
            self._owner.udp_ready()

    def _heard_authentic(self, address: Address, now: float) -> None:
        """Note a message or a receipt; from the peer's own address it counts as a probe, which a full link may lose."""
        self.received_at = now
        if self.ready and address == self._peer:
            self._heard_at = now

    @abstractmethod
    def _probed(self, probe: Probe, address: Address) -> bool:
        """Take an authentic probe; return whether it came from the peer's own address."""

    @abstractmethod
    def _silence(self) -> str:
        """Return the reason why nothing is heard of the peer."""

    def tick(self) -> None:
        """Judge the peer's silence, and give up messages whose fragments did not come. Called once a second."""
        now = self._now()
        self.trouble = self._silence() if now - self._heard_at > _SILENT else ""
        if self.receive_buffer < RECEIVE_BUFFER:
            self.receive_buffer = self.socket.receive_buffer  # its limit may have been raised
        self._probe.expire(now)
        for receiver in self.receivers.values():
            receiver.expire(now)
        self.send_receipts()
        if self._carrier is not None:
            self._carrier.tick()

    def close(self) -> None:
        """Free what is its own. May be called twice."""
        if not self.over:
            self.over = True
            if self._carrier is not None:
                self._carrier.close()
            self._probe.forget()
            if self.on_close is not None:
                self.on_close()


class ClientUdpChannel(UdpChannel):
    """A client's: it owns a socket that is connected to the server, and probes."""

    def __init__(self, owner: UdpOwner, transport: DatagramTransport, server: Address) -> None:
        """Connect, and send the first probe.

        Raises:
            OSError: there is no way to the server.
        """
        super().__init__(owner, transport.connect(server, self._arrived))
        self._peer = server
        self.tick()

    def _arrived(self, socket: DatagramSocket, datagrams: Datagrams) -> None:
        for (route_id, link_id, address), its in by_addressee(datagrams).items():
            if link_id == self._probe.link_id:
                self.received(route_id, its, address)

    def tick(self) -> None:
        super().tick()
        self.send(self._probe.write(Probe(pong=False, opaque=0), self.datagram_size()))

    def _probed(self, probe: Probe, address: Address) -> bool:
        if not probe.pong:  # the server asks whether this address is ours
            self.send(self._probe.write(Probe(pong=True, opaque=probe.opaque), self.datagram_size()))
        return True

    def _silence(self) -> str:
        assert self._peer is not None
        if not self.socket.port:  # a network of routers has none
            return Silence.NOTHING_THROUGH_ROUTERS()
        return Silence.NO_ANSWER(port=self._peer[1], host=self._peer[0])

    def close(self) -> None:
        if not self.over:
            super().close()
            self.socket.close()


class ServerUdpChannel(UdpChannel):
    """A server's channel, which shares a bound socket and answers probes.

    It sends to the address that answered its newest challenge (NAT, roaming), as long as probes come from there, and
    from the address that the client calls, even if the server has others. A probe alone proves nothing about its
    origin: an attacker may have captured it and delivered it first.
    """

    def __init__(self, owner: UdpOwner, socket: DatagramSocket, source: str) -> None:
        """Begin; `source` is the address that the client calls."""
        super().__init__(owner, socket)
        self._source = source
        self._challenges: dict[Address, _Challenge] = {}  # the oldest first

    def send(self, datagrams: Sequence[bytes]) -> None:
        if self.ready and self._now() - self._heard_at <= _SILENT:  # else somebody else may have the address
            super().send(datagrams)

    def _probed(self, probe: Probe, address: Address) -> bool:
        if probe.pong:
            challenge = self._challenges.get(address)
            if challenge is None or challenge.opaque != probe.opaque:
                return False
            self._challenges.clear()  # a later pong from an address that the client has left must not lead back to it
            self._peer, self._path = address, self.socket.path(self._source, address)
            return True
        if address == self._peer:  # it has answered a challenge already
            self._answer(address, Probe(pong=True, opaque=probe.opaque))
            return True
        self._answer(address, Probe(pong=False, opaque=self._challenge(address)))
        return False

    def _challenge(self, address: Address) -> int:
        """Return the challenge for an address. It stays for a while: a round trip may take longer than 1 s."""
        now = self._now()
        challenge = self._challenges.get(address)
        if challenge is None or now - challenge.since > _CHALLENGED_FOR:
            self._challenges.pop(address, None)
            if len(self._challenges) >= _MOST_CHALLENGED:  # a captured probe can come from any number of addresses
                del self._challenges[next(iter(self._challenges))]
            challenge = self._challenges[address] = _Challenge(int.from_bytes(os.urandom(8)), now)
        return challenge.opaque

    def _answer(self, address: Address, probe: Probe) -> None:
        """Send one datagram where one came from: it is no longer than that one."""
        datagrams = self._probe.write(probe, self.socket.datagram_size(address))
        self.sent_bytes += sum(map(len, datagrams))
        # Not by `send`, which knows only the address that has answered.
        self.socket.send(datagrams, self.socket.path(self._source, address))

    def _silence(self) -> str:
        if not self.socket.port:
            return Silence.NOTHING_THROUGH_ROUTERS()
        if self._peer is None:
            return "no UDP from the client: does a firewall drop it?"
        return Silence.NOTHING_MORE(port=self._peer[1], host=self._peer[0])


class UdpServer(Protocol):
    """The server whose connections have UDP channels."""

    def new_udp_channel(self, link_id: bytes, socket: DatagramSocket, address: Address) -> ServerUdpChannel | None:
        """Make the UDP channel of a connection; `address` is the source of its first datagram.

        Returns:
            None if there is no such connection, or it may not use that socket.
        """


class UdpDemultiplexer:
    """Hands the datagrams of a server's sockets to the UDP channels of the connections that they name."""

    def __init__(self, server: UdpServer) -> None:
        self._server = server
        self._channels: dict[tuple[DatagramSocket, bytes], ServerUdpChannel] = {}

    def received(self, socket: DatagramSocket, datagrams: Datagrams) -> None:
        """Take what one wake-up of a socket brought."""
        for (route_id, link_id, address), its in by_addressee(datagrams).items():
            channel = self._channels.get((socket, link_id)) or self._begin(socket, link_id, address)
            if channel is not None:
                channel.received(route_id, its, address)

    def _begin(self, socket: DatagramSocket, link_id: bytes, address: Address) -> ServerUdpChannel | None:
        channel = self._server.new_udp_channel(link_id, socket, address)
        if channel is not None:
            self._channels[socket, link_id] = channel
            channel.on_close = lambda: self._channels.pop((socket, link_id), None)
        return channel

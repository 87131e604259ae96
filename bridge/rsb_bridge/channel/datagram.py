"""A link's datagrams: probes that find the way through a UDP socket, and the routes that share it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.channel.channel import Counts
from rsb_bridge.transport.streams import BATCH_BYTES
from rsb_bridge.wire.datagram import PROBE_ROUTE, DatagramReader, DatagramWriter, Probe
from rsb_bridge.wire.framing import ProtocolError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.link.link import Link
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.streams import Address
    from rsb_bridge.transport.transport import DatagramSocket, SendPath
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.sealing import Role, SessionKeys

_SILENT = 6.0
"""s; more than a whole link may be silent (`keepalive.DEAD_AFTER`), or a firewall would be blamed for a cut cable."""
_EXPIRE = 1.0


class PathProbe:
    """Probes of one connection, over all its lanes: one key, one sequence each way."""

    def __init__(self, keys: SessionKeys, side: Role, other_side: Role) -> None:
        self._writer = DatagramWriter(keys.route_sealer(PROBE_ROUTE, side), keys.link_id, PROBE_ROUTE)
        self._reader = DatagramReader(keys.datagram_opener(PROBE_ROUTE, other_side), PROBE_ROUTE)

    def write(self, probe: Probe, size: int) -> list[bytes]:
        """The probe as datagrams."""
        return self._writer.write(probe.pack(), 0, 0, size)

    def read(self, datagram: bytes, now: float) -> Probe | None:
        """The probe in a datagram; None: forged, replayed, older than one that came before it, or none at all."""
        newest = self._reader.newest
        message = self._reader.receive(datagram, now)
        if message is None or self._reader.newest == newest:
            return None
        try:
            return Probe.unpack(message[0])
        except ProtocolError:
            return None


class UdpChannel:
    """One connection on one UDP socket.

    The client probes; the server sends to wherever the newest authentic probe came from (NAT, roaming), and from the
    address that the client calls, whichever else it has.

    Attributes:
        socket: a client's own, connected; a server's is shared by all its links.
        over: its last route has left, or it was closed: the next one needs another.
        trouble: nothing comes from the peer: so in words; else empty.
        received_bytes: so far.
        sent_bytes: so far.
    """

    def __init__(
        self, socket: DatagramSocket, path_probe: PathProbe, *, server: Address | None = None, own: str = ""
    ) -> None:
        """Begin.

        Args:
            socket: to use.
            path_probe: the connection's.
            server: on a client, whom to probe.
            own: on a server, its address that the client calls.
        """
        self.socket = socket
        self.over = False
        self.received_bytes = 0
        self.sent_bytes = 0
        self.trouble = ""
        self._path_probe = path_probe
        self._is_client = server is not None
        self._address = server
        self._own = own
        self._send_path: SendPath | None = None
        self._heard: float | None = None
        self._asked: float | None = None
        self._paths: dict[int, DatagramChannel] = {}

    @property
    def ready(self) -> bool:
        """Whether datagrams are known to get through."""
        return self._heard is not None

    def add(self, route_id: int, path: DatagramChannel) -> None:
        """Let a route's datagrams through."""
        self._paths[route_id] = path
        self.socket.when_writable.add(path.writable)

    def remove(self, route_id: int) -> None:
        """Let them through no more."""
        path = self._paths.pop(route_id, None)
        if path is not None:
            self.socket.when_writable.discard(path.writable)
        if not self._paths:
            self.close()

    def send(self, datagrams: list[bytes]) -> None:
        """Send one message's datagrams."""
        if self._address is not None:
            self.sent_bytes += sum([len(datagram) for datagram in datagrams])
            self.socket.send(datagrams, self._send_path)

    def datagram_size(self) -> int:
        """Bytes that one datagram to the peer may have."""
        assert self._address is not None, "a UDP channel sends only once it is ready"
        return self.socket.datagram_size(self._address)

    def received(self, datagrams: Iterable[tuple[int, bytes, Address]], now: float) -> bool:
        """Take datagrams of this connection, each with its route id.

        Returns:
            Whether they made the channel ready.
        """
        touched: dict[DatagramChannel, None] = {}
        was_ready = self.ready
        for route_id, datagram, address in datagrams:
            self.received_bytes += len(datagram)
            path = self._paths.get(route_id)
            if path is not None:
                path.received(datagram, now)
                touched[path] = None
            elif route_id == PROBE_ROUTE:
                self._probed(datagram, address, now)
            # else its route was closed while the datagram was under way
        for path in touched:
            path.hand_over()
        return self.ready and not was_ready

    def _probed(self, datagram: bytes, address: Address, now: float) -> None:
        probe = self._path_probe.read(datagram, now)
        if probe is None:
            return
        self._heard = now
        if not probe.pong and not self._is_client:
            self._address, self._send_path = address, self.socket.path(self._own, address)
            self.send(self._path_probe.write(Probe(pong=True, opaque=probe.opaque), self.datagram_size()))

    def tick(self, now: float) -> None:
        """As often as wanted: ask the server whether it hears us, give up messages whose fragments did not come."""
        self._asked = self._asked if self._asked is not None else now
        quiet = now - (self._heard if self._heard is not None else self._asked)
        self.trouble = self._silence() if quiet > _SILENT else ""
        if self._is_client:
            self.send(self._path_probe.write(Probe(pong=False, opaque=0), self.datagram_size()))
        for path in self._paths.values():
            path.expire(now)

    def _silence(self) -> str:
        if self._address is None:
            return "no UDP from the client: does a firewall drop it?"
        where = f"UDP port {self._address[1]} of {self._address[0]}"
        return f"no answer from {where}: does a firewall drop it?" if self._is_client else f"nothing more from {where}"

    def close(self) -> None:
        """Free what is the UDP channel's own: a client's socket. May be called twice."""
        if self._is_client and not self.over:
            self.socket.close()
        self.over = True


class DatagramChannel:
    """A route's share of a UDP channel."""

    def __init__(self, udp_channel: UdpChannel, route: Route, end: DatagramWriter | DatagramReader) -> None:
        self._udp_channel = udp_channel
        self._route = route
        self._route_id = route.id
        self._end = end
        self._whole: list[Message] = []
        udp_channel.add(route.id, self)

    @property
    def ready(self) -> bool:
        return self._udp_channel.ready

    @property
    def congested(self) -> bool:
        return self._udp_channel.socket.congested

    @property
    def batch_bytes(self) -> int:
        return BATCH_BYTES

    def send(self, batch: Sequence[Message]) -> None:
        assert isinstance(self._end, DatagramWriter)
        size = self._udp_channel.datagram_size()
        for payload, stamp, flags in batch:
            self._udp_channel.send(self._end.write(payload, stamp, flags, size))

    def trouble(self) -> str:
        return self._udp_channel.trouble

    def counts(self) -> Counts | None:
        if isinstance(self._end, DatagramReader):
            return Counts(self._end.newest, self._end.pending, self._end.expired)
        return None

    def close(self, reason: str) -> None:
        if isinstance(self._end, DatagramReader):
            self._end.close()
        self._udp_channel.remove(self._route_id)

    def received(self, datagram: bytes, now: float) -> None:
        """A datagram of this route came."""
        if not isinstance(self._end, DatagramReader):
            return  # the peer has no business here; the sender's key would not open it anyway
        message = self._end.receive(datagram, now)
        if message is not None:
            self._whole.append(message)

    def hand_over(self) -> None:
        """Give the route the messages that have become whole."""
        whole, self._whole = self._whole, []
        if whole:
            self._route.deliver(whole)

    def expire(self, now: float) -> None:
        """Give up messages whose fragments did not come within a second."""
        if isinstance(self._end, DatagramReader):
            self._end.expire(now, _EXPIRE)

    def writable(self) -> None:
        """The socket takes more again."""
        self._route.flush()


def datagram_codec(link: Link, route: Route) -> DatagramWriter | DatagramReader:
    """The same for its datagrams."""
    assert link.keys is not None
    if route.outgoing:
        return DatagramWriter(link.keys.route_sealer(route.id, link.side), link.keys.link_id, route.id)
    return DatagramReader(link.keys.datagram_opener(route.id, link.other_side), route.id, budget=link.unfinished)

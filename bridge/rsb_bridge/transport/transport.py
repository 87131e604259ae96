"""The interface between links and their transports: TCP, UDP, RFCOMM and any further one.

A transport is one class in one module, of this package or of a feature; `rsb_bridge.transport.registry` knows all.
There are two kinds:

- A `StreamTransport` connects byte streams (`rsb_bridge.transport.streams.Stream`). It can carry a whole link: its
  control connection and its routes.
- A `DatagramTransport` sends single datagrams. It carries routes of a link whose control connection is a stream.

Links and routes never ask which transport they have. They ask for its properties, which `rsb_bridge.model.transports`
declares with its name, so a new transport changes no other module. A test replaces a transport by a subclass with
methods of its own, and passes it to the engine in a `rsb_bridge.transport.registry.Transports`.

All of it runs on the I/O loop. Timers and the time come from the loop, so that a test can own them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, TypeAlias

from rsb_bridge.model.transport_traits import TransportTraits
from rsb_bridge.transport.streams import Address, format_address

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.model.session import Session
    from rsb_bridge.transport.network_news import NetworkNews
    from rsb_bridge.transport.streams import Stream, StreamHandler


RECEIVE_BUFFER = 8 * 1024 * 1024
"""Bytes of the kernel's receive buffer that a datagram socket asks for: a round figure."""


class ListenError(Exception):
    """An address can't be bound; the message says why and what to do."""


class SendPath(NamedTuple):
    """The path from a bound datagram socket to a peer; made by `DatagramSocket.path`.

    Attributes:
        control: ancillary data (sendmsg(2)) with the datagrams' source address.
    """

    address: Address
    control: list[tuple[int, int, bytes]]


class DatagramSocket(Protocol):
    """A bound or connected datagram socket.

    Attributes:
        when_writable: called once the socket was congested and takes more again.
    """

    when_writable: set[Callable[[], None]]

    @property
    def port(self) -> int:
        """The local port, or 0 on a network that has none."""

    @property
    def congested(self) -> bool:
        """Whether datagrams wait here for the network: better not to send now."""

    @property
    def receive_buffer(self) -> int:
        """Bytes that the kernel grants of `RECEIVE_BUFFER`."""

    def arrived_at(self) -> float:
        """Return when (s, on the loop's clock) the datagram that was read last reached this machine."""

    def send(self, datagrams: Sequence[bytes], path: SendPath | None) -> None:
        """Send datagrams, along a path or, on a connected socket, None. Never waits; may lose them."""

    def path(self, source: str, address: Address) -> SendPath:
        """Return the way from one of our addresses to a peer."""

    def datagram_size(self, address: Address) -> int:
        """Return the bytes of the largest datagram that reaches `address` in one piece, by present knowledge."""

    def close(self) -> None:
        """Close it; what waits is lost."""


Datagrams: TypeAlias = list[tuple[bytes | memoryview, Address]]
"""Datagrams, each with the address it came from."""


class Acceptor(Protocol):
    """The server that takes the streams and datagrams of a listening transport."""

    def make_handler(self) -> StreamHandler:
        """Return the handler of an inbound stream, before its `StreamHandler.connected`."""

    def datagrams(self, socket: DatagramSocket, datagrams: Datagrams, /) -> None:
        """Take the datagrams that one wake-up of a socket brought."""

    def shortage(self, message: str) -> None:
        """Tell why no stream can be accepted now, for example because the process may have no more descriptors.

        Called each time. The streams wait, and accepting them is tried again.
        """

    async def prove(self, hosts: list[str]) -> list[str]:
        """Return which of the hosts that announce themselves as servers have a key of this one."""

    def others(self, message: str) -> None:
        """Tell that other servers are announced."""


class Listener(Protocol):
    """A bound port."""

    def close(self) -> None:
        """Free the port. Streams that it accepted stay open; datagram sockets are closed."""


class _Transport(TransportTraits, ABC):
    """The common part of all transports.

    Attributes:
        largest_message: bytes of one serialized message.
    """

    largest_message: ClassVar[int]

    def host(self, session: Session) -> str:
        """Return the server's address for this transport, as the session gives it."""
        return session.host

    def format_address(self, address: Address) -> str:
        """Return an address as an operator reads it: ``host:port`` and the like."""
        return format_address(address)

    def close(self) -> None:
        """Give back what all its sockets share, after the last of them is closed."""
        return

    @abstractmethod
    async def listen(self, host: str, port: int, acceptor: Acceptor) -> Listener:
        """Accept streams or datagrams on all of the host's addresses.

        Raises:
            ListenError: the address can't be bound.
        """


class StreamTransport(_Transport):
    """A transport of byte streams."""

    @abstractmethod
    async def connect(self, host: str, port: int, handler: StreamHandler, rank: int | None = None) -> Stream:
        """Connect a stream; call `StreamHandler.connected` before returning it.

        When cancelled it leaves no socket behind.

        Args:
            rank: the rank of its route's priority, or None for a link's control connection.

        Raises:
            OSError: there is no connection; `rsb_bridge.transport.streams.os_error_message` says why.
        """

    async def servers(self) -> list[str] | None:
        """Return the hosts that announce a server, or None where the session names the only one.

        Raises:
            OSError: nobody can be asked, or no server is announced.
        """
        return None

    @property
    def announced_servers(self) -> int:
        """The number of announced servers that this side has heard of."""
        return 0

    def several(self, hosts: Sequence[str]) -> str:
        """Return the text for operators about several servers that prove one key."""
        raise NotImplementedError

    @property
    def announced_at(self) -> str:
        """The host by which clients find this server, or an empty string where it does not announce itself."""
        return ""

    @property
    def problem(self) -> str:
        """The reason why no peer can be reached, and the remedy, or an empty string."""
        return ""

    def source_address(self, host: str) -> str:
        """Return the source address of a new stream to a host, or an empty string if it is unknown or can't change."""
        return ""

    def network_news(self, changed: Callable[[], None]) -> NetworkNews | None:
        """Have `changed` called soon after this machine's network changes, or return None if nobody tells.

        For clients: a server that has another address cannot tell them, and hears of it when they come.
        """
        return None


class DatagramTransport(_Transport):
    """A transport of datagrams. Its routes share one socket for each number."""

    @abstractmethod
    def connect(self, peer: Address, received: Callable[[DatagramSocket, Datagrams], None]) -> DatagramSocket:
        """Return a socket that sends to, and receives from, one peer.

        Raises:
            OSError: there is no way to the peer.
        """


Transport: TypeAlias = StreamTransport | DatagramTransport

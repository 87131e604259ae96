"""Zenoh as a transport of links: who finds whom, and how their streams and datagrams begin."""

from __future__ import annotations

import asyncio
import os
import socket
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording, join_first
from rsb_bridge.transport.network_news import news_of_kernel
from rsb_bridge.transport.streams import Address, Stream, StreamHandler
from rsb_bridge.transport.transport import (
    RECEIVE_BUFFER,
    Acceptor,
    Datagrams,
    DatagramSocket,
    DatagramTransport,
    Listener,
    ListenError,
    SendPath,
    StreamTransport,
)
from rsb_bridge.wire.framing import MESSAGE_LIMIT
from rsb_extras.zenoh.endpoint import DATAGRAM
from rsb_extras.zenoh.outbox import LINK_RANK
from rsb_extras.zenoh.pipe import Pipe
from rsb_extras.zenoh.zenoh_traits import ZenohDropTraits, ZenohTraits

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from rsb_bridge.transport.network_news import NetworkNews
    from rsb_extras.zenoh.endpoint import Seen, ZenohEndpoint
    from rsb_extras.zenoh.network import Network
    from rsb_extras.zenoh.sample_header import Header

SERVER, CLIENT = "server", "client"
"""The services by which the two sides of links announce themselves."""
_NAMED = 3  # servers in a message
_TOLD_EVERY = 3600.0
"""s between two messages about other servers: strangers may announce any number."""
_RANKS = {1: 1, 0: 2, -1: 3}


class FleetText(Wording):
    """Texts about the servers that a fleet announces, or does not."""

    NO_SERVER = "the Zenoh network has no server of the fleet {fleet!r}: is it running, with that fleet?"
    SERVER_PRESENT = (
        "the fleet {fleet!r} has a server already: {names}: stop one, or give this one's sessions another fleet "
        "(zenoh: {{fleet: NAME}})"
    )
    SEVERAL_SERVERS = (
        "the fleet {fleet!r} has several servers: {names}: stop one, or give this one's sessions another fleet "
        "(zenoh: {{fleet: NAME}})"
    )
    OTHER_SERVER = (
        "another server is announced in the fleet {fleet!r}: {names}: clients try each, and link with the one that has "
        "their key; if they are none of yours, set access control on the router"
    )
    OTHER_SERVERS = (
        "{count} other servers are announced in the fleet {fleet!r}: {names}: clients try each, and link with the one "
        "that has their key; if they are none of yours, set access control on the router"
    )


class ZenohStream(Stream):
    """A stream whose sender waits while too many bytes are in flight."""

    high_water = 256 * 1024
    """A round figure, in addition to what is in flight (`rsb_extras.zenoh.pipe.WINDOW`)."""

    def trust(self) -> None:
        if isinstance(self._transport, Pipe):
            self._transport.trust()

    def begin_trial(self) -> None:
        if isinstance(self._transport, Pipe):
            self._transport.begin_trial()

    def adopt(self) -> None:
        if isinstance(self._transport, Pipe):
            self._transport.adopt()

    def authenticate(self, secret: bytes | None, *, opener: bool) -> None:
        if secret is not None and isinstance(self._transport, Pipe):
            self._transport.authenticate(secret, opener=opener)

    @property
    def peer(self) -> str:
        return _format_address(self.address)


class Links:
    """This process's endpoint for new links, one for all of them: of the server, or of the client.

    Args:
        name: of the session, for others to see.
    """

    def __init__(self, network: Network, name: str) -> None:
        self.network = network
        self._label = f"{name} on {socket.gethostname()}"
        self._endpoint: ZenohEndpoint | None = None
        self._opening = asyncio.Lock()

    async def endpoint(self, service: str, watched: Sequence[str], *, is_second: bool = False) -> ZenohEndpoint:
        """Return the endpoint, made at the first call, and again in each session of the network.

        Args:
            is_second: whether it is for a second connection, if a link is up here. Then the network is opened anew,
                unless the first connection is heard meanwhile.

        Raises:
            OSError: the network is not reached.
        """
        asked_at = asyncio.get_running_loop().time()

        def doubted() -> bool:
            old = self._endpoint
            if service != CLIENT or old is None:
                return False
            return not self.network.connected or (is_second and old.carries_link and old.heard_at < asked_at)

        async with self._opening:
            await self.network.open(doubted)
            if self._endpoint is None or not self.network.is_in(self._endpoint):
                self._endpoint = await self.network.endpoint(service, self._label, watched)
        return self._endpoint

    def endpoint_if_open(self) -> ZenohEndpoint:
        """Return the endpoint of a link that is up.

        Raises:
            OSError: none is announced.
        """
        if self._endpoint is None:
            raise OSError("not in the Zenoh network")
        return self._endpoint

    @property
    def servers(self) -> int:
        """The number of servers that are announced, without this side."""
        return 0 if self._endpoint is None else len(_servers(self._endpoint))

    def close(self) -> None:
        """Close the endpoint; the next one has another address."""
        if self._endpoint is not None:
            self._endpoint.close()
            self._endpoint = None


class ZenohTransport(ZenohTraits, StreamTransport):
    """Streams over a Zenoh network. Hosts are ``zenoh``, or the address of the server's endpoint; ports are 0."""

    largest_message = MESSAGE_LIMIT

    def __init__(self, links: Links) -> None:
        self._links = links

    @property
    def network(self) -> Network:
        return self._links.network

    def format_address(self, address: Address) -> str:
        return f"zenoh ({self._links.network.place})" if address[0] == "zenoh" else _format_address(address)

    async def servers(self) -> list[str]:
        endpoint = await self._links.endpoint(CLIENT, (SERVER,), is_second=True)
        return [seen.address for seen in self._announced(endpoint)]

    @property
    def announced_servers(self) -> int:
        return self._links.servers

    def several(self, hosts: Sequence[str]) -> str:
        seen = self._links.endpoint_if_open().seen
        return _several(self._links.network.settings.fleet, [seen[each] for each in hosts if each in seen])

    @property
    def announced_at(self) -> str:
        return self._links.endpoint_if_open().address

    async def connect(self, host: str, port: int, handler: StreamHandler, rank: int | None = None) -> Stream:
        endpoint = await self._links.endpoint(CLIENT, (SERVER,), is_second=rank is None)
        peer = self._server(endpoint) if host == "zenoh" else host
        stream = ZenohStream(handler)
        # On a data stream the server's data may follow its answer at once.
        Pipe(endpoint, peer, os.urandom(8).hex(), _priority(rank), stream, stranger=rank is None)
        return stream

    def _announced(self, endpoint: ZenohEndpoint) -> list[Seen]:
        """Return the other servers.

        Raises:
            OSError: none is announced.
        """
        fleet = self._links.network.settings.fleet
        servers = _servers(endpoint)
        if not servers:
            raise OSError(FleetText.NO_SERVER(fleet=fleet))
        return servers

    def _server(self, endpoint: ZenohEndpoint) -> str:
        """Return the only server of a link without encryption, which could not tell servers apart."""
        servers = self._announced(endpoint)
        if len(servers) > 1:
            raise OSError(_several(self._links.network.settings.fleet, servers))
        return servers[0].address

    async def listen(self, host: str, port: int, acceptor: Acceptor) -> Listener:
        try:
            endpoint = await self._links.endpoint(SERVER, (CLIENT, SERVER))
        except OSError as error:
            self._links.close()  # the next attempt has another address, and asks again for the members
            raise ListenError(str(error)) from None
        fleet, others = self._links.network.settings.fleet, _servers(endpoint)
        if others:
            same = await acceptor.prove([seen.address for seen in others])
            if found := [seen for seen in others if seen.address in same]:
                self._links.close()
                raise ListenError(_several(fleet, found, own=True))
            acceptor.others(_others(fleet, others))
        told_at = asyncio.get_running_loop().time()

        def accept(sender: str, stream: str, header: Header) -> Pipe:
            return Pipe(endpoint, sender, stream, header.rank, ZenohStream(acceptor.make_handler()), stranger=True)

        def another(seen: Seen, comes: bool) -> None:
            nonlocal told_at
            now = asyncio.get_running_loop().time()
            # Its own announcement comes as well, again after each loss of the router.
            if comes and seen.service == SERVER and seen.address != endpoint.address and now >= told_at:
                told_at = now + _TOLD_EVERY
                acceptor.others(_others(fleet, _servers(endpoint)))

        endpoint.on_stream = accept
        endpoint.on_seen = another
        return _Listening(endpoint)

    def network_news(self, changed: Callable[[], None]) -> NetworkNews | None:
        return news_of_kernel(changed)

    @property
    def problem(self) -> str:
        return self._links.network.problem

    def close(self) -> None:
        self._links.close()
        self._links.network.close()


class _Listening:
    """A server's end of `ZenohTransport.listen`."""

    def __init__(self, endpoint: ZenohEndpoint) -> None:
        self._endpoint = endpoint

    def close(self) -> None:
        self._endpoint.on_stream = None


class ZenohSocket:
    """Sends single samples to one peer, or to any; fulfils `DatagramSocket`.

    Attributes:
        when_writable: never called: it is never congested.
    """

    congested = False
    port = 0
    receive_buffer = RECEIVE_BUFFER  # no kernel's, so that it is never too small

    def __init__(self, endpoint: ZenohEndpoint, peer: str, on_close: Callable[[], None]) -> None:
        self.when_writable: set[Callable[[], None]] = set()
        self._endpoint = endpoint
        self._peer = peer
        self._on_close = on_close

    def send(self, datagrams: Sequence[bytes], path: SendPath | None) -> None:
        """See `DatagramSocket.send`."""
        key = self._endpoint.key(self._peer if path is None else str(path.address[0]))
        for datagram in datagrams:
            self._endpoint.outbox.drop(key, datagram)

    def arrived_at(self) -> float:
        """See `DatagramSocket.arrived_at`: datagrams are taken as soon as Zenoh brings them."""
        return asyncio.get_running_loop().time()

    def path(self, source: str, address: Address) -> SendPath:
        """See `DatagramSocket.path`."""
        return SendPath(address, [])

    def datagram_size(self, address: Address) -> int:
        """See `DatagramSocket.datagram_size`."""
        return DATAGRAM

    def close(self) -> None:
        """See `DatagramSocket.close`."""
        self._on_close()


class ZenohDropTransport(ZenohDropTraits, DatagramTransport):
    """Datagrams over a Zenoh network, for the routes of links over `ZenohTransport`."""

    largest_message = MESSAGE_LIMIT

    def __init__(self, links: Links) -> None:
        self._links = links

    def format_address(self, address: Address) -> str:
        return _format_address(address)

    async def listen(self, host: str, port: int, acceptor: Acceptor) -> Listener:
        """Take datagrams at the endpoint that the streams have."""
        try:
            endpoint = self._links.endpoint_if_open()
        except OSError as error:
            raise ListenError(str(error)) from None

        def take(sender: str, payload: bytes) -> None:
            acceptor.datagrams(bound, [(payload, (sender, 0))])

        bound = ZenohSocket(endpoint, "", lambda: _deaf(endpoint, take))
        endpoint.on_datagram = take
        return bound

    def connect(self, peer: Address, received: Callable[[DatagramSocket, Datagrams], None]) -> DatagramSocket:
        endpoint = self._links.endpoint_if_open()
        server = str(peer[0])
        connected = ZenohSocket(endpoint, server, lambda: _deaf(endpoint, take))

        def take(sender: str, payload: bytes) -> None:
            if sender == server:  # others may send to this endpoint, too
                received(connected, [(payload, peer)])

        endpoint.on_datagram = take
        return connected


def _deaf(endpoint: ZenohEndpoint, take: Callable[[str, bytes], None]) -> None:
    """Give datagrams to `take` no longer; the next socket may have begun before this one is closed."""
    if endpoint.on_datagram is take:
        endpoint.on_datagram = None


def _priority(rank: int | None) -> int:
    """Return a sample's rank (`rsb_extras.zenoh.outbox`) for a route's, or for None the link's own."""
    return LINK_RANK if rank is None else _RANKS[(rank > 0) - (rank < 0)]


def _servers(endpoint: ZenohEndpoint) -> list[Seen]:
    """Return the servers that are announced, without this one."""
    return [seen for seen in endpoint.seen.values() if seen.service == SERVER and seen.address != endpoint.address]


def _others(fleet: str, servers: Sequence[Seen]) -> str:
    text = FleetText.OTHER_SERVERS if len(servers) > 1 else FleetText.OTHER_SERVER
    return text(count=len(servers), fleet=fleet, names=_names(servers))


def _several(fleet: str, servers: Iterable[Seen], *, own: bool = False) -> str:
    return (FleetText.SERVER_PRESENT if own else FleetText.SEVERAL_SERVERS)(fleet=fleet, names=_names(servers))


def _names(servers: Iterable[Seen]) -> str:
    """Return the servers' names, and the addresses of servers without a name."""
    return join_first(sorted(seen.label or f"endpoint {seen.address}" for seen in servers), _NAMED)


def _format_address(address: Address) -> str:
    return f"zenoh {address[0]}"

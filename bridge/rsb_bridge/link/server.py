"""The server's side: binds the ports, authenticates clients, and rejects everything else."""

from __future__ import annotations

import fnmatch
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.channel.udp_channel import ServerUdpChannel, UdpDemultiplexer
from rsb_bridge.config.keys import Key, fingerprint
from rsb_bridge.link.control_channel import ControlChannel
from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.link import Link
from rsb_bridge.link.pending_connections import PendingConnections
from rsb_bridge.link.rival import Rival, name_taken
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import PORTS_PER_CLIENT
from rsb_bridge.model.names import client_topic, server_topic
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport import descriptors
from rsb_bridge.transport.ports import Ports
from rsb_bridge.transport.transport import Acceptor, ListenError, StreamTransport
from rsb_bridge.wire.connection import Credential, ServerConnection
from rsb_bridge.wire.messages import Hello, Propose, Shutdown, Welcome
from rsb_bridge.wire.preamble import LINK_ID_LENGTH, DataPreamble, Refusal, RefusalCode, parse_further
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.channel.shared_stream import SharedStream
    from rsb_bridge.context import Context
    from rsb_bridge.model.session import Client
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.streams import Address, Stream
    from rsb_bridge.transport.transport import DatagramSocket, DatagramTransport
    from rsb_bridge.wire.events import Attach, Established

_UNKNOWN_ROUTE = "unknown route"  # whoever has not authenticated does not learn which links there are
_SESSION_CHANGED = "the server's session has changed: try again"
_SILENT = 1.5
"""s without a byte (pings come every second) after which another process may take a client's name over."""
_CAUSES = {RefusalCode.WRONG_KEY: LinkCause.WRONG_KEY, RefusalCode.WRONG_VERSION: LinkCause.WRONG_VERSION}
_REPLACED_PAUSE = 10.0
"""s that a replaced client waits, which was silent for a moment: it would find its name taken."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A client that the server accepts.

    Attributes:
        client: its entry in the session.
        key: None: unencrypted.
        use_name: whether its topics have its name before them here.
    """

    client: Client
    key: Key | None
    use_name: bool


class ServerLink(Link):
    """One client, as the server sees it."""

    def __init__(self, context: Context, entry: Entry, ports: Ports) -> None:
        mark = fingerprint(entry.key) if entry.key else ""
        encrypted = entry.key is not None
        super().__init__(context, entry.client.name, is_client=False, fingerprint=mark, encrypted=encrypted)
        self.entry = entry
        self._ports = ports
        self._seen_at = ""
        self._seen_host = ""
        self._rival: Rival | None = None

    @property
    def address(self) -> str:
        return self.control.stream.peer if self.control else self._seen_at

    def was_at(self, host: str) -> bool:
        """Whether the client was last seen at that host."""
        return host == self._seen_host

    def seen(self, stream: Stream) -> None:
        """The client is at the other end of a stream."""
        self._seen_at, self._seen_host = stream.peer, stream.host
        self._rival = None

    def refused(self, stream: Stream, cause: LinkCause, message: str) -> None:
        """Somebody was refused who calls itself by the client's name, and it is not linked."""
        if self.cause is not cause:
            self._since = self.context.wall()
        self.set_down(cause, f"refused {stream.host}: {message}")

    # --- two clients of one name

    def keeps_name_from(self, hello: Hello) -> bool:
        """Whether a client must not take the name over: another process has it, and is not silent."""
        if self.control is None or not isinstance(self.peer, Hello) or hello.instance == self.peer.instance:
            return False
        return self.keepalive.quiet < _SILENT

    def name_taken(self, hello: Hello) -> Refusal:
        """What both sides say of a second client."""
        if self._rival is None or self._rival.host != hello.host:
            self._rival = Rival(self.name, hello.host, self.context.wall())
        first = self.peer.host if isinstance(self.peer, Hello) else ""
        return Refusal(RefusalCode.NAME_TAKEN, name_taken(self.name, self.address, first, self._since))

    def rival_tried(self, address: str) -> None:
        """A second client was refused."""
        if self._rival is not None:
            self._rival.tried(address, self.context.now())

    @property
    def warning(self) -> str:
        if self._rival is None or not self.linked:
            return ""
        return self._rival.warning(self.context.now(), self.context.wall())

    def shared_port(self) -> int:
        return self.context.session.server_port

    @property
    def use_name(self) -> bool:
        return self.entry.use_name

    def on_shutdown(self, message: Shutdown) -> None:
        if self.control is not None:
            self.control.abort(f"the client left: {message.reason}", EventCode.LINK_CLOSED_BY_PEER)

    def authorize(self, proposal: Propose) -> Propose:
        """Check `allow` and `deny`, and put the client's name before the topic's on this side where that is wanted."""
        client = self.entry.client
        ours = proposal.remote_topic if proposal.from_client else proposal.topic
        if self.use_name and client_topic(ours, client.name) is None:
            ours = server_topic(ours, client.name)
        if denial := _denial(client, ours):
            raise LinkError(denial)
        field = "remote_topic" if proposal.from_client else "topic"
        return msgspec.structs.replace(proposal, **{field: ours})

    def shows(self, topic: str) -> bool:
        reachable = not self.use_name or client_topic(topic, self.name) is not None
        return reachable and not _denial(self.entry.client, topic)

    def denied_by(self, client: Client) -> dict[Route, str]:
        """The routes that the peer proposed and another entry of it would deny, each with the reason."""
        found = {route: _denial(client, route.local_topic) for route in self.routes.values() if not route.proposed_here}
        return {route: reason for route, reason in found.items() if reason}

    def change_entry(self, entry: Entry) -> None:
        """Go on with another entry of the session. The link ends where the key or the names of topics change."""
        old, self.entry = self.entry, entry
        self.encrypted = entry.key is not None
        self.fingerprint = fingerprint(entry.key) if entry.key is not None else ""
        if old.key != entry.key and self.control is not None:
            self.control.shut_down(f"the server has another key for {self.name} now", retry_after=0.0)
        if old.use_name != entry.use_name:
            self._rename_topics()
        for route, reason in self.denied_by(entry.client).items():
            self.table.deny(route, reason)

    def _rename_topics(self) -> None:
        """Open everything anew, under other names on this side."""
        if self.control is not None:
            self.control.shut_down("the server has other names for the topics now (use_name)", retry_after=0.0)
        own = self.proposed_topics
        self.table.destroy()
        self.table.yielded.clear()
        for topic in own:
            self.add_topic(topic)

    def open_stream(self, route: Route, transport: StreamTransport) -> None:
        """The client opens it."""

    @property
    def streams_awaited(self) -> int:
        """How many routes wait for the client to open their stream."""
        return sum(1 for route in self.routes.values() if _stream_awaited(route))

    def waiting_route(self, preamble: Attach | DataPreamble) -> tuple[Route, StreamTransport]:
        """The route that a data preamble names, and its transport; raises Refusal if it does not wait for a stream."""
        route = self.table.open_route(preamble.route)
        transport = _stream_awaited(route) if route is not None else None
        if self.keys is None or route is None or transport is None:
            raise Refusal(RefusalCode.NO_SUCH_ROUTE, _UNKNOWN_ROUTE)
        try:
            self.keys.check_attach_proof(preamble.header, preamble.route, preamble.proof)
        except SealError as error:
            raise Refusal(RefusalCode.NO_SUCH_ROUTE, str(error)) from None
        return route, transport

    def join_stream(self, shared: SharedStream, frame: bytes) -> None:
        preamble = parse_further(frame)
        if self.is_closed_id(preamble.route):
            return  # it was closed here while the frame was under way
        route, transport = self.waiting_route(preamble)
        if not transport.multiplexed or route.proposal.port != shared.channel:
            raise Refusal(RefusalCode.NO_SUCH_ROUTE, f"route {route.id} does not belong on channel {shared.channel}")
        assert self.data_keys is not None
        route.channel = shared.carry(route, self.data_keys)
        route.advance()

    def open_udp_channel(self, transport: DatagramTransport, port: int) -> None:
        """The client's first probe does."""

    async def prepare_port(self, route: Route) -> None:
        port, route_id, transport = route.proposal.port, route.id, route.transport
        same_numbers = transport.port_kind == self.transport.port_kind  # channel 5 is not port 5
        if not port or (same_numbers and port == self.shared_port()):
            return
        if port not in transport.topic_ports:
            raise ListenError(f"{transport.port_kind} {port}: topics may have {transport.topic_ports}")
        if sum(other.release_port is not None for other in self.routes.values()) >= PORTS_PER_CLIENT:
            raise ListenError(
                f"{self.name} has {PORTS_PER_CLIENT} ports of its topics' own already: let more share the link's"
            )
        release = await self._ports.open(transport.name, port)
        if route.id == route_id and route.release_port is None:
            route.release_port = release
        else:  # it was closed while the port was being bound
            release()

    def new_udp_channel(self, socket: DatagramSocket, address: Address) -> ServerUdpChannel | None:
        """The link's UDP channel on a socket that its first datagram came to, from `address`; None: it can't be.

        A datagram of the other IP version is ignored: a forged one must not take over the UDP channel.
        """
        assert self.path_probe is not None
        assert self.control is not None
        stream = self.control.stream
        if len(address) != len(stream.address):
            return None
        udp_channel = ServerUdpChannel(socket, stream.own_address, self.path_probe, self.context.now, self.udp_ready)
        self.udp_channels.add(socket.port, udp_channel)
        return udp_channel


def _denial(client: Client, topic: str) -> str:
    """Why a client may not have a topic of this side, for its operator; empty: it may."""
    names = (topic, client_topic(topic, client.name) or topic)
    if any(fnmatch.fnmatchcase(name, pattern) for pattern in client.deny for name in names):
        return f"the server denies {topic} to {client.name}"
    if client.allow and not any(fnmatch.fnmatchcase(name, pattern) for pattern in client.allow for name in names):
        return f"the server does not allow {topic} to {client.name}"
    return ""


class Server:
    """The server's end of all its links.

    Attributes:
        entries: of the clients that are let in, by their names.
        links: likewise; a client that the session lists has one before it ever came.
    """

    def __init__(
        self, context: Context, entries: list[Entry], make_welcome: Callable[[bytes, bool], Welcome], *, aes: bool
    ) -> None:
        self.context = context
        self._make_welcome = make_welcome
        self._aes = aes
        self._pending = PendingConnections(context, self)
        self._transport = context.transports.of_link(context.session.server_ip)
        datagrams = UdpDemultiplexer(self._new_udp_channel).received
        acceptor = Acceptor(self._pending.arrive, datagrams, self._pending.shortage)
        self._ports = Ports(context.session, context.transports, acceptor)
        self.entries = {entry.client.name: entry for entry in entries}
        self.links = {entry.client.name: ServerLink(context, entry, self._ports) for entry in entries}

    async def start(self) -> None:
        """Bind the shared port.

        Raises:
            ListenError: it is taken, or not ours.
        """
        session = self.context.session
        names = (self._transport.name, *self._transport.companions)
        for name in names:
            await self._ports.open(name, session.server_port)
        address = self._transport.format_address((session.server_ip, session.server_port))
        self.context.log(Level.INFO, EventCode.ENGINE_LISTENING, f"listening on {address} ({' and '.join(names)})")

    def stop(self) -> None:
        """Stop accepting connections, and reject those that are pending."""
        self._ports.close()
        self._pending.close()

    def tick(self) -> None:
        """Once a second."""
        self._pending.tick()

    # --- other clients than before

    def add_client(self, entry: Entry) -> None:
        """Let one more client in."""
        self.entries[entry.client.name] = entry
        self.links[entry.client.name] = ServerLink(self.context, entry, self._ports)

    def remove_client(self, name: str) -> None:
        """Let a client in no more, and end its link."""
        del self.entries[name]
        link = self.links.pop(name)
        self._pending.expel(name, _SESSION_CHANGED)
        if link.control is not None:
            link.control.shut_down(f"the server lets {name} in no more", retry_after=0.0)
        link.destroy()

    def change_client(self, entry: Entry) -> None:
        """Go on with another entry of a client."""
        name = entry.client.name
        self.entries[name] = entry
        self._pending.expel(name, _SESSION_CHANGED)
        self.links[name].change_entry(entry)

    # --- inbound connections

    def streams_awaited(self, host: str = "") -> int:
        """How many routes' streams linked clients have yet to open; with `host`: those at that host."""
        return sum(
            link.streams_awaited
            for link in self.links.values()
            if link.control is not None and host in ("", link.control.stream.host)
        )

    def connection(self, identify: Callable[[str], Credential]) -> ServerConnection:
        """The state machine for a stream that comes in."""
        return ServerConnection(identify, self._welcome, self._aes, multiplexed=self._transport.multiplexed)

    def credential(self, name: str) -> Credential:
        """What a client of that name has to prove; raises Refusal where there is none."""
        entry = self.entries.get(name)
        if entry is None:
            raise Refusal(RefusalCode.UNKNOWN_NAME, f"the server knows no client of the name {name!r}")
        return Credential(entry.key.secret if entry.key else None)

    def _welcome(self, hello: Hello) -> Welcome:
        link = self.links[hello.name]
        if link.keeps_name_from(hello):
            raise link.name_taken(hello)
        return self._make_welcome(os.urandom(LINK_ID_LENGTH), self.links[hello.name].use_name)

    def established(self, stream: Stream, connection: ServerConnection, event: Established) -> ControlChannel:
        """A client is authenticated; it takes the place of an older connection of its name."""
        assert isinstance(event.peer, Hello)
        link = self.links[event.peer.name]
        if link.control is not None and link.keeps_name_from(event.peer):  # since the handshake began
            raise link.name_taken(event.peer)
        link.seen(stream)
        if link.control is not None:
            link.control.shut_down(
                f"replaced: {link.name} at {link.address} by a newer connection from {stream.peer}",
                retry_after=_REPLACED_PAUSE,
                code=EventCode.LINK_REPLACED,
            )
        control = ControlChannel(stream, connection, link)
        link.up(control, event.peer, event.keys)
        return control

    def attach(self, stream: Stream, connection: ServerConnection, event: Attach) -> None:
        """A stream was opened for a route; raises Refusal where it may not be."""
        link = self._link_of(event.link_id)
        if link is None:
            raise Refusal(RefusalCode.NO_SUCH_ROUTE, _UNKNOWN_ROUTE)
        route, transport = link.waiting_route(event)
        if descriptors.scarce():
            raise Refusal(RefusalCode.BUSY, descriptors.scarcity_message("server"))
        stream.write(connection.accept_attach())
        link.attach_stream(route, stream, connection.leftover(), multiplexed=transport.multiplexed)

    def refused(self, name: str, stream: Stream, code: RefusalCode, message: str) -> None:
        """Show on the link of that name that a client was refused; one of another version says no name."""
        link = self.links.get(name)
        if link is None and code is RefusalCode.WRONG_VERSION:
            at_host = [each for each in self.links.values() if each.was_at(stream.host)] or list(self.links.values())
            link = at_host[0] if len(at_host) == 1 else None
        if link is None:
            return
        if code is RefusalCode.NAME_TAKEN:
            link.rival_tried(stream.host)
        elif not link.linked:
            link.refused(stream, _CAUSES.get(code, LinkCause.REFUSED), message)

    def remedy_for_unknown(self) -> str:
        """What an operator does about an unknown client name; the client itself is not told."""
        session = self.context.session
        if session.clients:
            return "list it under clients in this side's session file, or set name in the client's to one listed there"
        remedy = f"set name in the client's to {session.name!r}, or list the client's under clients in this one"
        return f"this side's session file lists no clients: {remedy}"

    def _link_of(self, link_id: bytes) -> ServerLink | None:
        return next(
            (link for link in self.links.values() if link.keys is not None and link.keys.link_id == link_id), None
        )

    def _new_udp_channel(self, link_id: bytes, socket: DatagramSocket, address: Address) -> ServerUdpChannel | None:
        link = self._link_of(link_id)
        return link.new_udp_channel(socket, address) if link is not None else None


def _stream_awaited(route: Route) -> StreamTransport | None:
    """The transport of the stream that a route waits for; None: it waits for none."""
    if not route.id or route.channel is not None or not isinstance(route.transport, StreamTransport):
        return None
    return route.transport

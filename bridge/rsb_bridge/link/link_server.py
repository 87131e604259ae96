"""The server's side: binds the ports, authenticates clients, and rejects everything else."""

from __future__ import annotations

import asyncio
import os
import shlex
from itertools import chain
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge import __version__
from rsb_bridge.channel.udp_channel import ServerUdpChannel, UdpDemultiplexer
from rsb_bridge.installed_features import feature_names
from rsb_bridge.link.connecting import find_servers
from rsb_bridge.link.pending_connections import ConnectionStage, Limits, PendingConnection, PendingConnections, Rejected
from rsb_bridge.link.refused_clients import CAUSES, RefusedClients
from rsb_bridge.link.server_channels import UNKNOWN_ROUTE
from rsb_bridge.link.server_end import ServerEnd
from rsb_bridge.link.topic_ports import DescriptorShare
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.descriptors import RESERVE
from rsb_bridge.transport.ports import Ports
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.transport.trials import Trials
from rsb_bridge.wire.connection import ClientConnection, ServerConnection
from rsb_bridge.wire.events import Attach, Established, Event, Failed, RefusalCode, StreamRefused
from rsb_bridge.wire.messages import Hello, Welcome
from rsb_bridge.wire.preamble import LINK_ID_LENGTH, Refusal
from rsb_bridge.wire.sealed_stream import Credential
from rsb_bridge.wire.sealing import CipherSuite

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.link.connecting import ProvenServer
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.link.server_end import ClientEntry
    from rsb_bridge.model.reason import Reason
    from rsb_bridge.transport.streams import Address
    from rsb_bridge.transport.transport import DatagramSocket

_LIMITS = Limits(total=256, of_one_host=64, accepted=4, when_scarce=RESERVE // 4)
"""The streams that linked clients have yet to open are allowed on top of the first two.

Round figures: 256 connections take a quarter of what all strangers may have (`model.budgets`). With them, a robot links
through floods of 20,000 connections a second (bench/README)."""
_CODES = {
    RefusalCode.WRONG_KEY: EventCode.LINK_WRONG_KEY,
    RefusalCode.UNKNOWN_NAME: EventCode.LINK_UNKNOWN_NAME,
    RefusalCode.NAME_TAKEN: EventCode.LINK_NAME_TAKEN,
    RefusalCode.SHUT_DOWN: EventCode.LINK_SHUT_DOWN,
}
_ONLY_BRIDGES = "correct the address in that program, as only bridges use this port"
_SESSION_CHANGED = "the server's session has changed: try again"
_ASKED_AS = 3  # number of clients whose keys other servers are asked to prove (PROTOCOL.md, 12). A round figure
_PROVES_WITHIN = 1.0  # s in which another server has to answer; this server waits so long before it listens
_SHUT_DOWN = "the server shuts its links down: try again"
_REPLACED_PAUSE = 10.0
"""s that a replaced client waits, which was silent for a moment: it would find its name taken. A round
figure."""


class Server:
    """The server's end of all its links.

    Attributes:
        ends: those of its links, by client name; a client in the session has one even before it first connects.
        pending: the streams of clients that have not authenticated yet.
        datagrams: takes what sockets bring, as `rsb_bridge.transport.transport.Acceptor` has it.
        refused_clients: refused clients that no link shows.
    """

    def __init__(self, context: Context, entries: list[ClientEntry], *, aes: bool) -> None:
        self.context = context
        self._aes = aes
        self.pending = InboundStreams(self)
        self._turned_away = 0
        self.refused_clients = RefusedClients(context)
        self._transport = context.transports.of_link(context.session.host)
        self.datagrams = UdpDemultiplexer(self).received
        self._ports = Ports(context.session, context.transports, self)
        self.ends: dict[str, ServerEnd] = {}
        for entry in entries:
            self.add_client(entry)

    @property
    def entries(self) -> dict[str, ClientEntry]:
        return {name: end.entry for name, end in self.ends.items()}

    async def start(self) -> None:
        """Bind the shared port: its streams last, since clients link as soon as these are accepted.

        Raises:
            ListenError: it is taken, or not ours.
        """
        session = self.context.session
        names = (self._transport.name, *self._transport.companions)
        for name in reversed(names) if self._transport.ip_ports else names:
            await self._ports.open(name, session.server_port)
        address = self._transport.format_address((session.host, session.server_port))
        self.context.log(Level.INFO, EventCode.ENGINE_LISTENING, f"listening on {address} ({' and '.join(names)})")

    # --- as its transports' acceptor

    def make_handler(self) -> StreamHandler:
        return _InboundStream(self)

    def shortage(self, message: str) -> None:
        """Tell the operator that no connection can be accepted now, and reject the pending one of the lowest stage."""
        if self.pending.refusals.is_new("", message):
            text = f"new connections have to wait: {message}"
            self.context.log(Level.ERROR, EventCode.ENGINE_SHORTAGE, text)
        if self.pending.present:  # the next connection needs a descriptor
            self.pending.reject_lowest("the server has no file descriptors left")

    async def prove(self, hosts: list[str]) -> list[str]:
        """Return which servers have a client's key, so that the client could not tell them from this one.

        It asks as the client does, and goes no further than the server's proof.
        """
        keyed = [entry for entry in self.entries.values() if entry.keys][:_ASKED_AS]
        if not keyed:
            return hosts  # without encryption, a client cannot tell two servers apart
        # Of two keys, the client may still use the former one.
        keys = [(entry.client.name, key.secret) for entry in keyed for key in entry.keys]
        found = await asyncio.gather(*(self._with_key_of(name, secret, hosts) for name, secret in keys))
        return sorted(set(chain.from_iterable(found)))

    async def _with_key_of(self, name: str, secret: bytes, hosts: list[str]) -> list[str]:
        hello = Hello(__version__, name, os.urandom(8).hex(), 0)

        def begin(suite: CipherSuite | None) -> ClientConnection:
            return ClientConnection(hello, secret, suite or CipherSuite.AESGCM)

        trials: Trials[ProvenServer] = Trials(self.context.now, _PROVES_WITHIN)
        proven, _, _ = await find_servers(trials, self._transport, hosts, begin)
        for each in proven:
            each.give_up()
        return [str(each.stream.address[0]) for each in proven]

    def others(self, message: str) -> None:
        self.context.log(Level.WARNING, EventCode.ENGINE_OTHER_SERVERS, message)

    # --- life

    def stop(self) -> None:
        """Stop accepting connections, and reject the pending ones."""
        self._ports.close()
        self.pending.close()

    def tick(self) -> None:
        refusals, turned_away = self.pending.refusals, self.pending.strangers.turned_away
        refusals.tick()
        if turned_away > self._turned_away and refusals.is_new("", EventCode.LINK_STRANGERS):
            self._turned_away = turned_away
            text = f"{turned_away:,} connections or samples of strangers dropped: block the flood with a firewall"
            self.context.log(Level.WARNING, EventCode.LINK_STRANGERS, text)
        self.refused_clients.tick()

    # --- other clients than before

    def add_client(self, entry: ClientEntry) -> None:
        name = entry.client.name
        self.refused_clients.forget(name)
        self.ends[name] = ServerEnd(self.context, entry, self._ports, DescriptorShare(name, self.ends))

    def remove_client(self, name: str) -> None:
        """Stop accepting a client, and end its link."""
        link = self.ends.pop(name).link
        self._expel(name, _SESSION_CHANGED)
        link.leave(f"the server no longer accepts {name}", retry_after=0.0)
        self.context.demands.unregister(link.entries)
        link.destroy()
        for ends in self.context.internal.values():
            ends.forget(name)
        self.context.limited.forget(name)

    def change_client(self, entry: ClientEntry) -> None:
        name = entry.client.name
        self._expel(name, _SESSION_CHANGED)
        self.ends[name].change_entry(entry)

    def _expel(self, name: str, message: str) -> None:
        """Reject the connections that authenticate as this client, whose key or right has changed."""
        for pending in self.pending.present:
            if pending.name == name:
                pending.reject(message)

    # --- shut down by an operator

    def shut_down(self, who: str) -> None:
        """End all links, and refuse the clients until they are let in; `who` is the operator, in words."""
        for name, end in self.ends.items():
            self._expel(name, _SHUT_DOWN)  # a client with an earlier Welcome would link
            end.shut_down_for(who)

    # --- inbound connections

    def connection(self) -> ServerConnection:
        return ServerConnection(self.credential, self._welcome, self._aes, multiplexed=self._transport.multiplexed)

    def credential(self, name: str) -> Credential:
        """Return what a client by that name has to prove; raise Refusal if the name is unknown."""
        end = self.ends.get(name)
        if end is None:
            raise Refusal(RefusalCode.UNKNOWN_NAME, f"unknown client name {name!r}")
        return Credential(tuple(key.secret for key in end.entry.keys), end.replays)

    def _welcome(self, hello: Hello) -> Welcome:
        end = self.ends[hello.name]
        link = end.link
        welcome = Welcome(
            __version__,
            self.context.session.name,
            os.urandom(LINK_ID_LENGTH),
            self.context.ros.instance_id,
            self.context.domain_id,
            end.use_name,
            at=self._transport.announced_at,
            features=feature_names(),
            outlive=link.own_outlive,
        )
        if end.keeps_name_from(hello):
            return msgspec.structs.replace(welcome, taken=end.name_taken())
        if end.shut_down_by is not None:
            return msgspec.structs.replace(welcome, shut_down=end.shut_down_by.refusal())
        if link.association is not None and link.association.may_resume(hello):
            return msgspec.structs.replace(welcome, association=link.association.id, handled=link.handled)
        return welcome

    def established(self, stream: Stream, connection: ServerConnection, event: Established) -> ControlChannel:
        """Link an authenticated client; it replaces an older connection of its name."""
        assert isinstance(event.peer, Hello)
        end = self.ends[event.peer.name]
        link, known = end.link, end.link.association
        self.refused_clients.forget(link.name)
        if end.keeps_name_from(event.peer):  # since the handshake began
            raise Refusal(RefusalCode.NAME_TAKEN, end.name_taken())
        if event.answer is None or not event.answer.association:
            text = f"replaced: {link.name} at {end.address} by a newer connection from {stream.peer}"
            link.leave(text, retry_after=_REPLACED_PAUSE, code=EventCode.LINK_REPLACED)
        elif known is None or not known.may_resume(event.peer) or known.handled != event.answer.handled:
            raise Refusal(RefusalCode.BUSY, "its association has moved on meanwhile: try again")
        return end.accept(stream, connection, event)

    def attach(self, stream: Stream, connection: ServerConnection, event: Attach) -> None:
        """Attach a stream that was opened for routes' data; raise Refusal if none needs it."""
        if (end := self._end_of(event.link_id)) is None:
            raise Refusal(RefusalCode.NO_SUCH_ROUTE, UNKNOWN_ROUTE)
        end.channels.accept(stream, connection, event)

    def refused(self, name: str, stream: Stream, code: RefusalCode, message: str) -> str:
        """Show on the link of that name that a client was refused; one of another version says no name.

        Return the name of the link that shows it, or an empty string.
        """
        end = self.ends.get(name)
        if end is None and code is RefusalCode.WRONG_VERSION:
            ends = self.ends.values()
            at_host = [each for each in ends if each.seen_host == stream.host] or list(ends)
            end = at_host[0] if len(at_host) == 1 else None
        cause = CAUSES.get(code, LinkCause.REFUSED)
        if end is None or end.link.linked:
            self.refused_clients.record_attempt(stream, name, cause, message)
        else:
            end.refused(stream, cause, message)
        return "" if end is None else end.link.name

    def _end_of(self, link_id: bytes) -> ServerEnd | None:
        return next((end for end in self.ends.values() if end.has_id(link_id)), None)

    def new_udp_channel(self, link_id: bytes, socket: DatagramSocket, address: Address) -> ServerUdpChannel | None:
        end = self._end_of(link_id)
        return end.channels.new_udp_channel(socket, address) if end is not None else None


class InboundStreams(PendingConnections):
    """The streams of clients that have not authenticated yet."""

    def __init__(self, server: Server) -> None:
        super().__init__(server.context, server.context.transports.strangers, _LIMITS)
        self._server = server

    def _expected(self, host: str) -> int:
        """Return how many streams linked clients have yet to open."""
        linked = (end.channels for end in self._server.ends.values() if end.link.linked)
        return sum(each.streams_awaited for each in linked if host in ("", each.control.stream.host))


class _InboundStream(PendingConnection, StreamHandler):
    rejected_code = EventCode.LINK_REJECTED

    def __init__(self, server: Server) -> None:
        super().__init__(server.pending)
        self._server = server
        self._connection: ServerConnection = server.connection()
        self._stream: Stream  # from `connected` on, which comes first

    def connected(self, stream: Stream) -> None:
        self._stream = stream
        if not self._arrive(stream.host, f"a client at {stream.peer}"):
            self.reject(Rejected.TOO_MANY())

    def closed(self, reason: Reason) -> None:
        self._leave()

    def _why_overdue(self) -> tuple[Rejected, str]:
        if self._stream.received_bytes:
            return super()._why_overdue()
        return Rejected.SENT_NOTHING, LinkCause.NO_ANSWER

    def received(self, data: bytes) -> None:
        stream, connection = self._stream, self._connection
        # The refusal may be delayed, and more may come until then.
        if self.stage in (ConnectionStage.REFUSED, ConnectionStage.OVER):
            return
        events = connection.receive_data(data)
        self.name = connection.name
        answer = connection.data_to_send()
        match events[0] if events else None:
            case None:
                # The answer first, without a tag: before it the client has no key to check one (PROTOCOL.md, 12).
                stream.write(answer)
                if connection.accepted and self.stage < ConnectionStage.ACCEPTED:
                    stream.authenticate(connection.sample_secret, opener=False)
                    self._accept()
            case Established() as event:
                self._leave()
                self._established(event, events[1:])
            case Attach() as event:
                self._leave()
                self._attach(event)
            case StreamRefused(code, message, Hello() as peer):
                self._leave()
                self._refuse_proven(code, message, peer)
            case StreamRefused(code, message):
                message = self._for_operator(code, message)
                self.name = self._server.refused(self.name, stream, code, message)
                log_code, cause = _CODES.get(code, EventCode.LINK_REJECTED), CAUSES.get(code, LinkCause.REFUSED)
                self._refuse(log_code, message, answer, cause, self.name)
            case Failed(reason, None):
                self._refuse(EventCode.LINK_REJECTED, reason, answer, link=self.name)
            case Failed(reason):
                text = f"{reason}: {_ONLY_BRIDGES}"
                self._refuse(EventCode.LINK_REJECTED, text, answer, LinkCause.NOT_A_BRIDGE, self.name)

    def _established(self, event: Established, more: list[Event]) -> None:
        try:
            control = self._server.established(self._stream, self._connection, event)
        except Refusal as refusal:
            assert isinstance(event.peer, Hello)
            self._stream.write(self._connection.refuse(refusal.code, refusal.message))
            self._refuse_proven(refusal.code, refusal.message, event.peer)
        else:
            self._stream.trust()
            control.receive(more)

    def _refuse_proven(self, code: RefusalCode, message: str, peer: Hello) -> None:
        """Refuse a client that has the key, which is no failed authentication, and show that on its link."""
        end = self._server.ends.get(peer.name)
        if end is not None and code is RefusalCode.NAME_TAKEN:
            end.duplicate_tried(self._stream.host, peer.host)
        elif end is not None and code is RefusalCode.SHUT_DOWN:
            end.asked(self._stream)
        self._log(_CODES.get(code, EventCode.LINK_REJECTED), message, link=self.name)
        self._stream.close(message)

    def _attach(self, event: Attach) -> None:
        try:
            self._server.attach(self._stream, self._connection, event)
            self._stream.trust()
        except Refusal as refusal:  # no failure of its host: the route may have been closed meanwhile
            self._log(EventCode.LINK_REJECTED, refusal.message, link=refusal.link)
            self._stream.write(self._connection.refuse(refusal.code, refusal.message))
            self._stream.close(refusal.message)

    def _busy(self, message: str) -> bytes:
        return self._connection.refuse(RefusalCode.BUSY, message)

    def _close_with(self, answer: bytes, message: str) -> None:
        self._stream.write(answer)
        self._stream.close(message)

    def _pause_reading(self) -> None:
        self._stream.pause_reading()

    def _for_operator(self, code: RefusalCode, message: str) -> str:
        """Return the refusal with the remedy for this side's operator, which the client does not get."""
        match code:
            case RefusalCode.WRONG_KEY:
                remedy = "copy one side's key file to the other"
            case RefusalCode.UNKNOWN_NAME:
                session = self._server.context.session
                correct = "correct name" if session.clients is not None else f"set name to {session.name!r}"
                remedy = f"rsb-console client add {shlex.quote(self.name)}, or {correct} in the robot's session"
            case RefusalCode.ENCRYPTION_NOT_POSSIBLE:
                remedy = "set use_encryption and its key_file here, or use_encryption: false there"
            case RefusalCode.ENCRYPTION_REQUIRED:
                remedy = "set use_encryption and key_file there, or use_encryption: false here"
            case _:
                return message
        return f"{message}: {remedy}"

"""The client's end of a link: connects to the server, and reconnects whenever the link is lost."""

from __future__ import annotations

import asyncio
import contextlib
import shlex
import socket
from math import inf
from typing import TYPE_CHECKING, final

import msgspec

from rsb_bridge.config.keys import Key, fingerprint
from rsb_bridge.config.rights import rights_of_server
from rsb_bridge.link.client_channels import ClientChannels
from rsb_bridge.link.connecting import (
    ConnectAttempt,
    Failure,
    LetIn,
    ProvenServer,
    failure_of_search,
    find_servers,
    unproven_servers,
)
from rsb_bridge.link.link import Link
from rsb_bridge.link.refused_clients import ASKED_EVERY, NAME_TRIED_EVERY, REMEDY, server_refusal
from rsb_bridge.link.server_ways import ServerWays, first_of
from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.transports import profile_of
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.network_news import NameText, has_network
from rsb_bridge.transport.streams import Stream, os_error_message
from rsb_bridge.transport.trials import Trials
from rsb_bridge.wire.connection import ClientConnection, DataConnection
from rsb_bridge.wire.events import Accepted, Established, Event, RefusalCode
from rsb_bridge.wire.messages import Duplicate, Shutdown, Welcome

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.config.rights import Rights
    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.model.session import Identity, Kind, Topic
    from rsb_bridge.model.snapshot import WaySnapshot
    from rsb_bridge.model.transports import LinkProfile
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.network_news import NetworkNews
    from rsb_bridge.transport.transport import StreamTransport
    from rsb_bridge.wire.messages import Hello, Propose
    from rsb_bridge.wire.sealing import CipherSuite, ConnectionKeys

_HANDSHAKE_TIMEOUT = 10.0  # s for an answer, as long as a server waits for a handshake (`pending_connections`)
_KEY_CHANGED = "the client has another key now"

# s between attempts, before jitter.
_FIRST_DELAY = 0.5  # before the first further attempt: a round figure
_FIRST_DELAY_AWAY = 0.1  # the same while the server waits with the association; the first attempt comes at once
_LASTING = 1.0  # s of a connection that has not failed: one that ends sooner, again and again, must not come at once
_LONGEST_DELAY_UNREACHED = 1.0  # once the server is back, the link must be up within 3 s, with handshake and discovery
# While the server refuses: its answer seldom changes soon. A round figure, on which servers rely: they forget a client
# that has not tried for longer (`refused_clients.FORGOTTEN_AFTER`).
_LONGEST_DELAY = 8.0
_LONGEST_RETRY_AFTER = 60.0  # that a server may ask for (PROTOCOL.md, 3): a wrong figure must not keep it away
# Share of a delay: all clients of a server lose it at one moment, and must not all come back at another. The first
# attempts of 200 clients come within 0.5 s; with a fifth, it was 0.2 s.
_JITTER = 0.5
# Attempts that come soon although another client has this one's name. They take about 4.5 s, in which one that is dead
# has lost it (`server_end._SILENT`).
_NAME_MAY_BE_FREED = 5

# s after which a move to a better way begins: an association moves on while messages that count (reports do) are few.
_REPORTS_FIRST = 0.1
_DUPLICATES_LOGGED_EVERY = 60.0  # s between lines about one more client of this one's name: a round figure


@final
class ClientEnd:
    """The client's end of its one link, which it makes.

    Attributes:
        ways: the addresses of the server.
        udp_failure: the last reason why no socket for datagrams could be opened, or an empty string.
    """

    def __init__(self, context: Context, hello: Hello, key: Key | None, suite: CipherSuite) -> None:
        session = context.session
        self._context = context
        self._port = session.server_port
        self._moves_to: str | None = None  # a better way, while the present one carries
        self._hello = hello
        self.key = key
        self._suite = suite
        self._changed = asyncio.Event()
        self._call_at = inf  # time of the next attempt
        self._attempt: asyncio.Timeout | None = None
        self._attempted_from: list[str] = []
        self._connected_at = -inf
        self._retry_after = 0.0
        self._stays_down = False
        self._news: NetworkNews | None = None
        self._source = ""  # address on this machine that the last connection had
        self._longest = _LONGEST_DELAY_UNREACHED
        self._duplicates_logged_at = 0.0
        self.udp_failure = ""
        self._backoff = Backoff(_FIRST_DELAY, _LONGEST_DELAY, context.random, _JITTER)
        self._returning = Backoff(_FIRST_DELAY_AWAY, _LONGEST_DELAY_UNREACHED, context.random, _JITTER)
        self._asking = Backoff(ASKED_EVERY, ASKED_EVERY, context.random)
        self._trials: Trials[ProvenServer] = Trials(context.now, _HANDSHAKE_TIMEOUT)
        self.link = Link(context, session.name, self, is_client=True, encrypted=key is not None)
        self.link.handlers |= {Duplicate: self._on_duplicate, Shutdown: self._on_shutdown}
        self.ways = ServerWays(self.link, session.hosts)

    @property
    def address(self) -> str:
        return self.link.transport.format_address((self.ways.hosts[self.ways.used], self._port))

    @property
    def fingerprints(self) -> tuple[str, str]:
        return fingerprint(self.key) if self.key is not None else "", ""

    @property
    def profile(self) -> LinkProfile:
        return profile_of(self._context.session.profile)

    def shared_port(self) -> int:
        return self._port

    @property
    def use_name(self) -> bool:
        return self._context.session.use_name or (isinstance(self.link.peer, Welcome) and self.link.peer.use_name)

    @property
    def prefixed(self) -> bool:
        return self._context.session.use_name

    def with_local_name(self, proposal: Propose) -> Propose:
        return proposal

    def client_names(self, topic: Topic) -> Topic:
        return topic

    def shows(self, topic: str, kind: Kind = "topic") -> bool:
        return self.rights.shows(topic, kind)

    async def prepare_port(self, route: Route) -> None:
        return

    # --- calling

    async def run(self) -> None:
        """Connect and reconnect for ever. First close the connection of an earlier run."""
        self.link.fail()
        self._call_in(0.0)
        self._news = self.link.transport.network_news(self.hurry)
        with contextlib.nullcontext() if self._news is None else contextlib.closing(self._news):
            while True:
                await self._until_due()
                await self._call()

    async def _until_due(self) -> None:
        """Wait for the time of the next attempt, which may change meanwhile."""
        while (wait := self._call_at - self._context.now()) > 0:
            self._changed.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(None if wait == inf else wait):
                    await self._changed.wait()

    def _call_in(self, seconds: float) -> None:
        """Begin the next attempt so much later, or with `inf` not before another event."""
        self._call_at = self._context.now() + seconds
        self.link.status.retry_at = None if self.link.linked or seconds == inf else self._call_at
        self._changed.set()

    def retry(self) -> None:
        """Connect now instead of after the delay, and propose refused routes again."""
        self._stays_down = False
        if not self.link.linked:
            self._call_in(0.0)
        self.link.table.retry()

    def hurry(self) -> None:
        """Look for the server now: this machine's devices, addresses or routes have changed.

        Without a connection, an attempt begins, and it replaces one from an address that has changed. A connection has
        two round trips to show that it still carries; then the client tries a second one.
        """
        self.ways.changed()
        if self._attempt is not None:
            if self._sources() != self._attempted_from:
                self._attempt.reschedule(self._context.loop.time())
        elif self.link.linked:
            self.link.send(self.link.keepalive.ping(self.link.handled))
            self.link.keepalive.hurry()
            if self._news is not None and self._news.why_silent(self._source):
                self._call_in(0.0)
        elif not self._stays_down and self.link.status.cause is not LinkCause.SHUT_DOWN:
            self._call_in(0.0)

    def _sources(self) -> list[str]:
        """Return the addresses from which new connections leave."""
        return [self.link.transport.source_address(host) for host in self.ways.hosts]

    def doubts(self) -> None:
        if self._attempt is None and self._call_at == inf:
            self._call_in(0.0)

    async def _call(self) -> None:
        """Try once to connect; the present connection, if there is one, stays meanwhile."""
        self._call_at, self._retry_after, key, connections = inf, 0.0, self.key, self.link.connections
        began = self._context.now()
        if self.link.linked:
            self.link.send(self.link.keepalive.ping(self.link.handled))  # if it is answered first, the connection stays
        elif not self.link.status.attempts:
            self.link.log(Level.INFO, EventCode.LINK_CONNECTING, f"connecting to {self.link.peer_at}", link_status=True)
        else:
            self.link.status.retry_at = began  # consoles show 0 s as a running attempt
        self._attempted_from = self._sources()
        failure: Failure | None = None
        try:
            async with asyncio.timeout(None) as self._attempt:
                failure = await self._connect(key)
        except TimeoutError:  # `hurry` or `tick` has ended it
            pass
        finally:
            self._attempt, moved_to, self._moves_to = None, self._moves_to, None
        if failure is not None:
            if moved_to is not None:
                self.ways.failed(moved_to)
            self._failed(failure, self._context.now() - began)
        elif self.link.connections == connections:  # it was ended, or was not needed any more
            if not self.link.linked and not self._stays_down and self._call_at == inf:
                self._call_in(0.0)
        elif self._stays_down:  # an operator did so during the handshake
            self.link.leave("shut down", retry_after=None)
        elif key is not self.key:  # changed during the handshake
            self.link.leave(_KEY_CHANGED, retry_after=0.0)

    async def _connect(self, key: Key | None) -> Failure | None:
        """Connect to the server, or to the announced one that proves the key. Return the failure, if any."""
        secret, began = key.secret if key else None, self._context.now()
        hello = msgspec.structs.replace(self._hello, outlive=self.link.own_outlive)
        acknowledged = 0
        if self.link.association is not None:
            hello = msgspec.structs.replace(hello, association=self.link.association.id, handled=self.link.handled)
            acknowledged = self.link.association.acknowledged

        def begin(suite: CipherSuite | None) -> ClientConnection:
            return ClientConnection(hello, secret, suite or self._suite, multiplexed=self.link.transport.multiplexed)

        def is_needed(event: Established) -> bool:
            """Whether nothing has come on the present connection since the attempt began, or another way is better.

            What both sides have handled must be what they said, too: the present connection may have moved it on.
            """
            is_alive = self.link.linked and self._moves_to is None and self.link.keepalive.carried_since(began)
            present = self.link.association
            said = (b"", 0) if present is None else (present.id, present.handled)
            if is_alive or said != (hello.association, hello.handled):
                return False
            # Where nothing was acknowledged meanwhile, a wrong number is a breach of the protocol.
            if present is None or present.acknowledged == acknowledged:
                return True
            return present.could_resume(event)

        if key is not None:  # without a key nothing proves a server: the transport connects to the only one, or refuses
            try:
                hosts = await self.link.transport.servers()
            except OSError as error:
                return _not_connected(self.address, error)
            if hosts is not None:
                return await self._find(hosts, begin, is_needed)

        async def connect(host: str) -> Failure | None:
            connection = begin(None)

            def linked(stream: Stream, event: Established | Accepted, more: list[Event]) -> None:
                assert isinstance(event, Established)
                if not is_needed(event):
                    stream.abort("not needed")
                    return
                self.ways.take(host)
                self._take(stream, connection, event, more)

            return await self.open(self.link.transport, host, self._port, connection, linked)

        return await first_of(self.ways.next_hosts() if self._moves_to is None else (self._moves_to,), connect)

    def _take(self, stream: Stream, connection: ClientConnection, event: Established, more: list[Event]) -> None:
        """Link over a new connection, with a new association if the server has begun one.

        The first message takes the confirmation along, after this side has left the connection before: the server takes
        all that was armed for disarmed then.
        """
        if self.link.control is not None and isinstance(event.peer, Welcome) and not event.peer.association:
            self.link.control.abort("the server has begun a new association")
        self._source = stream.own_address
        control = self.link.up(stream, connection, event)
        self._connected_at = self._context.now()
        self._call_in(inf)
        control.receive(more)

    async def _find(
        self,
        hosts: list[str],
        begin: Callable[[CipherSuite | None], ClientConnection],
        is_needed: Callable[[Established], bool],
    ) -> Failure | None:
        """Connect to the announced server that proves the key. Return the failure, or None if the link is up."""
        proven, failures, unproven = await find_servers(self._trials, self.link.transport, hosts, begin)
        if proven:  # else the failure counts them
            if unproven and not self.link.fault.unproven:
                text = unproven_servers(unproven)
                self.link.log(Level.WARNING, EventCode.LINK_UNPROVEN_SERVERS, text, link_status=True)
            self.link.fault.unproven = unproven
        accepting = [each for each in proven if each.refusal is None]
        if len(accepting) == 1:
            server = accepting[0]
            if is_needed(server.established):
                established, more = server.confirm()
                self._take(server.stream, server.connection, established, more)
            else:
                server.give_up()
            return None
        # Several have the key, and nothing tells which of them is meant (PROTOCOL.md, 12).
        for each in accepting:
            each.give_up()
        if accepting:
            return Failure(self.link.transport.several([str(each.stream.address[0]) for each in accepting]))
        # A refusal with the key is the server's; anybody may have sent the failures.
        refusals = [self._with_remedy(each.refusal) for each in proven if each.refusal is not None]
        failures = [self._with_remedy(each) for each in failures]
        return refusals[0] if refusals else failure_of_search(self.link.transport, hosts, failures)

    def _with_remedy(self, failure: Failure) -> Failure:
        match failure.code:
            case RefusalCode.WRONG_KEY if self.key is not None:
                remedy = "copy one side's key file to the other"
            case RefusalCode.NAME_TAKEN:
                remedy = REMEDY
            case RefusalCode.SHUT_DOWN:
                return failure._replace(reason=server_refusal(failure.reason))
            case RefusalCode.UNKNOWN_NAME:
                add = f"rsb-console client add {shlex.quote(self.link.name)}"
                remedy = f"run {add} on the server, or correct name in this side's session"
            case RefusalCode.ENCRYPTION_REQUIRED:
                remedy = "set use_encryption and key_file"
            case RefusalCode.ENCRYPTION_NOT_POSSIBLE:
                remedy = "give the server the key, or set use_encryption: false here"
            case _:
                return failure
        return failure._replace(reason=f"{failure.reason}: {remedy}")

    async def open(
        self,
        transport: StreamTransport,
        host: str,
        port: int,
        connection: ClientConnection | DataConnection,
        let_in: LetIn,
        rank: int | None = None,
        sample_secret: bytes | None = None,
    ) -> Failure | None:
        """Connect, and wait for the answer. Return the failure, or None if the server accepted the stream."""
        address = transport.format_address((host, port))
        attempt = ConnectAttempt(connection, address, let_in, sample_secret)
        try:
            await transport.connect(host, port, attempt, rank)
            async with asyncio.timeout(_HANDSHAKE_TIMEOUT):
                failure = await asyncio.shield(attempt.outcome)  # `silence` goes on waiting for it
        except OSError as error:
            # The answer came as the time ran out, so the link is up. A further connection would end it, and so on for
            # minutes.
            if attempt.outcome.done():
                failure = attempt.outcome.result()
            elif attempt.connects and isinstance(error, TimeoutError):
                is_new = self.link.peer is None and self.link.status.cause is not LinkCause.NO_ANSWER
                failure = await attempt.silence(probe=is_new)
            else:
                failure = _not_connected(address, error)
        finally:
            attempt.end()
        return None if failure is None else self._with_remedy(failure)

    def new_channels(self, control: ControlChannel, keys: ConnectionKeys) -> ClientChannels:
        return ClientChannels(self.link, self, control, keys)

    def why_lost(self, reason: str) -> str:
        """Return a failure's reason, with the fault of the network device that led to the server, if it has one."""
        wrong = self._news.why_silent(self._source) if self._news is not None and self._source else ""
        return f"{reason}; {wrong}" if wrong else reason

    def _failed(self, failure: Failure, took: float) -> None:
        """Log a failed attempt, which took so long (s), and plan the next one."""
        if self.link.linked:
            self.link.log(Level.DEBUG, EventCode.LINK_UNREACHABLE, f"no other connection: {failure.reason}")
            if self.link.keepalive.in_doubt:
                self._call_in(self._delay(took))
            return
        if not failure.refused:
            failure = failure._replace(reason=self.why_lost(failure.reason))
        self.link.status.attempts += 1
        self._longest = _LONGEST_DELAY_UNREACHED
        if failure.code is RefusalCode.NAME_TAKEN:  # the one that has the name may be dead, which shows within seconds
            if self.link.status.attempts > _NAME_MAY_BE_FREED:
                self._longest = NAME_TRIED_EVERY
        elif failure.refused:
            self._longest = _LONGEST_DELAY
        repeated = failure.reason == self.link.status.reason
        expected = self.link.status.cause is LinkCause.CLOSED  # the server said goodbye, and is not back yet
        self.link.status.down(failure.cause, failure.reason)
        code = EventCode.LINK_REFUSED if failure.refused else EventCode.LINK_UNREACHABLE
        # `peer_at` names the address already.
        reason = failure.reason.removeprefix(f"{self.address}: ")
        peer = "the server" if reason.startswith(f"{self.address} ") else self.link.peer_at
        level = Level.DEBUG if repeated else Level.WARNING if expected else Level.ERROR
        self.link.log(level, code, f"no link with {peer}: {reason}; trying again", link_status=True)
        if self._call_at == inf:  # else an operator has asked for the next one
            self._call_in(self._delay(took))

    def _delay(self, took: float = 0.0) -> float:
        """Return the time (s) until the next attempt; the last one took so long."""
        if self._stays_down:
            return inf
        if self.link.status.cause is LinkCause.SHUT_DOWN:
            return self._asking.next()
        if self.link.association is not None:  # an attempt that nobody answered was a pause, too
            delay = self._returning.next()
            return max(min(delay, _FIRST_DELAY_AWAY), delay - took)
        return max(self._backoff.next(self._longest), self._retry_after)

    def _on_duplicate(self, message: Duplicate) -> None:
        now = self._context.now()
        duplicates, begins = self.link.fault.duplicates, self.link.fault.cause() is not LinkCause.NAME_TAKEN
        duplicates.take_news(message, self._context.wall())
        if not message.address and not begins:
            self.link.log(Level.INFO, EventCode.LINK_NAME_FREE, duplicates.ended_text(), link_status=True)
        if message.address and (begins or now - self._duplicates_logged_at >= _DUPLICATES_LOGGED_EVERY):
            self._duplicates_logged_at = now
            self.link.log(Level.WARNING, EventCode.LINK_NAME_TAKEN, duplicates.text(now), link_status=True)

    def lost(self) -> None:
        self._longest = _LONGEST_DELAY_UNREACHED
        self._backoff.reset()
        if self.link.suspended_since is not None and self._context.now() - self._connected_at > _LASTING:
            self._returning.reset()
            self._call_in(0.0)
        else:
            self._call_in(self._delay())

    def _on_shutdown(self, message: Shutdown) -> None:
        control = self.link.channels.control
        self.link.reports.peer_leaves()
        if message.retry_after is None:
            control.abort(server_refusal(message.reason), EventCode.LINK_SHUT_DOWN)
        else:
            self._retry_after = min(message.retry_after, _LONGEST_RETRY_AFTER)
            control.abort(f"the server closed the link: {message.reason}", EventCode.LINK_CLOSED_BY_PEER)

    def change_key(self, key: Key | None) -> None:
        """Use another key from now on: a link that is up connects again."""
        self.key, self.link.encrypted = key, key is not None
        self.link.leave(_KEY_CHANGED, retry_after=0.0)
        self._call_in(0.0)

    @property
    def shut_down(self) -> bool:
        """Whether the link is down on purpose and waits for this side's operator."""
        return not self.link.linked and self._stays_down

    def stay_down(self, reason: str) -> None:
        """End the link, or the attempts at it, on purpose; then wait for `retry`."""
        self._stays_down = True
        self._call_in(inf)
        self.link.leave(reason, retry_after=None)
        # After the link's end, which sets a reason of its own.
        command = f"rsb-console retry {shlex.quote(self.link.name)}"
        self.link.status.down(LinkCause.CLOSED, f"{reason}; press r or run `{command}` to connect again")

    def tick(self) -> None:
        if self.link.fault.unproven:  # those whose announcements are gone; one of the rest is the linked server
            self.link.fault.unproven = min(self.link.fault.unproven, max(0, self.link.transport.announced_servers - 1))
        if not self.link.linked:
            return
        if self._attempt is None:
            self._moves_to = self.ways.tick()
            if self._moves_to is not None:
                self._call_in(_REPORTS_FIRST)
        elif self._moves_to is None and not self.link.keepalive.in_doubt:
            self._attempt.reschedule(self._context.loop.time())

    def ways_shown(self) -> tuple[WaySnapshot, ...]:
        return self.ways.snapshots()

    # --- routes

    @property
    def rights(self) -> Rights:
        return rights_of_server(self._context.session, self.link.table.listed)

    def change_listed(self, topics: set[Identity]) -> None:
        """Use the rights of another session, which lists these topics."""
        # What a pattern has made is in no file, and may stay for as long as it is there.
        self.link.table.listed = topics | {route.spec.identity for route in self.link.routes.values() if route.pattern}
        self.link.table.rights_changed()
        self.link.patterns.renew()


def _not_connected(address: str, error: OSError) -> Failure:
    if isinstance(error, TimeoutError):  # the kernel's own timeout is one, too
        return Failure(f"{address}: no answer: check that it is on, server_ip, and firewalls", LinkCause.TIMED_OUT)
    message = os_error_message(error)
    if isinstance(error, socket.gaierror):
        message = f"{message}: {_remedy_for_name(error)}"
    return Failure(f"{address}: {message}")


def _remedy_for_name(error: socket.gaierror) -> str:
    if error.errno == socket.EAI_AGAIN and not has_network():
        return NameText.NO_NETWORK()
    if error.errno == socket.EAI_AGAIN:
        return NameText.NO_NAME_SERVER()
    return "correct server_ip in this side's session file (a numeric address needs no name server)"

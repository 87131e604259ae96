"""The client's side of a link: connects to the server, and reconnects whenever the link is lost."""

from __future__ import annotations

import asyncio
import socket
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.channel.udp_channel import ClientUdpChannel
from rsb_bridge.config.keys import Key, fingerprint
from rsb_bridge.link.connecting import ConnectAttempt, Failure, LetIn
from rsb_bridge.link.control_channel import ControlChannel
from rsb_bridge.link.link import Link
from rsb_bridge.link.rival import REMEDY
from rsb_bridge.model.backoff import Backoff
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport import descriptors
from rsb_bridge.transport.streams import Stream, os_error_message
from rsb_bridge.wire.connection import ClientConnection, DataConnection
from rsb_bridge.wire.events import Accepted, Established, Event
from rsb_bridge.wire.messages import Welcome
from rsb_bridge.wire.preamble import RefusalCode

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.transport import DatagramTransport, StreamTransport
    from rsb_bridge.wire.messages import Hello, Propose, Shutdown
    from rsb_bridge.wire.sealing import Suite

_CAUSES: dict[RefusalCode | None, LinkCause] = {
    RefusalCode.WRONG_KEY: LinkCause.WRONG_KEY,
    RefusalCode.WRONG_VERSION: LinkCause.WRONG_VERSION,
    RefusalCode.UNKNOWN_NAME: LinkCause.UNKNOWN_NAME,
    RefusalCode.NAME_TAKEN: LinkCause.NAME_TAKEN,
}
_HANDSHAKE_TIMEOUT = 5.0
_FIRST_DELAY = 0.5
_LONGEST_DELAY_UNREACHED = 1.25
"""s between attempts while the server is not reached: once it is back, the link must be up within 3 s, with handshake
and DDS discovery."""
_MOVED_AND_QUIET = 1.5
"""s without a byte (pings come every second) after which a connection is closed whose source address this machine no
longer has."""
_LONGEST_DELAY = 10.0
"""s between attempts while the server refuses: its answer seldom changes soon."""
_KEY_CHANGED = "the client has another key now"
_NAME_MAY_BE_FREED = 5
"""Attempts that come soon although another client has this one's name."""
_UDP_RETRIED_AFTER = 1.0
_LONGEST_RETRY_AFTER = 60.0
"""s that a server may have this side wait; a wrong figure must not keep it away."""
_STREAMS_AT_ONCE = 128
"""Routes' streams being opened at a time: few enough for any listen backlog, enough for 500 in 1 s at 100 ms a round
trip."""


class ClientLink(Link):
    """The one link of a client."""

    def __init__(self, context: Context, hello: Hello, key: Key | None, suite: Suite) -> None:
        session = context.session
        mark = fingerprint(key) if key else ""
        super().__init__(context, session.name, is_client=True, fingerprint=mark, encrypted=key is not None)
        self.host, self.port = session.server_ip, session.server_port
        self._hello = hello
        self.key = key
        self._suite = suite
        self._ended = asyncio.Event()
        self._retry = asyncio.Event()
        self._retry_after = 0.0
        self._stays_down = False
        self._refused = False
        self._udp_failure = ""
        self._udp_retry: asyncio.TimerHandle | None = None
        self._backoff = Backoff(_FIRST_DELAY, _LONGEST_DELAY, context.random)
        self._streams_opening: dict[int, asyncio.Task[None]] = {}
        self._may_open = asyncio.Semaphore(_STREAMS_AT_ONCE)
        self._waiting: dict[int, dict[int, Route]] = {}  # by channel and id: for the stream that is being opened

    @property
    def address(self) -> str:
        return self.transport.format_address((self.host, self.port))

    def shared_port(self) -> int:
        return self.port

    @property
    def use_name(self) -> bool:
        return self.context.session.use_name or (isinstance(self.peer, Welcome) and self.peer.use_name)

    # --- calling

    async def run(self) -> None:
        """Connect, and reconnect, for ever. A connection that an earlier run left is closed first."""
        self.fail()
        while True:
            self._retry.clear()
            self._ended.clear()
            if not self._stays_down:
                self._retry_after = 0.0
                await self._call()
            await self._pause()

    def retry(self) -> None:
        """Connect now instead of after the delay, and propose refused routes again."""
        self._stays_down = False
        if not self.linked:
            self._retry.set()
        self.table.retry()

    async def _call(self) -> None:
        """One attempt; returns when it failed or when the link it made is over."""
        key = self.key
        if not self.attempts:
            self.log(Level.INFO, EventCode.LINK_CONNECTING, f"connecting to {self.address}", link_status=True)
        else:
            self.retry_at = self.context.now()
        secret = key.secret if key else None
        connection = ClientConnection(self._hello, secret, self._suite, multiplexed=self.transport.multiplexed)
        host = self.transport.host(self.context.session)
        failure = await self._open(self.transport, host, self.port, connection, partial(self._linked, connection))
        if failure is not None:
            self._failed(failure)
            return
        self._refused = False
        self._backoff.reset()
        if self._stays_down and self.control is not None:  # decided during the handshake
            self.control.shut_down("shut down", retry_after=None)
        elif key is not self.key and self.control is not None:  # likewise
            self.control.shut_down(_KEY_CHANGED, retry_after=0.0)
        await self._ended.wait()

    async def _open(
        self,
        transport: StreamTransport,
        host: str,
        port: int,
        connection: ClientConnection | DataConnection,
        let_in: LetIn,
    ) -> Failure | None:
        """Connect, and wait for the server's answer; None: the server accepted the stream."""
        attempt = ConnectAttempt(connection, self.address, self._refusal_message, let_in)
        try:
            await transport.connect(host, port, attempt)
            async with asyncio.timeout(_HANDSHAKE_TIMEOUT):
                return await attempt.outcome
        except OSError as error:
            return Failure(f"{transport.format_address((host, port))}: {_connect_error_message(error)}", refused=False)
        finally:
            attempt.end()

    def _linked(
        self, connection: ClientConnection, stream: Stream, event: Established | Accepted, more: list[Event]
    ) -> None:
        assert isinstance(event, Established)
        control = ControlChannel(stream, connection, self)
        self.up(control, event.peer, event.keys)
        control.take(more)

    def _failed(self, failure: Failure) -> None:
        self.attempts += 1
        # The one that has the name may be dead, which shows within seconds.
        self._refused = failure.refused and (
            failure.code is not RefusalCode.NAME_TAKEN or self.attempts > _NAME_MAY_BE_FREED
        )
        repeated = failure.reason == self.reason
        expected = self.cause is LinkCause.CLOSED  # the server said goodbye, and is not back yet
        refused = _CAUSES.get(failure.code, LinkCause.REFUSED)
        self.set_down(refused if failure.refused else LinkCause.UNREACHABLE, failure.reason)
        code = EventCode.LINK_REFUSED if failure.refused else EventCode.LINK_UNREACHABLE
        level = Level.DEBUG if repeated else Level.WARNING if expected else Level.ERROR
        self.log(level, code, f"{failure.reason}; trying again", link_status=True)

    async def _pause(self) -> None:
        """Wait until the next attempt is due, or an operator asks for one."""
        delay: float | None = None
        if not self._stays_down:
            longest = _LONGEST_DELAY if self._refused else _LONGEST_DELAY_UNREACHED
            delay = max(self._backoff.next(longest), self._retry_after)
            self.retry_at = self.context.now() + delay
        try:
            async with asyncio.timeout(delay):
                await self._retry.wait()
        except TimeoutError:
            pass
        self.retry_at = None

    def lost(self, reason: str, code: EventCode) -> None:
        super().lost(reason, code)
        for opening in self._streams_opening.values():
            opening.cancel()
        self._streams_opening.clear()
        self._waiting.clear()
        self._ended.set()

    def on_shutdown(self, message: Shutdown) -> None:
        self._stays_down = message.retry_after is None
        self._retry_after = min(message.retry_after or 0.0, _LONGEST_RETRY_AFTER)
        if self.control is not None:
            self.control.abort(f"the server closed the link: {message.reason}", EventCode.LINK_CLOSED_BY_PEER)

    def change_key(self, key: Key | None) -> None:
        """Use another key from now on: a link that is up connects again."""
        self.key, self.encrypted = key, key is not None
        self.fingerprint = fingerprint(key) if key is not None else ""
        if self.control is not None:
            self.control.shut_down(_KEY_CHANGED, retry_after=0.0)
        self._retry.set()

    def _refusal_message(self, code: RefusalCode, message: str) -> str:
        """What the operator of this side is told."""
        match code:
            case RefusalCode.WRONG_KEY if self.key is not None:
                return f"{message} (this side's is {self.fingerprint}): copy one side's key file to the other"
            case RefusalCode.NAME_TAKEN:
                return f"{message}: {REMEDY}"
            case RefusalCode.UNKNOWN_NAME:
                remedy = "set name in this side's session file to one that the server lets in"
                return f"{message}: {remedy}, or list {self.name!r} under clients in the server's"
            case RefusalCode.ENCRYPTION_REQUIRED:
                return f"{message}: set use_encryption and key_file"
            case _:
                return message

    @property
    def shut_down(self) -> bool:
        """Whether the link is down on purpose and waits for an operator."""
        return not self.linked and self._stays_down

    def stay_down(self, reason: str) -> None:
        """End the link, or the attempts at it, on purpose; then wait for `retry`."""
        self._stays_down = True
        self._retry.set()
        if self.control is not None:
            self.control.shut_down(reason, retry_after=None)

    def tick(self) -> None:
        super().tick()
        if self.control is None or self.keepalive.quiet < _MOVED_AND_QUIET:
            return
        stream = self.control.stream
        now_from = self.transport.source_address(stream.address)
        if now_from not in ("", stream.own_address):
            self.control.abort(
                f"this machine's address towards {self.host} changed: {stream.own_address} to {now_from}"
            )

    # --- routes

    def authorize(self, proposal: Propose) -> Propose:
        return proposal

    def shows(self, topic: str) -> bool:
        return True

    async def prepare_port(self, route: Route) -> None:
        return

    def open_stream(self, route: Route, transport: StreamTransport) -> None:
        if transport.multiplexed:
            self._share_stream(route, transport)
        elif route.id not in self._streams_opening:
            self._streams_opening[route.id] = self.spawn(self._open_stream(route, route.id, transport))

    async def _open_stream(self, route: Route, route_id: int, transport: StreamTransport) -> None:
        try:
            async with self._may_open:
                failure = await self._attach(route, route_id, transport) if route.id == route_id else None
            if failure is not None and route.id == route_id:
                route.channel_lost(failure.reason)
        finally:
            self._streams_opening.pop(route_id, None)

    async def _attach(self, route: Route, route_id: int, transport: StreamTransport) -> Failure | None:
        assert self.keys is not None
        assert self.control is not None
        if descriptors.scarce():
            return Failure(descriptors.scarcity_message("client"), refused=False)
        connection = DataConnection(self.keys, route_id)

        def let_in(stream: Stream, event: Established | Accepted, more: list[Event]) -> None:
            if route.id == route_id:  # else it was closed meanwhile
                self.attach_stream(route, stream, connection.leftover(), multiplexed=transport.multiplexed)

        # The address that the control connection reached: the server's name may resolve to another by now.
        host = self.control.stream.host if transport is self.transport else transport.host(self.context.session)
        return await self._open(transport, host, route.proposal.port or self.port, connection, let_in)

    def _share_stream(self, route: Route, transport: StreamTransport) -> None:
        """Join the stream of the route's channel, or open it if nobody has begun to."""
        assert self.keys is not None
        assert self.data_keys is not None
        channel = route.proposal.port
        shared = self.shared_streams.get((transport.name, channel))
        if shared is not None and not shared.stream.over:
            shared.stream.write(DataConnection(self.keys, route.id).start())
            route.channel = shared.carry(route, self.data_keys)
        elif channel in self._waiting:
            self._waiting[channel][route.id] = route
        else:
            self._waiting[channel] = {route.id: route}
            self._streams_opening[route.id] = self.spawn(self._open_shared(route, route.id, transport))

    async def _open_shared(self, first: Route, first_id: int, transport: StreamTransport) -> None:
        try:
            failure = await self._attach(first, first_id, transport)
        finally:
            self._streams_opening.pop(first_id, None)
        waiting = self._waiting.pop(first.proposal.port, {})
        if first.id != first_id:  # it was closed meanwhile, and the others ask again
            return
        for route_id, route in waiting.items():
            if route.id == route_id and failure is not None:
                route.channel_lost(failure.reason)
            elif route.id == route_id:
                route.advance()

    def open_udp_channel(self, transport: DatagramTransport, port: int) -> ClientUdpChannel | None:
        assert self.control is not None
        assert self.path_probe is not None
        address = self.control.stream.address
        server = (address[0], port, *address[2:])
        try:
            udp_channel = ClientUdpChannel(transport, server, self.path_probe, self.context.now, self.udp_ready)
        except OSError as error:
            self._udp_failed(f"UDP to {transport.format_address(server)}: {os_error_message(error)}")
            return None
        self._udp_failure = ""
        return udp_channel

    def _udp_failed(self, text: str) -> None:
        if text != self._udp_failure:
            self._udp_failure = text
            self.log(Level.ERROR, EventCode.LINK_UDP_BLOCKED, text)
        if self._udp_retry is None:
            self._udp_retry = self.context.loop.call_later(_UDP_RETRIED_AFTER, self._retry_udp)

    def _retry_udp(self) -> None:
        self._udp_retry = None
        self.udp_ready()


def _connect_error_message(error: OSError) -> str:
    if isinstance(error, socket.gaierror):
        remedy = "correct server_ip in this side's session file (an address in numbers needs no name server)"
        return f"{os_error_message(error)}: {remedy}"
    return os_error_message(error)

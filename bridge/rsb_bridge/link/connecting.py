"""A client's stream until a server accepts or refuses it: at one address, or among servers that a network announces."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.link.refused_clients import CAUSES
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.streams import Stream, StreamHandler, os_error_message
from rsb_bridge.transport.trials import Trials, UnprovenError
from rsb_bridge.wire.events import Accepted, Established, Event, Failed, StreamRefused

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from rsb_bridge.model.reason import Reason
    from rsb_bridge.transport.transport import StreamTransport
    from rsb_bridge.wire.connection import ClientConnection, DataConnection
    from rsb_bridge.wire.events import RefusalCode
    from rsb_bridge.wire.sealing import CipherSuite

_EMPTY_LINE = b"\r\n\r\n"
_PROBED_FOR = 0.5
"""s to wait for a program that answers once it has read a whole line. A round figure: nothing was measured."""
_REFUSED_AFTER = 1.5
"""s from a refusal, which anybody can forge, until it counts: the server's own answer may follow (PROTOCOL.md, 12)."""
_SEARCH_REMEDY = "set access control on the router"

LetIn: TypeAlias = "Callable[[Stream, Established | Accepted, list[Event]], None]"
"""Gives an accepted stream its new handler. The events followed the server's answer."""


class Failure(NamedTuple):
    """The reason why the server did not accept a stream."""

    reason: str  # of a refusal, the server's, without a remedy
    cause: LinkCause = LinkCause.UNREACHABLE
    code: RefusalCode | None = None  # of the server's refusal, or None if it did not refuse

    @property
    def refused(self) -> bool:
        """Whether the server or another program answered; otherwise the server was not reached."""
        return self.code is not None or self.cause is LinkCause.NOT_A_BRIDGE


class ConnectAttempt(StreamHandler):
    """Handles a stream until the server accepts or refuses it.

    Args:
        connection: the state machine of the handshake, or of a route's data preamble.
        address: of the server, for messages.
        sample_secret: both sides have it already, or None.

    Attributes:
        outcome: the failure, or None if the server accepted the stream.
    """

    def __init__(
        self,
        connection: ClientConnection | DataConnection,
        address: str,
        let_in: LetIn,
        sample_secret: bytes | None = None,
    ) -> None:
        self.outcome: asyncio.Future[Failure | None] = asyncio.get_running_loop().create_future()
        self._connection, self._address, self._let_in = connection, address, let_in
        self._sample_secret = sample_secret
        self._stream: Stream | None = None
        self._given_up = False

    @property
    def connects(self) -> bool:
        """Whether the stream is or was connected."""
        return self._stream is not None

    def connected(self, stream: Stream) -> None:
        self._stream = stream
        stream.write(self._connection.start())
        stream.authenticate(self._sample_secret, opener=True)

    def received(self, data: bytes) -> None:
        stream = self._stream
        assert stream is not None
        events = self._connection.receive_data(data)
        if not events or not isinstance(events[0], Established):  # which its receiver confirms, or does not
            stream.write(self._connection.data_to_send())
        if not events:
            return
        match events[0]:
            case Established() | Accepted() if self._given_up:  # the next attempt would end a link that came up now
                stream.abort("it answered too late")
            case Established() | Accepted() as event:
                self._finish(None)
                stream.trust()
                self._let_in(stream, event, events[1:])
            case event:
                if isinstance(event, StreamRefused):
                    stream.close("refused")  # after the remaining bytes
                self._finish(_failure_of(event, self._address))

    def closed(self, reason: Reason) -> None:
        text = f"{self._address}: {reason.text} before the handshake finished"
        if not self._heard:
            text = f"{text}: check that rsb-console runs there, and any tunnel to it"
        self._finish(Failure(text))

    async def silence(self, *, probe: bool) -> Failure:
        """Give up a stream that the server accepts and does not answer.

        Args:
            probe: send an empty line first, because many programs answer only to a whole line. A bridge that hangs
                would read it as a broken handshake, so do this only where no bridge has ever answered.
        """
        self._given_up = True
        if probe and self._stream is not None and not self._stream.over:
            self._stream.write(_EMPTY_LINE)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_PROBED_FOR):
                    answer = await asyncio.shield(self.outcome)
                    # One that only closes the stream tells nothing about itself.
                    if answer is not None and answer.cause is LinkCause.NOT_A_BRIDGE:
                        return answer
        if self._heard:
            return Failure(_not_a_bridge(self._address, ""), LinkCause.NOT_A_BRIDGE)
        return _no_answer(self._address)

    @property
    def _heard(self) -> bool:
        return self._stream is not None and self._stream.received_bytes > 0

    def end(self) -> None:
        """Close the stream, unless the server accepted it."""
        if self._stream is not None and self._stream.handler is self and not self._stream.over:
            self._stream.abort("not accepted")

    def _finish(self, outcome: Failure | None) -> None:
        if not self.outcome.done():
            self.outcome.set_result(outcome)


def _no_answer(address: str) -> Failure:
    remedy = "check there that rsb-console runs and does not hang (ss -lntp there)"
    return Failure(f"{address} accepts, but does not answer: {remedy}", LinkCause.NO_ANSWER)


def _failure_of(event: Event, address: str) -> Failure:
    match event:
        case StreamRefused(code, message):
            return Failure(message, CAUSES.get(code, LinkCause.REFUSED), code)
        case Failed(_, str() as foreign):
            return Failure(_not_a_bridge(address, foreign), LinkCause.NOT_A_BRIDGE)
        case Failed(reason):
            return Failure(f"{address} does not speak this protocol: {reason}", LinkCause.NOT_A_BRIDGE)
        case _:
            return Failure(f"{address}: unexpected {type(event).__name__}", LinkCause.NOT_A_BRIDGE)


def _not_a_bridge(address: str, protocol: str) -> str:
    """Name the program that answers instead, and the remedy.

    Args:
        protocol: the other program's, or an empty string if it is unknown.
    """
    what = f"{address} answers as {protocol}, not as rsb-console" if protocol else f"{address} is not an rsb-console"
    if protocol == "Zenoh":
        return f"{what}: for a link over Zenoh set server_ip: zenoh"
    return f"{what}: correct server_ip or server_port"


def unproven_servers(count: int) -> str:
    """Return the warning for an operator that so many announced servers did not prove the key."""
    what = "1 other announced server has" if count == 1 else f"{count} other announced servers have"
    return f"{what} not proven the key: {_SEARCH_REMEDY}"


def failure_of_search(transport: StreamTransport, hosts: list[str], failures: list[Failure]) -> Failure:
    """Return the failure of a search in which no announced server proved the key."""
    silent = _no_answer(transport.format_address((hosts[0], 0)))
    failure = next((each for each in failures if each.refused), (*failures, silent)[0])
    if len(hosts) == 1:
        return failure
    text = f"none of {len(hosts)} announced servers has proven the key: {_SEARCH_REMEDY}; one says: {failure.reason}"
    return failure._replace(reason=text)


class ProvenServer(NamedTuple):
    """A server that has proven the key, or refused this client with the key; it waits for `confirm` or `give_up`."""

    stream: Stream
    connection: ClientConnection
    events: list[Event]
    refusal: Failure | None  # the server's, or None if it accepts the client

    @property
    def established(self) -> Established:
        """The event of the handshake of a server that accepts."""
        established = self.events[0]
        assert isinstance(established, Established)
        return established

    def confirm(self) -> tuple[Established, list[Event]]:
        """Return the event of the handshake, which the first message confirms, and what followed.

        The stream needs another handler at once.
        """
        self.stream.resume_reading()  # which delivers later
        return self.established, self.events[1:]

    def give_up(self) -> None:
        self.stream.abort("not accepted")


def _proven(stream: Stream, connection: ClientConnection, events: list[Event], address: str) -> ProvenServer:
    stream.adopt()
    stream.authenticate(connection.sample_secret, opener=True)
    if isinstance(events[0], Established):
        stream.trust()
        stream.pause_reading()  # what follows is for the handler that the stream gets with `confirm`
        return ProvenServer(stream, connection, events, None)
    stream.write(connection.data_to_send())
    stream.close("refused")
    return ProvenServer(stream, connection, events, _failure_of(events[0], address))


class _Try(StreamHandler):
    """One stream to an announced server, which strangers may answer, too."""

    def __init__(self, search: _HostSearch, connection: ClientConnection) -> None:
        self._search = search
        self._connection = connection
        self._stream: Stream | None = None
        self._refusal: Failure | None = None
        self._over = False

    def connected(self, stream: Stream) -> None:
        self._stream = stream
        stream.begin_trial()
        stream.write(self._connection.start())

    def received(self, data: bytes) -> None:
        assert self._stream is not None
        if self._over:
            return
        # Each answer is tried by itself: that of a stranger, who may be first, must not use up the handshake.
        connection = self._connection.fork()
        events = connection.receive_data(data)
        if connection.proven:
            if connection.at in ("", self._search.host):  # else a stranger relays another server's answer
                self._over = True
                self._search.finish(_proven(self._stream, connection, events, self._search.address))
        elif not events and connection.suite is not self._connection.suite:
            self._search.ask(connection.suite)
        elif events and self._refusal is None:
            self._refusal = _failure_of(events[-1], self._search.address)
            asyncio.get_running_loop().call_later(_REFUSED_AFTER, self._end, self._refusal)

    def closed(self, reason: Reason) -> None:
        self._end(self._refusal or Failure(f"{self._search.address}: {reason.text} before the handshake finished"))

    def _end(self, failure: Failure) -> None:
        if not self._over:
            self.give_up()
            self._search.finish(failure)

    def give_up(self) -> None:
        """Close the stream, unless the server has proven the key."""
        if not self._over:
            self._over = True
            if self._stream is not None:
                self._stream.abort("not accepted")


class _HostSearch:
    """The search for the key behind one announced host, with a stream for each cipher suite that is asked for."""

    def __init__(
        self, transport: StreamTransport, host: str, begin: Callable[[CipherSuite | None], ClientConnection]
    ) -> None:
        self.host = host
        self.address = transport.format_address((host, 0))
        self._transport = transport
        self._begin = begin
        self._tries: list[_Try] = []
        self._connecting: list[asyncio.Task[None]] = []
        self._asked: set[CipherSuite | None] = set()
        self._outcome: asyncio.Future[ProvenServer] = asyncio.get_running_loop().create_future()

    def ask(self, suite: CipherSuite | None) -> None:
        """Try with a suite that an answer asks for, forged or not; None is the usual one."""
        if suite not in self._asked:
            self._asked.add(suite)
            self._connecting.append(asyncio.create_task(self._connect(suite)))

    async def _connect(self, suite: CipherSuite | None) -> None:
        each = _Try(self, self._begin(suite))
        self._tries.append(each)
        try:
            await self._transport.connect(self.host, 0, each)
        except OSError as error:
            self.finish(Failure(f"{self.address}: {os_error_message(error)}"))

    def finish(self, result: ProvenServer | Failure) -> None:
        """Take the first result of a stream."""
        if self._outcome.done():
            if isinstance(result, ProvenServer):
                result.give_up()
        elif isinstance(result, ProvenServer):
            self._outcome.set_result(result)
        else:
            self._outcome.set_exception(UnprovenError(result))

    async def run(self) -> ProvenServer:
        """Return the server once it proves the key; raise UnprovenError if it does not."""
        self.ask(None)
        try:
            return await self._outcome
        except asyncio.CancelledError:
            # The search may end in the moment in which the server proves the key.
            outcome = self._outcome
            if outcome.done() and not outcome.cancelled() and outcome.exception() is None:
                outcome.result().give_up()
            raise
        finally:
            for connecting in self._connecting:
                connecting.cancel()
            for each in self._tries:
                each.give_up()


async def find_servers(
    trials: Trials[ProvenServer],
    transport: StreamTransport,
    hosts: Collection[str],
    begin: Callable[[CipherSuite | None], ClientConnection],
) -> tuple[list[ProvenServer], list[Failure], int]:
    """Find the servers that prove the key, among all announced hosts.

    Args:
        trials: remembers the hosts that have failed.
        begin: begins a handshake, with the suite that a server asks for.

    Returns:
        The servers, the failures of others, and how many others there are.
    """
    proven, failures, others = await trials.search(
        hosts, lambda host: _HostSearch(transport, host, begin).run(), ProvenServer.give_up
    )
    return list(proven.values()), [failure.args[0] for failure in failures], others

"""A client's search among the servers that a Zenoh network announces: it uses the server that proves the key."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.link.connecting import Failure, failure_of, no_answer
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.streams import Stream, StreamHandler, os_error_message
from rsb_bridge.transport.trials import Trials, UnprovenError
from rsb_bridge.wire.events import Established

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from rsb_bridge.transport.transport import StreamTransport
    from rsb_bridge.wire.connection import ClientConnection
    from rsb_bridge.wire.events import Event, RefusalCode
    from rsb_bridge.wire.sealing import CipherSuite

_REFUSED_AFTER = 1.5
"""s from a refusal, which anybody can forge, until it counts: the server's own answer may follow."""
_REMEDY = "set access control on the router (docs/zenoh.md)"


def unproven_servers(count: int) -> str:
    """Return the warning for an operator that so many announced servers did not prove the key."""
    what = "1 other announced server has" if count == 1 else f"{count} other announced servers have"
    return f"{what} not proven the key: {_REMEDY}"


def failure_of_search(transport: StreamTransport, hosts: list[str], failures: list[Failure]) -> Failure:
    """Return the failure of a search in which no announced server proved the key."""
    silent = Failure(no_answer(transport.format_address((hosts[0], 0))), LinkCause.NO_ANSWER)
    failure = next((each for each in failures if each.refused), (*failures, silent)[0])
    if len(hosts) == 1:
        return failure
    text = f"none of {len(hosts)} announced servers has proven the key: {_REMEDY}; one says: {failure.reason}"
    return failure._replace(reason=text)


class ProvenServer:
    """A server that has proven the key, or refused this client with the key; it waits for `confirm` or `give_up`.

    Attributes:
        refusal: the server's, or None if it accepts the client.
    """

    def __init__(
        self, stream: Stream, connection: ClientConnection, events: list[Event], refusal: Failure | None
    ) -> None:
        self.stream = stream
        self.connection = connection
        self.refusal = refusal
        self._events = events

    def confirm(self) -> tuple[Established, list[Event]]:
        """Confirm the handshake; return its event, and what followed. The stream needs another handler at once."""
        established, *more = self._events
        assert isinstance(established, Established)
        self.stream.write(self.connection.data_to_send())
        self.stream.resume_reading()  # which delivers later
        return established, more

    def give_up(self) -> None:
        """Leave the server."""
        self.stream.abort("not accepted")


class _Try(StreamHandler):
    """One stream to one announced server, which strangers may answer, too.

    Args:
        address: the same, for messages.
        refusal_message: gives the text for operators about a refusal.
        asked_for: called if an answer asks for another cipher suite.
    """

    def __init__(
        self,
        connection: ClientConnection,
        host: str,
        address: str,
        refusal_message: Callable[[RefusalCode, str], str],
        asked_for: Callable[[CipherSuite], None],
        finish: Callable[[ProvenServer | Failure], None],
    ) -> None:
        self._connection = connection
        self._host, self._address = host, address
        self._refusal_message = refusal_message
        self._asked_for = asked_for
        self._finish = finish
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
            self._prove(self._stream, connection, events)
        elif not events and connection.suite is not self._connection.suite:
            self._asked_for(connection.suite)
        elif events and self._refusal is None:
            self._refusal = failure_of(events[-1], self._address, self._refusal_message)
            asyncio.get_running_loop().call_later(_REFUSED_AFTER, self._end, self._refusal)

    def _prove(self, stream: Stream, connection: ClientConnection, events: list[Event]) -> None:
        refusal = None
        if connection.at not in ("", self._host):
            return  # a stranger relays another server's answer
        stream.adopt()
        stream.authenticate(connection.sample_secret, opener=True)
        if isinstance(events[0], Established):
            stream.trust()
            stream.pause_reading()  # what follows is for the handler that the stream gets with `confirm`
        else:
            refusal = failure_of(events[0], self._address, self._refusal_message)
            stream.write(connection.data_to_send())
            stream.close("refused")
        self._over = True
        self._finish(ProvenServer(stream, connection, events, refusal))

    def closed(self, reason: str) -> None:
        self._end(self._refusal or Failure(f"{self._address}: {reason} before the handshake finished"))

    def _end(self, failure: Failure) -> None:
        if not self._over:
            self.give_up()
            self._finish(failure)

    def give_up(self) -> None:
        """Close the stream, unless the server has proven the key."""
        if not self._over:
            self._over = True
            if self._stream is not None:
                self._stream.abort("not accepted")


class ServerSearch:
    """Tries announced servers by the handshake, and remembers failed ones.

    Args:
        patience: s that a server has to prove the key.
    """

    def __init__(self, transport: StreamTransport, now: Callable[[], float], patience: float) -> None:
        self._transport = transport
        self._trials: Trials[ProvenServer] = Trials(now, patience)

    async def find(
        self,
        hosts: Collection[str],
        connect: Callable[[CipherSuite | None], ClientConnection],
        refusal_message: Callable[[RefusalCode, str], str],
    ) -> tuple[list[ProvenServer], list[Failure], int]:
        """Find the servers that prove the key.

        Args:
            hosts: all that are announced.
            connect: begins a handshake, with the suite that a server asks for.
            refusal_message: gives the text for operators about a refusal.

        Returns:
            The servers, the failures of others, and how many others there are.
        """

        async def attempt(host: str) -> ProvenServer:
            return await self._attempt(host, connect, refusal_message)

        proven, failures, others = await self._trials.search(hosts, attempt, ProvenServer.give_up)
        return list(proven.values()), [failure.args[0] for failure in failures], others

    async def _attempt(
        self,
        host: str,
        connect: Callable[[CipherSuite | None], ClientConnection],
        refusal_message: Callable[[RefusalCode, str], str],
    ) -> ProvenServer:
        outcome: asyncio.Future[ProvenServer] = asyncio.get_running_loop().create_future()
        address = self._transport.format_address((host, 0))
        tries: list[_Try] = []
        asked: asyncio.Queue[CipherSuite | None] = asyncio.Queue()
        offered: set[CipherSuite | None] = set()
        asked.put_nowait(None)

        def ask(suite: CipherSuite | None) -> None:
            if suite not in offered:
                offered.add(suite)
                asked.put_nowait(suite)

        def finish(result: ProvenServer | Failure) -> None:
            if outcome.done():
                if isinstance(result, ProvenServer):
                    result.give_up()
            elif isinstance(result, ProvenServer):
                outcome.set_result(result)
            else:
                outcome.set_exception(UnprovenError(result))

        async def begin_all() -> None:
            while True:  # once more for each other suite that an answer asks for, forged or not
                each = _Try(connect(await asked.get()), host, address, refusal_message, ask, finish)
                tries.append(each)
                try:
                    await self._transport.connect(host, 0, each)
                except OSError as error:
                    finish(Failure(f"{address}: {os_error_message(error)}"))

        beginning = asyncio.create_task(begin_all())
        try:
            return await outcome
        except asyncio.CancelledError:
            # The search may end in the moment in which the server proves the key.
            if outcome.done() and not outcome.cancelled() and outcome.exception() is None:
                outcome.result().give_up()
            raise
        finally:
            beginning.cancel()
            for each in tries:
                each.give_up()

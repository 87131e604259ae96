"""A client's stream until the server accepts or refuses it."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.link.refused_clients import CAUSES
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.events import Accepted, Established, Event, Failed, StreamRefused

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.wire.connection import ClientConnection, DataConnection
    from rsb_bridge.wire.events import RefusalCode

_EMPTY_LINE = b"\r\n\r\n"
_PROBED_FOR = 0.5
"""s to wait for a program that answers once it has read a whole line. A round figure: nothing was measured."""

LetIn: TypeAlias = "Callable[[Stream, Established | Accepted, list[Event]], None]"
"""Gives an accepted stream its new handler. The events followed the server's answer."""


class Failure(NamedTuple):
    """The reason why the server did not accept a stream.

    Attributes:
        cause: the same as a code.
        code: of the server's refusal, or None if it did not refuse.
    """

    reason: str
    cause: LinkCause = LinkCause.UNREACHABLE
    code: RefusalCode | None = None

    @property
    def refused(self) -> bool:
        """Whether the server or another program answered; otherwise the server was not reached."""
        return self.code is not None or self.cause is LinkCause.NOT_A_BRIDGE


class ConnectAttempt(StreamHandler):
    """Handles a stream until the server accepts or refuses it.

    Args:
        connection: the state machine of the handshake, or of a route's data preamble.
        address: of the server, for messages.
        refusal_message: gives the text for operators about a refusal.
        sample_secret: both sides have it already, or None.

    Attributes:
        outcome: the failure, or None if the server accepted the stream.
    """

    def __init__(
        self,
        connection: ClientConnection | DataConnection,
        address: str,
        refusal_message: Callable[[RefusalCode, str], str],
        let_in: LetIn,
        sample_secret: bytes | None = None,
    ) -> None:
        self._sample_secret = sample_secret
        self.outcome: asyncio.Future[Failure | None] = asyncio.get_running_loop().create_future()
        self._connection = connection
        self._address = address
        self._refusal_message = refusal_message
        self._let_in = let_in
        self._stream: Stream | None = None
        self._probing = False

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
        stream.write(self._connection.data_to_send())
        for index, event in enumerate(events):
            match event:
                # `silence` has given it up: the next attempt would end a link that came up now.
                case Established() | Accepted() if self._probing:
                    stream.abort("it answered too late")
                    return
                case Established() | Accepted():
                    self._finish(None)
                    stream.trust()
                    self._let_in(stream, event, events[index + 1 :])
                    return
                case StreamRefused():
                    stream.close("refused")  # after the remaining bytes
                    self._finish(failure_of(event, self._address, self._refusal_message))
                case Failed():
                    self._finish(failure_of(event, self._address, self._refusal_message))
                case _:
                    pass

    def closed(self, reason: str) -> None:
        text = f"{self._address}: {reason} before the handshake finished"
        if not self._heard:
            text = f"{text}: check that rsb-console runs there, and any tunnel to it"
        self._finish(Failure(text))

    async def silence(self, *, probe: bool) -> Failure:
        """Give up a stream that the server accepts and does not answer.

        Args:
            probe: send an empty line first, because many programs answer only to a whole line. A bridge that hangs
                would read it as a broken handshake, so do this only where no bridge has ever answered.
        """
        self._probing = True
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
        return Failure(no_answer(self._address), LinkCause.NO_ANSWER)

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


def no_answer(address: str) -> str:
    """Return the text for operators about a server that does not answer."""
    remedy = "check there that rsb-console runs and does not hang (ss -lntp there)"
    return f"{address} accepts, but does not answer: {remedy}"


def failure_of(event: Event, address: str, refusal_message: Callable[[RefusalCode, str], str]) -> Failure:
    """Return the failure that an event of the handshake means.

    Args:
        refusal_message: gives the text for operators about a refusal.
    """
    match event:
        case StreamRefused(code, message):
            return Failure(refusal_message(code, message), CAUSES.get(code, LinkCause.REFUSED), code)
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

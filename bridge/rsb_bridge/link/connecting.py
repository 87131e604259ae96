"""A client's stream until the server accepts or refuses it."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.events import Accepted, Established, Event, Failed, Refused

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.wire.connection import ClientConnection, DataConnection
    from rsb_bridge.wire.preamble import RefusalCode

LetIn: TypeAlias = "Callable[[Stream, Established | Accepted, list[Event]], None]"
"""Gives an accepted stream its new handler; the events are those that followed the server's answer."""


class Failure(NamedTuple):
    """Why the server did not accept a stream.

    Attributes:
        reason: for an operator.
        refused: the server refused, or another program answered; False: the server was not reached.
        code: of the refusal; None: there is none.
    """

    reason: str
    refused: bool
    code: RefusalCode | None = None


class ConnectAttempt(StreamHandler):
    """Handles a stream until the server accepts or refuses it.

    Args:
        connection: the state machine of the handshake, or of a route's data preamble.
        address: of the server, for messages.
        refusal_message: what an operator is told of a refusal.
        let_in: called when the server accepts the stream.

    Attributes:
        outcome: None: the server accepted the stream.
    """

    def __init__(
        self,
        connection: ClientConnection | DataConnection,
        address: str,
        refusal_message: Callable[[RefusalCode, str], str],
        let_in: LetIn,
    ) -> None:
        self.outcome: asyncio.Future[Failure | None] = asyncio.get_running_loop().create_future()
        self._connection = connection
        self._address = address
        self._refusal_message = refusal_message
        self._let_in = let_in
        self._stream: Stream | None = None

    def connected(self, stream: Stream) -> None:
        self._stream = stream
        stream.write(self._connection.start())

    def received(self, data: bytes) -> None:
        stream = self._stream
        assert stream is not None
        events = self._connection.receive_data(data)
        stream.write(self._connection.data_to_send())
        for index, event in enumerate(events):
            match event:
                case Established() | Accepted():
                    self._finish(None)
                    self._let_in(stream, event, events[index + 1 :])
                    return
                case Refused(code, message):
                    stream.close("refused")  # not before what is left to send is sent
                    self._finish(Failure(self._refusal_message(code, message), refused=True, code=code))
                case Failed(reason):
                    self._finish(Failure(f"{self._address} does not speak this protocol: {reason}", refused=True))
                case _:
                    pass

    def closed(self, reason: str) -> None:
        self._finish(Failure(f"{self._address}: {reason} before the handshake finished", refused=False))

    def end(self) -> None:
        """Close the stream, unless the server accepted it."""
        if self._stream is not None and self._stream.handler is self and not self._stream.over:
            self._stream.abort("not let in")

    def _finish(self, outcome: Failure | None) -> None:
        if not self.outcome.done():
            self.outcome.set_result(outcome)

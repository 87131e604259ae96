"""An authenticated control connection."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.channel.multiplexer import Multiplexer
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.events import DataFrame, Event, Failed, Received, Refused
from rsb_bridge.wire.framing import CONTROL_LIMIT, ProtocolError
from rsb_bridge.wire.messages import ControlMessage, Shutdown
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from rsb_bridge.wire.connection import ClientConnection, ServerConnection

_MOST_WAITING = 8 * CONTROL_LIMIT
"""Bytes; a thousand routes' reports are a fifth of one frame, and 6 s of silence end the link."""
_AT_ONCE = 8
"""Events handled before the I/O loop does other work: each may create a DDS endpoint, which takes 0.5 ms."""


class ControlHandler(Protocol):
    """What acts on a control connection: a link."""

    def message(self, message: ControlMessage) -> None:
        """The peer sent a control message."""
        ...

    def lost(self, reason: str, code: EventCode) -> None:
        """The connection is over. Called once; no message comes after it."""
        ...


class ControlChannel(StreamHandler):
    """The stream's handler once the handshake is done.

    Attributes:
        stream: what carries it.
        multiplexer: shares the stream among routes, where the transport is a multiplexed one.
        over: the connection has ended.
    """

    def __init__(
        self, stream: Stream, connection: ClientConnection | ServerConnection, handler: ControlHandler
    ) -> None:
        self.stream = stream
        self.multiplexer = Multiplexer(stream)
        self.over = False
        self._handler = handler
        self._connection = connection
        self._goodbye = ""
        self._code = EventCode.LINK_LOST
        self._events: deque[Event] = deque()
        stream.handler = self

    def send(self, message: ControlMessage) -> None:
        """Send a message."""
        self.stream.write(self._connection.send(message))
        if self.stream.waiting_bytes > _MOST_WAITING:
            self.stream.abort("the peer is not reading: control send buffer full")  # `closed` comes later

    def shut_down(self, reason: str, *, retry_after: float | None, code: EventCode = EventCode.LINK_CLOSED) -> None:
        """Tell the peer that this ends on purpose, and end it."""
        self.send(Shutdown(reason=sanitize_text(reason), retry_after=retry_after))
        self._goodbye, self._code = reason, code
        self.stream.close(reason)
        self._end(reason)

    def abort(self, reason: str, code: EventCode = EventCode.LINK_LOST) -> None:
        """End it without telling the peer."""
        self._code = code
        self.stream.abort(reason)
        self._end(reason)

    def received(self, data: bytes) -> None:
        """Bytes came."""
        self.take(self._connection.receive_data(data))

    def take(self, events: list[Event]) -> None:
        """Handle events, a few at a time; reading pauses until all are handled."""
        waits = bool(self._events)
        self._events.extend(events)
        if not waits:
            self._act()

    def _act(self) -> None:
        for _ in range(_AT_ONCE):
            if not self._events:
                return
            self._act_on(self._events.popleft())
            if self.over:  # the event ended it
                self._events.clear()
                return
        if self._events:
            self.stream.pause_reading()
            asyncio.get_running_loop().call_soon(self._go_on)

    def _go_on(self) -> None:
        if not self.over:
            self._act()
            if not self._events:
                self.stream.resume_reading()

    def _act_on(self, event: Event) -> None:
        match event:
            case Received(message):
                self._handler.message(message)
            case DataFrame(route_id, frame):
                self._take_data(route_id, frame)
            case Failed(reason):
                self.abort(f"the peer broke the format: {reason}")
            case Refused(_, reason):
                self.abort(reason)

    def _take_data(self, route_id: int, frame: memoryview) -> None:
        channel = self.multiplexer.channels.get(route_id)
        if channel is None:
            return  # it was closed here while the frame was under way
        try:
            channel.received(frame)
        except (ProtocolError, SealError) as error:
            self.abort(f"the peer broke the format: {error}")

    def writable(self) -> None:
        """The stream takes more again."""
        self.multiplexer.pump()

    def closed(self, reason: str) -> None:
        """The stream is over."""
        self._end(self._goodbye or reason)

    def _end(self, reason: str) -> None:
        if not self.over:
            self.over = True
            self._handler.lost(reason, self._code)

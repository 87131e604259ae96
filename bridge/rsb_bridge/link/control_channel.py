"""An authenticated control connection."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.channel.multiplexer import Multiplexer
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.token_bucket import TokenBucket
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
_MESSAGES, _MESSAGES_A_SECOND = 4096, 500.0
"""As many as a thousand routes take when they are opened, and what may come after them for ever."""
_BYTES, _BYTES_A_SECOND = 4 * CONTROL_LIMIT, CONTROL_LIMIT
"""Likewise. The thread of all links needs 40 ms to read a message of `CONTROL_LIMIT`."""


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
        self._unsent = bytearray()  # sealed; the stream's own buffer would have to be counted anew for each message
        self._loop = asyncio.get_running_loop()
        self._allowance = TokenBucket(_MESSAGES, _MESSAGES_A_SECOND, self._loop.time())
        self._volume = TokenBucket(_BYTES, _BYTES_A_SECOND, self._loop.time())
        self._owes = False  # more came than the volume allows
        stream.handler = self

    def send(self, message: ControlMessage) -> None:
        """Send a message, or keep it until the stream takes it."""
        sealed = self._connection.send(message)
        if not self.stream.congested:
            self.stream.write(sealed)
        elif len(self._unsent) + len(sealed) > _MOST_WAITING:
            self.stream.abort("the peer is not reading: control send buffer full")  # `closed` comes later
        else:
            self._unsent += sealed

    def _flush(self) -> None:
        if self._unsent:
            self.stream.write(bytes(self._unsent))
            self._unsent.clear()

    def shut_down(self, reason: str, *, retry_after: float | None, code: EventCode = EventCode.LINK_CLOSED) -> None:
        """Tell the peer that this ends on purpose, and end it."""
        self.send(Shutdown(reason=sanitize_text(reason), retry_after=retry_after))
        self._flush()
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
        if not self.multiplexer.channels:  # else most of them may be messages, which a radio keeps slow enough
            self._charge(len(data))

    def _charge(self, size: int) -> None:
        """Read no more until so many bytes are within the volume allowed."""
        now = self._loop.time()
        owed, self._owes = self._owes, not self._volume.take(size, now)
        if self._owes:
            self.stream.pause_reading()
            # Not a moment too early: the rest could be too short for the clock to move.
            self._loop.call_later((size - self._volume.left(now)) / _BYTES_A_SECOND + 0.001, self._charge, size)
        elif owed:
            self._resume()

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
            if isinstance(self._events[0], Received) and not self._allowance.take(1, self._loop.time()):
                break
            self._act_on(self._events.popleft())
            if self.over:  # the event ended it
                self._events.clear()
                return
        if self._events:
            self.stream.pause_reading()
            self._loop.call_later(
                max(0.0, 1 - self._allowance.left(self._loop.time())) / _MESSAGES_A_SECOND, self._go_on
            )

    def _go_on(self) -> None:
        if not self.over:
            self.stream.received_at = self._loop.time()  # who is not read for now is not silent
            self._act()
            self._resume()

    def _resume(self) -> None:
        if not self.over and not self._events and not self._owes:
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
        self._flush()
        self.multiplexer.pump()

    def closed(self, reason: str) -> None:
        """The stream is over."""
        self._end(self._goodbye or reason)

    def _end(self, reason: str) -> None:
        if not self.over:
            self.over = True
            self._handler.lost(reason, self._code)

"""A multiplexed stream beside the control connection: the routes of one link that name its channel share it.

Two Bluetooth adapters have one connection on an RFCOMM channel, so there can't be one for each route. The client opens
the stream for the first route and asks on it for the others (PROTOCOL.md, 1.1); it lives as long as any route is on it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from rsb_bridge.channel.multiplexer import Multiplexer
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.framing import CONTROL_LIMIT, DATA, HEADER, FrameReader
from rsb_bridge.wire.preamble import MAGIC, Refusal
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from rsb_bridge.wire.framing import Budget


class SharedStreamOwner(Protocol):
    """The link that a shared stream belongs to, as far as the stream knows it."""

    def join_stream(self, shared: SharedStream, frame: bytes) -> None:
        """Put a further route on the stream, as the peer's preamble asks.

        Raises:
            ProtocolError: the frame is no such preamble, or the peer may not ask.
            Refusal: no such route waits for this stream.
        """
        ...

    def is_closed_id(self, route_id: int) -> bool:
        """Whether a route of that id was open and is closed."""
        ...


class SharedStream(Multiplexer, StreamHandler):
    """The stream's handler once it is let in.

    Attributes:
        channel: the RFCOMM channel that its routes name.
    """

    def __init__(self, stream: Stream, owner: SharedStreamOwner, channel: int, budget: Budget) -> None:
        super().__init__(stream)
        self.channel = channel
        self._owner = owner
        self._frames = FrameReader(CONTROL_LIMIT, budget)
        stream.handler = self

    def forget(self, route_id: int) -> None:
        """The channel of a route is closed; the last one takes the stream with it."""
        super().forget(route_id)
        if not self.channels:
            self._end("no topic is on it any more")

    def received(self, data: bytes) -> None:
        """Bytes came. A peer that breaks the format loses the stream, with all that is on it."""
        try:
            for frame in self._frames.feed(data):
                self._take(frame)
        except (ProtocolError, SealError, Refusal) as error:
            self._lost(str(error))

    def _take(self, frame: memoryview) -> None:
        if frame[: len(MAGIC)] == MAGIC:
            self._owner.join_stream(self, bytes(frame))
            return
        if len(frame) < HEADER.size:
            raise ProtocolError(f"a data frame of {len(frame)} bytes: its header alone has {HEADER.size}")
        kind, _, route_id, _ = HEADER.unpack(frame[: HEADER.size])
        channel = self.channels.get(route_id)
        if channel is not None:
            channel.received(frame)
        elif kind != DATA or not self._owner.is_closed_id(route_id):  # else it was closed while the frame was under way
            raise ProtocolError(f"a frame of type {kind}, route {route_id} on a stream that does not carry it")

    def writable(self) -> None:
        """The stream takes more again."""
        self.pump()

    def closed(self, reason: str) -> None:
        """The stream is over: its routes are opened again."""
        self._lost(reason)

    def _lost(self, reason: str) -> None:
        self._end(reason)
        for channel in tuple(self.channels.values()):
            channel.lost(reason)

    def _end(self, reason: str) -> None:
        self._frames.close()
        self.stream.handler = StreamHandler()
        self.stream.abort(reason)  # the peer closes its half too: nobody would read what waits

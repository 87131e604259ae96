"""An RFCOMM connection beside the control connection: the routes of one link that name its channel share it.

The kernel has one connection of two adapters on a channel, so there cannot be one for each route. The client opens it
for the first of them and asks on it for the others (PROTOCOL.md, 1.1); it lives as long as any route is on it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.channel.multiplexer import MultiplexedChannel, Multiplexer
from rsb_bridge.channel.stream import stream_codec
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.framing import CONTROL_LIMIT, DATA, HEADER, FrameReader, ProtocolError
from rsb_bridge.wire.opening import MAGIC, Refusal
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from rsb_bridge.link.link import Link
    from rsb_bridge.route.route import Route


class RfcommMultiplexer(Multiplexer, StreamHandler):
    """The stream's handler once it is let in.

    Attributes:
        channel: the RFCOMM channel that its routes name.
    """

    def __init__(self, stream: Stream, link: Link, channel: int) -> None:
        super().__init__(stream)
        self.channel = channel
        self._link = link
        self._frames = FrameReader(CONTROL_LIMIT, link.unfinished)
        stream.handler = self

    def carry(self, route: Route) -> None:
        """Take a route on, for its present opening."""
        route.channel = MultiplexedChannel(self, route, stream_codec(self._link, route))

    def forget(self, path: MultiplexedChannel) -> None:
        """A path is closed; the last one takes the stream with it."""
        super().forget(path)
        if not self.paths:
            self._end("no topic is on it any more")

    def received(self, data: bytes) -> None:
        """Bytes came. What breaks the format ends the stream, in words, with all that is on it."""
        try:
            for frame in self._frames.feed(data):
                self._take(frame)
        except (ProtocolError, SealError, Refusal) as error:
            self._lost(str(error))

    def _take(self, frame: memoryview) -> None:
        if frame[: len(MAGIC)] == MAGIC:
            self._link.join_stream(self, bytes(frame))
            return
        if len(frame) < HEADER.size:
            raise ProtocolError(f"a data frame of {len(frame)} bytes: its header alone has {HEADER.size}")
        kind, _, route_id, _ = HEADER.unpack(frame[: HEADER.size])
        path = self.paths.get(route_id)
        if path is not None:
            path.received(frame)
        elif kind != DATA or not self._link.is_closed_id(
            route_id
        ):  # else it was closed here while the frame was under way
            raise ProtocolError(f"a frame of type {kind}, route {route_id} on a stream that does not carry it")

    def writable(self) -> None:
        """The stream takes more again."""
        self.pump()

    def closed(self, reason: str) -> None:
        """The stream is over: its routes are begun anew."""
        self._lost(reason)

    def _lost(self, reason: str) -> None:
        self._end(reason)
        for path in tuple(self.paths.values()):
            path.route.channel_lost(reason)

    def _end(self, reason: str) -> None:
        self._frames.close()
        self.stream.handler = StreamHandler()
        self.stream.abort(reason)  # the peer closes its half too: nobody would read what waits

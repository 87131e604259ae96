"""Many routes on one stream, as on Bluetooth: a message goes in chunks, and the chunks of all routes take turns.

The turns are start-time fair queueing (Goyal, Vin, Cheng 1996): each chunk has the virtual time at which it would begin
if every route had an equal share, and the earliest goes first. So a route that uses less than its share, like a
joystick, goes ahead of a map at once; those that want more share equally; nothing starves. Control messages go to the
stream directly, ahead of all that waits here.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.channel.channel import Counts, DataChannel
from rsb_bridge.wire.framing import DataReader, DataWriter, ProtocolError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.wire.framing import Message

CHUNK = 2048
"""Bytes of a message in one frame: 40 ms of a 50 kB/s link, and 1.7 % more for header and tag."""


class Multiplexer:
    """Gives the stream's room to the routes that have something to send.

    Attributes:
        stream: what carries them.
        paths: the routes' shares of it, by route id.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.paths: dict[int, MultiplexedChannel] = {}
        self._waiting: list[MultiplexedChannel] = []
        self._time = 0  # virtual: bytes
        self._pumping = False

    def join(self, path: MultiplexedChannel) -> None:
        """A path has chunks to send."""
        path.start = max(path.start, self._time)
        self._waiting.append(path)
        self.pump()

    def leave(self, path: MultiplexedChannel) -> None:
        """A path has none any more."""
        if path in self._waiting:
            self._waiting.remove(path)

    def forget(self, path: MultiplexedChannel) -> None:
        """A path is closed."""
        self.leave(path)
        self.paths.pop(path.route.id, None)

    def pump(self) -> None:
        """Send while the stream takes it."""
        if self._pumping:
            return  # called by what it calls
        self._pumping = True
        try:
            while self._waiting and not self.stream.congested and not self.stream.over:
                path = min(self._waiting, key=lambda path: path.start)
                self._time = path.start
                self.stream.write(path.next_chunk())
        finally:
            self._pumping = False


class MultiplexedChannel(DataChannel):
    """A route's share of a stream.

    Attributes:
        shared: the stream's.
        route: whose it is.
        start: virtual time at which its next chunk would begin.
    """

    ready = True
    batch_bytes = CHUNK

    def __init__(self, shared: Multiplexer, route: Route, end: DataWriter | DataReader) -> None:
        self.start = 0
        self.shared = shared
        self.route = route
        self._end = end
        self._chunks: deque[bytes] = deque()
        shared.paths[route.id] = self

    @property
    def congested(self) -> bool:
        return bool(self._chunks)

    def send(self, batch: Sequence[Message]) -> None:
        assert isinstance(self._end, DataWriter)
        for payload, stamp, flags in batch:
            self._chunks += self._end.write_chunks(payload, stamp, flags, CHUNK)
        self.shared.join(self)

    def next_chunk(self) -> bytes:
        """Take the next chunk, for sending; behind the last one the route may send more."""
        chunk = self._chunks.popleft()
        self.start += len(chunk)
        if not self._chunks:
            self.shared.leave(self)
            self.route.flush()
        return chunk

    def received(self, frame: memoryview) -> None:
        """A frame of this route came.

        Raises:
            ProtocolError: it breaks the format, or goes the wrong way.
            SealError: its seal does not hold.
        """
        if not isinstance(self._end, DataReader):
            raise ProtocolError(f"data on route {self.route.id}, which goes the other way")
        message = self._end.open_frame(frame)
        if message is not None:
            self.route.deliver((message,))

    def trouble(self) -> str:
        return ""

    def counts(self) -> Counts | None:
        return None

    def close(self, reason: str) -> None:
        if isinstance(self._end, DataReader):
            self._end.close()
        self._chunks.clear()
        self.shared.forget(self)

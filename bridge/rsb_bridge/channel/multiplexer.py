"""Channels that share a stream, as on Bluetooth: messages go in chunks, and the chunks of all routes take turns.

The turns are start-time fair queueing (Goyal, Vin, Cheng 1996): each chunk has the virtual time at which it would begin
if every route had an equal share, and the earliest goes first. So a route that uses less than its share, like a
joystick, goes ahead of a map at once; busier routes share equally; nothing starves. Control messages go to the stream
directly, ahead of all waiting chunks. A route's share is weighted by its topic's priority; calls have the
highest.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.channel.receipts import ReceiptSender, WindowedSender
from rsb_bridge.model.session import weight_of
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.framing import CONTROL_LIMIT, DATA, HEADER, LENGTH, FrameReader
from rsb_bridge.wire.preamble import MAGIC, Refusal
from rsb_bridge.wire.protocol_error import Broken, ProtocolError
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.channel import Counts, RouteSink
    from rsb_bridge.channel.data_keys import DataKeys
    from rsb_bridge.channel.receipts import ReceiptBook
    from rsb_bridge.wire.framing import Budget, Message

CHUNK = 2048
"""Bytes of a message in one frame: 40 ms of a 50 kB/s link, and 1.7 % more for header and tag."""


_UNIT = 16
"""Virtual bytes of one byte with a weight of 1: so that all weights divide it."""


class Multiplexer:
    """Shares a stream among the routes that have something to send.

    Attributes:
        stream: what carries them.
        channels: by route id.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.channels: dict[int, MultiplexedSender | MultiplexedReceiver] = {}
        self._waiting: list[MultiplexedSender] = []
        self._time = 0  # virtual: bytes
        self._pumping = False

    def carry(
        self, route: RouteSink, keys: DataKeys, book: ReceiptBook | None = None
    ) -> MultiplexedSender | MultiplexedReceiver:
        """Return this side's end of a new channel for a route."""
        end: type[MultiplexedSender | MultiplexedReceiver]
        end = MultiplexedSender if route.outgoing else MultiplexedReceiver
        if route.duplex:
            end = MultiplexedDuplex
        channel = self.channels[route.id] = end(self, route, keys, book)
        return channel

    def join(self, channel: MultiplexedSender) -> None:
        """Queue a channel that has chunks to send, and begin to send."""
        if channel not in self._waiting:
            channel.start = max(channel.start, self._time)
            self._waiting.append(channel)
        self.pump()

    def leave(self, channel: MultiplexedSender) -> None:
        """Remove a channel from the queue."""
        if channel in self._waiting:
            self._waiting.remove(channel)

    def forget(self, route_id: int) -> None:
        """Forget the channel of a route."""
        self.channels.pop(route_id, None)

    def pump(self) -> None:
        """Send while the stream takes it."""
        if self._pumping:
            return  # called by what it calls
        self._pumping = True
        try:
            while self._waiting and not self.stream.congested and not self.stream.over:
                channel = min(self._waiting, key=lambda channel: channel.start)
                self._time = channel.start
                self.stream.write(channel.next_chunk())
        finally:
            self._pumping = False


class _MultiplexedChannel:
    """The base of both ends.

    Args:
        multiplexer: of the stream.
        route: that the channel carries.
        keys: make the codecs.
        book: for receipts, or None if the peer does not support them.
    """

    ready = True

    def __init__(
        self, multiplexer: Multiplexer, route: RouteSink, keys: DataKeys, book: ReceiptBook | None = None
    ) -> None:
        self._multiplexer = multiplexer
        self._route = route
        self._book = book
        self._route_id = route.id

    @property
    def carrier(self) -> Stream:
        return self._multiplexer.stream

    def trouble(self) -> str:
        return ""

    def close(self, reason: str) -> None:
        if self._book is not None:
            self._book.forget(self._route_id)
            self._book = None  # what is delivered may end the route before its bytes are counted
        self._multiplexer.forget(self._route_id)

    def lost(self, reason: str) -> None:
        """Report the end of the stream to the route."""
        self._route.channel_lost(reason)


class MultiplexedSender(_MultiplexedChannel, WindowedSender):
    """The sending end.

    Attributes:
        start: virtual time at which its next chunk would begin.
    """

    batch_bytes = CHUNK

    def __init__(
        self, multiplexer: Multiplexer, route: RouteSink, keys: DataKeys, book: ReceiptBook | None = None
    ) -> None:
        super().__init__(multiplexer, route, keys, book)
        self.start = 0
        self._writer = keys.stream_writer(route.id)
        self._chunks: deque[bytes] = deque()
        self._sent = 0
        self.begin_window()

    @property
    def congested(self) -> bool:
        return bool(self._chunks) or (self._window is not None and self._sent >= self._window.limit)

    @property
    def sent(self) -> int:
        return self._sent

    def send(self, batch: Sequence[Message]) -> None:
        if self._window is not None and self._book is not None:
            self._window.wrote(self._sent, self._book.now())
        for payload, stamp, flags in batch:
            self._chunks += self._writer.write_chunks(payload, stamp, flags, CHUNK)
        self._multiplexer.join(self)

    def next_chunk(self) -> bytes:
        """Take the next chunk, for sending; after the last one the route may send more."""
        chunk = self._chunks.popleft()
        self._sent += len(chunk)
        self.start += len(chunk) * _UNIT // weight_of(self._route.rank)
        if not self._chunks:
            self._multiplexer.leave(self)
            self._route.flush()
        return chunk

    def received(self, frame: memoryview) -> None:
        """Refuse a frame: the peer sends nothing on this route.

        Raises:
            ProtocolError: always.
        """
        raise ProtocolError(Broken.DATA_AGAINST_ROUTE(route=self._route_id))

    def close(self, reason: str) -> None:
        self._chunks.clear()
        self._multiplexer.leave(self)
        super().close(reason)


class MultiplexedReceiver(_MultiplexedChannel, ReceiptSender):
    """The receiving end."""

    def __init__(
        self, multiplexer: Multiplexer, route: RouteSink, keys: DataKeys, book: ReceiptBook | None = None
    ) -> None:
        super().__init__(multiplexer, route, keys, book)
        self._reader = keys.stream_reader(route.id)
        self.begin_receipts()

    def counts(self) -> Counts | None:
        return None

    def received(self, frame: memoryview) -> None:
        """Take a frame of this route.

        Raises:
            ProtocolError: it breaks the format.
            SealError: its seal does not hold.
        """
        messages = self._reader.open_frames((frame,))
        if messages:
            self._route.deliver(messages)
        self.count_bytes(LENGTH.size + len(frame))

    def close(self, reason: str) -> None:
        self._reader.close()
        super().close(reason)


class MultiplexedDuplex(MultiplexedReceiver, MultiplexedSender):
    """Either end of a route that sends both ways. The receiving end's methods come first: what arrives is taken."""


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
        """Forget the channel of a route; the last one closes the stream."""
        super().forget(route_id)
        if not self.channels:
            self._end("no topic uses it any more")

    def received(self, data: bytes) -> None:
        """Take received bytes. A peer that breaks the format loses the stream with all its channels."""
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
            raise ProtocolError(Broken.DATA_FRAME_TOO_SHORT(length=len(frame), header=HEADER.size))
        kind, _, route_id, _ = HEADER.unpack(frame[: HEADER.size])
        channel = self.channels.get(route_id)
        if channel is not None:
            channel.received(frame)
        elif kind != DATA or not self._owner.is_closed_id(route_id):  # else it was closed before the frame arrived
            raise ProtocolError(Broken.FRAME_OF_UNKNOWN_ROUTE(kind=kind, route=route_id))

    def writable(self) -> None:
        """Continue to send: the stream takes more again."""
        self.pump()

    def closed(self, reason: str) -> None:
        """Report the end of the stream to its routes, which open again."""
        self._lost(reason)

    def _lost(self, reason: str) -> None:
        self._end(reason)
        for channel in tuple(self.channels.values()):
            channel.lost(reason)

    def _end(self, reason: str) -> None:
        self._frames.close()
        self.stream.handler = StreamHandler()
        self.stream.abort(reason)  # the peer closes its half too: nobody would read what waits

"""Channels on a stream of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.channel.large_messages import LARGE, LargeMessages
from rsb_bridge.channel.receipts import ReceiptSender, WindowedSender
from rsb_bridge.model.wording import Wording
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.protocol_error import Broken, ProtocolError
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.channel import Counts, RouteSink
    from rsb_bridge.channel.data_keys import DataKeys
    from rsb_bridge.channel.receipts import ReceiptBook
    from rsb_bridge.wire.framing import Message


class StreamTrouble(Wording):
    """Troubles of a route that has a stream of its own."""

    STUCK = "nothing gets through its data connection now: check the network and firewalls between the two sides"


class _StreamChannel(StreamHandler):
    """The base of both ends.

    Args:
        stream: that the server has accepted.
        route: that the channel carries.
        keys: make the codecs.
        book: for receipts, or None if the peer does not support them.

    Attributes:
        carrier: the stream; the channel is its handler.
    """

    ready = True

    def __init__(self, stream: Stream, route: RouteSink, keys: DataKeys, book: ReceiptBook | None = None) -> None:
        self.carrier = stream
        self._route = route
        self._book = book
        stream.handler = self

    def trouble(self) -> str:
        return StreamTrouble.STUCK() if self.carrier.stuck else ""

    def close(self, reason: str) -> None:
        if self._book is not None:
            self._book.forget(self._route.id)
            self._book = None  # what is delivered may end the route before its bytes are counted
        self.carrier.handler = StreamHandler()
        self.carrier.abort(reason)  # the peer closes its half too: nobody would read what waits

    def closed(self, reason: str) -> None:
        """Report the end of the stream to the route."""
        self._route.channel_lost(reason)

    def _fail(self, reason: str) -> None:
        self.close(reason)
        self._route.channel_lost(reason)


class StreamSender(_StreamChannel, WindowedSender):
    """The sending end."""

    def __init__(self, stream: Stream, route: RouteSink, keys: DataKeys, book: ReceiptBook | None = None) -> None:
        super().__init__(stream, route, keys, book)
        self._writer = keys.stream_writer(route.id)
        self._large = LargeMessages(stream, self._writer, keys.scratch, self.writable)
        self.begin_window()

    @property
    def congested(self) -> bool:
        carrier, window = self.carrier, self._window
        if carrier.congested or self._large.waiting:
            return True
        return window is not None and carrier.sent_bytes >= window.limit

    @property
    def batch_bytes(self) -> int:
        if self._window is None:
            return self.carrier.batch_bytes
        return min(self.carrier.batch_bytes, self._window.limit - self.carrier.sent_bytes)

    @property
    def sent(self) -> int:
        return self.carrier.sent_bytes

    def send(self, batch: Sequence[Message]) -> None:
        if self._window is not None and self._book is not None:
            self._window.wrote(self.carrier.sent_bytes, self._book.now())
        if not self._large.waiting:
            for payload, _, _ in batch:
                if len(payload) >= LARGE:
                    break
            else:
                self.carrier.write(self._writer.write_many(batch))
                return
        self._large.send(batch)

    def writable(self) -> None:
        """Continue to send: the stream takes more again."""
        self._large.go_on()
        if not self._large.waiting:
            self._route.flush()

    def close(self, reason: str) -> None:
        self._large.close()
        super().close(reason)

    def received(self, data: bytes) -> None:
        """Refuse bytes: the peer sends nothing on this stream."""
        self._fail(Broken.DATA_AGAINST_STREAM())


class StreamReceiver(_StreamChannel, ReceiptSender):
    """The receiving end."""

    def __init__(self, stream: Stream, route: RouteSink, keys: DataKeys, book: ReceiptBook | None = None) -> None:
        super().__init__(stream, route, keys, book)
        self._reader = keys.stream_reader(route.id)
        self.begin_receipts()

    def counts(self) -> Counts | None:
        return None

    def close(self, reason: str) -> None:
        self._reader.close()
        super().close(reason)

    def received(self, data: bytes) -> None:
        """Take received bytes, and deliver the messages that they complete."""
        try:
            messages = self._reader.receive_data(data)
        except (ProtocolError, SealError) as error:
            self._fail(str(error))
            return
        if messages:
            self._route.deliver(messages)
        self.count_bytes(len(data))


class StreamDuplex(StreamReceiver, StreamSender):
    """Either end of a route that sends both ways. The receiving end's methods come first: what arrives is taken."""


def stream_channel(
    stream: Stream, route: RouteSink, keys: DataKeys, book: ReceiptBook | None = None
) -> StreamSender | StreamReceiver:
    """Return this side's end of a route's channel on an accepted stream."""
    if route.duplex:
        return StreamDuplex(stream, route, keys, book)
    return StreamSender(stream, route, keys, book) if route.outgoing else StreamReceiver(stream, route, keys, book)

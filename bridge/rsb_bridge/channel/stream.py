"""A stream of one route's own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.framing import DataReader, DataWriter, ProtocolError
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.channel import Counts
    from rsb_bridge.link.link import Link
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.framing import Message


class StreamChannel(StreamHandler):
    """A stream of the route's own. It is the stream's handler.

    Attributes:
        stream: what carries it.
    """

    ready = True

    def __init__(self, stream: Stream, route: Route, end: DataWriter | DataReader) -> None:
        self.stream = stream
        self._route = route
        self._end = end
        stream.handler = self

    @property
    def congested(self) -> bool:
        return self.stream.congested

    @property
    def batch_bytes(self) -> int:
        return self.stream.batch_bytes

    def send(self, batch: Sequence[Message]) -> None:
        assert isinstance(self._end, DataWriter)
        self.stream.write(self._end.write_many(batch))

    def trouble(self) -> str:
        return ""

    def counts(self) -> Counts | None:
        return None

    def close(self, reason: str) -> None:
        if isinstance(self._end, DataReader):
            self._end.close()
        self.stream.handler = StreamHandler()
        self.stream.abort(reason)  # the peer closes its half too: nobody would read what waits

    def received(self, data: bytes) -> None:
        """Bytes came: on a sending route's stream there is nothing to say, so they break the format."""
        if not isinstance(self._end, DataReader) or self._route.outgoing:
            self._broken("the peer sent data on a stream that goes the other way")
            return
        try:
            messages = self._end.receive_data(data)
        except (ProtocolError, SealError) as error:
            self._broken(str(error))
            return
        if messages:
            self._route.deliver(messages)

    def writable(self) -> None:
        """The stream takes more again."""
        self._route.flush()

    def closed(self, reason: str) -> None:
        """The stream is over."""
        self._route.channel_lost(reason)

    def _broken(self, reason: str) -> None:
        self.stream.handler = StreamHandler()
        self.stream.abort(reason)
        self._route.channel_lost(reason)


def stream_codec(link: Link, route: Route) -> DataWriter | DataReader:
    """What makes or opens the route's frames on a stream, for its present opening."""
    assert link.keys is not None
    if route.outgoing:
        return DataWriter(link.keys.route_sealer(route.id, link.side), route.id)
    return DataReader(link.keys.stream_opener(route.id, link.other_side), route.id, budget=link.unfinished)

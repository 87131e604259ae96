"""What carries one route's messages: a stream of its own, datagrams, or a share of a stream."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.datagram import DatagramReader, DatagramWriter
from rsb_bridge.wire.framing import DataReader, DataWriter, Message, ProtocolError
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.link import Link
    from rsb_bridge.route import Route


class Counts(NamedTuple):
    """What a receiving path knows of messages that did not arrive whole.

    Attributes:
        newest: number of the newest message seen, from 1.
        incomplete: messages some of whose fragments wait for the rest.
        expired: messages given up because fragments did not come in time.
    """

    newest: int = 0
    incomplete: int = 0
    expired: int = 0


class Path(Protocol):
    """One route's way to the peer, for one opening."""

    @property
    def ready(self) -> bool:
        """Whether messages may be sent or may come."""
        ...

    @property
    def congested(self) -> bool:
        """Whether it is better not to send now."""
        ...

    @property
    def batch_bytes(self) -> int:
        """How much to send at once, where a single message is not more."""
        ...

    def send(self, batch: Sequence[Message]) -> None:
        """Send messages, oldest first."""
        ...

    def trouble(self) -> str:
        """What seems wrong with it, in words; empty: nothing."""
        ...

    def counts(self) -> Counts | None:
        """Where messages are numbered: what is missing."""
        ...

    def close(self, reason: str) -> None:
        """Free it. The route hears no more of it."""
        ...


class StreamPath(StreamHandler):
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
        self._route.path_lost(reason)

    def _broken(self, reason: str) -> None:
        self.stream.handler = StreamHandler()
        self.stream.abort(reason)
        self._route.path_lost(reason)


def stream_end(link: Link, route: Route) -> DataWriter | DataReader:
    """What makes or opens the route's frames on a stream, for its present opening."""
    assert link.keys is not None
    if route.outgoing:
        return DataWriter(link.keys.route_sealer(route.id, link.side), route.id)
    return DataReader(link.keys.stream_opener(route.id, link.other_side), route.id, budget=link.unfinished)


def datagram_end(link: Link, route: Route) -> DatagramWriter | DatagramReader:
    """The same for its datagrams."""
    assert link.keys is not None
    if route.outgoing:
        return DatagramWriter(link.keys.route_sealer(route.id, link.side), link.keys.link_id, route.id)
    return DatagramReader(link.keys.datagram_opener(route.id, link.other_side), route.id, budget=link.unfinished)

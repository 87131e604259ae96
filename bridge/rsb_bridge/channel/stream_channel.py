"""The ends of a route's channel on a pair of a link's data streams."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.channel.sending_end import SendingEnd
from rsb_bridge.model.wording import Wording
from rsb_bridge.wire.framing import MOVED
from rsb_bridge.wire.protocol_error import Broken, ProtocolError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.channel import Counts, RouteSink
    from rsb_bridge.channel.data_keys import DataKeys
    from rsb_bridge.channel.data_stream import DataStream, StreamPair
    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.wire.framing import Message

LARGE = 16 * 1024
"""Bytes of a message from which on its route uses the stream for large messages: more than 6 ms of a link of 20
Mbit/s, and about as much as TCP keeps unsent. Others were not measured. Messages of 20 and 40 kB share a stream with
the largest, and without priorities their p99 rose from 0.4 and 0.5 s to 0.9 (bench/README.md, *Thin links*)."""


class StreamTrouble(Wording):
    """Troubles of the data streams."""

    STUCK = "nothing gets through its data connection now: check the network and firewalls between the two sides"


class _StreamEnd:
    """The base of both ends.

    Args:
        pair: the streams, which are ready.
    """

    ready = True

    def __init__(self, pair: StreamPair, route: RouteSink, keys: DataKeys) -> None:
        assert pair.small is not None
        self._pair = pair
        self._small = pair.small
        self._route = route
        self._route_id = route.id

    @property
    def carrier(self) -> Stream:
        return self._small.stream

    def trouble(self) -> str:
        stuck = any(each.stream.stuck for each in self._pair.streams() if self.uses(each))
        return StreamTrouble.STUCK() if stuck else ""

    def close(self, reason: str) -> None:
        self._pair.forget(self._route_id)

    def lost(self, reason: str) -> None:
        """Report the end of the streams to the route."""
        self._route.channel_lost(reason)

    def uses(self, stream: DataStream) -> bool:
        """Whether the route's messages are on a stream."""
        return stream is self._small


class StreamSender(_StreamEnd, SendingEnd):
    """The sending end: it gives the scheduler what the route's queue holds, when its turn comes."""

    via: DataStream

    def __init__(self, pair: StreamPair, route: RouteSink, keys: DataKeys) -> None:
        super().__init__(pair, route, keys)
        SendingEnd.__init__(self, pair.scheduler, route, self._small)
        self._writer = keys.stream_writer(route.id)
        self._scratch = keys.scratch
        self._at = 0  # bytes of the first message that are sent

    def send(self, batch: Sequence[Message]) -> None:
        if self._in_turn:
            self._messages += batch
            return
        size = sum([len(payload) for payload, _, _ in batch])
        if size <= self._scheduler.chunk and not self._must_move(size):
            # Nothing waits, so there is no turn to wait for: the hot path.
            data = self._writer.write_many(batch)
            self._scheduler.charge(self, len(data))
            self._scheduler.write(self.via, data)
            return
        self._wait(batch)

    def take_turn(self, limit: int) -> bytes | memoryview:
        if not self._messages and not self._fill():
            return b""
        payload = self._messages[0][0]
        # Not amid a message, which may have begun while there was no stream for large ones.
        if not self._at and self._must_move(len(payload)):
            moved = self._writer.write_moved()
            assert self._pair.large is not None
            self.via = self._pair.large
            return moved
        if self._at or len(payload) > limit:
            return self._next_piece(limit)
        batch: list[Message] = []
        size = 0
        while self._messages and size < limit:
            payload = self._messages[0][0]
            if len(payload) > limit or self._must_move(len(payload)):
                break
            batch.append(self._messages.popleft())
            size += len(payload)
        return self._writer.write_many(batch)

    def _must_move(self, size: int) -> bool:
        """Whether the route has to move to the stream of large messages before one of that size."""
        return size >= LARGE and self.via is self._small and self._pair.large not in (None, self._small)

    def _next_piece(self, limit: int) -> memoryview:
        """Seal the next `limit` bytes of the first message in memory that is used again."""
        payload, stamp, flags = self._messages[0]
        room = self._writer.piece_size(limit, limit)
        piece = memoryview(self._scratch.lend(room))[:room]
        used, self._at = self._writer.write_piece(memoryview(payload), self._at, stamp, flags, limit, piece)
        if self._at >= len(payload):
            self._messages.popleft()
            self._at = 0
        return piece[:used]

    def close(self, reason: str) -> None:
        self.leave()
        super().close(reason)

    def uses(self, stream: DataStream) -> bool:
        return stream is self.via or super().uses(stream)

    def received(self, stream: DataStream, kind: int, frames: Sequence[memoryview]) -> bool:
        """Refuse frames: the peer sends nothing on this route.

        Raises:
            ProtocolError: always.
        """
        raise ProtocolError(Broken.DATA_AGAINST_ROUTE(route=self._route_id))


class StreamReceiver(_StreamEnd):
    """The receiving end."""

    def __init__(self, pair: StreamPair, route: RouteSink, keys: DataKeys) -> None:
        super().__init__(pair, route, keys)
        self._reader = keys.stream_reader(route.id)
        self._from = self._small

    def counts(self) -> Counts | None:
        return None

    def uses(self, stream: DataStream) -> bool:
        return stream is self._from or super().uses(stream)

    def received(self, stream: DataStream, kind: int, frames: Sequence[memoryview]) -> bool:
        if stream is not self._from:
            return False  # the last frame on the other stream has not come yet, and order holds across the two
        if kind == MOVED:
            return self._moved(frames)
        messages = self._reader.open_frames(frames)
        if messages:
            self._route.deliver(messages)
        return True

    def _moved(self, frames: Sequence[memoryview]) -> bool:
        large = self._pair.large
        # A route moves once, and only where there are two streams.
        if self._from is not self._small or large is None or large is self._small or len(frames) > 1:
            raise ProtocolError(Broken.DATA_AGAINST_ROUTE(route=self._route_id))
        self._reader.open_moved(frames[0])
        self._from = large
        large.resume()
        return True

    def close(self, reason: str) -> None:
        self._reader.close()
        super().close(reason)


class StreamDuplex(StreamReceiver, StreamSender):
    """Either end of a route that sends both ways. The receiving end's methods come first: what arrives is taken."""


def stream_channel(pair: StreamPair, route: RouteSink, keys: DataKeys) -> StreamSender | StreamReceiver:
    """Return this side's end of a route's channel on streams that are ready."""
    end: StreamSender | StreamReceiver
    if route.duplex:
        end = StreamDuplex(pair, route, keys)
    elif route.outgoing:
        end = StreamSender(pair, route, keys)
    else:
        end = StreamReceiver(pair, route, keys)
    pair.carry(route.id, end)
    return end

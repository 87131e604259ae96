"""Streams: frames with a length, and data frames, sealed and opened (PROTOCOL.md, 1 and 1.5). This is the hot path."""

from __future__ import annotations

import io
import struct
from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.model.hops import MOST_SOURCES
from rsb_bridge.wire.protocol_error import Broken, ProtocolError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.wire.sealing import Buffer, Sealer, StreamOpener


PREAMBLE_LIMIT = 4096
CONTROL_LIMIT = 1 << 20
"""Both of the protocol: bytes of the longest frame of somebody who has proven no key, and of any other."""
MESSAGE_LIMIT = 64 << 20  # bytes of the longest message, as sent (compressed, if it is)
CONTENT_LIMIT = 2 * MESSAGE_LIMIT
"""Bytes of the longest compressed message, once it is unpacked: a map of 100 MB is 1 MB on the wire."""
CALL_LIMIT = 32 << 20
"""Bytes of the longest request, response or message of a route of calls, unpacked. A bridge may hand it to DDS on its
loop, which stands still meanwhile: for 30 ms with 8 MiB, 80 ms with 32 MiB, 250 ms with 64 MiB, and three times that at
the first time (bench/README.md, *Long calls*)."""
UNFINISHED_LIMIT = 4 * MESSAGE_LIMIT
"""Bytes of incomplete messages that all readers of a link hold together: 64 messages of 8 MB, each half received."""

# The type of a frame
CONTROL = 0
DATA = 1
MOVED = 2  # the last frame of a route on the stream of small messages: its next one is on that of large messages
RESUMED = 3
"""The first frame of a route on a new stream, after a stream was lost: from which message on the route sends again."""
# The flags of a data frame. The headers (`rsb_bridge.wire.headers`) stand before the content, the lease header first.
ZSTD = 1
MORE = 2
HISTORY = 4
LEASED = 8
SOURCE_SHIFT = 4  # the first bit that holds the number of the message's source
SOURCE_FLAGS = (MOST_SOURCES - 1) << SOURCE_SHIFT

Message: TypeAlias = tuple[bytes, int, int]
"""(payload, stamp in ns since the epoch, flags: `ZSTD`, `HISTORY`, `LEASED`, and the source's number)."""

LENGTH = struct.Struct(">I")
HEADER = struct.Struct(">BBIQ")  # type, flags, route, stamp
_COUNT = struct.Struct(">Q")
_MOST_MESSAGES = 2**53
_HEADER_SIZE = HEADER.size
_LENGTH_SIZE = LENGTH.size
STRANGER_LIMIT = PREAMBLE_LIMIT + _LENGTH_SIZE
"""Bytes that are kept of somebody who has not proven to have a key: a preamble frame with its length."""
_unpack_header = HEADER.unpack


class Budget:
    """Bytes of incomplete messages that several holders share. Each gives back what it took."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.held = 0

    def take(self, size: int) -> bool:
        """Take `size` bytes; return False, and take nothing, if they exceed the limit."""
        if self.held + size > self.limit:
            return False
        self.held += size
        return True

    def hold(self, size: int) -> None:
        """Do as `take`, or raise a ProtocolError."""
        if not self.take(size):
            raise ProtocolError(Broken.TOO_MUCH_INCOMPLETE(limit=self.limit))

    def give(self, size: int) -> None:
        self.held -= size


def pack_frame(*parts: Buffer) -> bytes:
    """Return one frame, preceded by its length."""
    return b"".join((LENGTH.pack(sum(map(len, parts))), *parts))


class FrameReader:
    """Cuts a stream into frames. A length beyond the limit is refused before anything is allocated.

    Attributes:
        limit: bytes of the longest frame.
    """

    def __init__(self, limit: int, budget: Budget | None = None) -> None:
        """Begin.

        Args:
            budget: for the incomplete frame, or None for a budget of its own.
        """
        self.limit = limit
        self._budget = budget or Budget(UNFINISHED_LIMIT)
        self._tail = bytearray()  # an incomplete frame

    def feed(self, data: Buffer) -> list[memoryview]:
        """Take the next bytes of the stream.

        Args:
            data: must not be changed while the frames are in use: they are views of it.

        Returns:
            Every frame that is whole now, without its length.

        Raises:
            ProtocolError: a frame is longer than the limit, or the budget is spent.
        """
        frames: list[memoryview] = []
        view = memoryview(data)
        if self._tail:
            rest = self._complete(view)
            if rest is None:
                return frames
            view = rest
            frames.append(memoryview(self._tail)[_LENGTH_SIZE:])
            self.close()  # with a new tail: the frame is a view of the old one
        unpack, limit = LENGTH.unpack_from, self.limit
        start, end = 0, len(view)
        while end - start >= _LENGTH_SIZE:
            (length,) = unpack(view, start)
            if length > limit:
                raise ProtocolError(Broken.FRAME_TOO_LONG(length=length, limit=limit))
            stop = start + _LENGTH_SIZE + length
            if stop > end:
                break
            frames.append(view[start + _LENGTH_SIZE : stop])
            start = stop
        if start < end:
            self._keep(view[start:])
        return frames

    def close(self) -> None:
        """Discard the incomplete frame."""
        self._budget.give(len(self._tail))
        self._tail = bytearray()

    def _complete(self, view: memoryview) -> memoryview | None:
        """Copy what is missing into the incomplete frame. Return the rest, or None while the frame is incomplete."""
        # The length alone at first, so that nothing is kept of a frame that is too long.
        if (missing := _LENGTH_SIZE - len(self._tail)) > 0:
            self._keep(view[:missing])
            view = view[missing:]
            if len(self._tail) < _LENGTH_SIZE:
                return None
        (length,) = LENGTH.unpack_from(self._tail)
        if length > self.limit:
            raise ProtocolError(Broken.FRAME_TOO_LONG(length=length, limit=self.limit))
        missing = _LENGTH_SIZE + length - len(self._tail)
        self._keep(view[:missing])
        return view[missing:] if len(view) >= missing else None

    def _keep(self, data: Buffer) -> None:
        self._budget.hold(len(data))
        self._tail += data


class DataWriter:
    """Seals a route's messages as data frames.

    Attributes:
        messages: how many have been sealed to their end.
    """

    def __init__(self, sealer: Sealer, route: int) -> None:
        self.messages = 0
        self._sealer = sealer
        self._route = route
        self._overhead = _LENGTH_SIZE + _HEADER_SIZE + sealer.suite.tag_length  # bytes of a frame besides its content

    def resume(self, sealer: Sealer) -> None:
        """Seal with the keys of the association's next connection."""
        self._sealer = sealer

    def write_many(self, messages: Sequence[tuple[Buffer, int, int]]) -> bytes:
        """Return several messages, each (payload, stamp, flags), as frames in one piece."""
        self.messages += len(messages)
        seal, pack_header, pack_length, route = self._sealer.seal, HEADER.pack, LENGTH.pack, self._route
        parts: list[bytes] = []
        for payload, stamp, flags in messages:
            header = pack_header(DATA, flags, route, stamp)
            sealed = seal(payload, header)
            parts += (pack_length(_HEADER_SIZE + len(sealed)), header, sealed)
        return b"".join(parts)

    def write_chunk(self, content: Buffer, stamp: int, flags: int, memory: bytearray) -> memoryview:
        """Seal a part of a message in memory that the caller uses again, so that no long message is copied whole.

        Args:
            flags: have `MORE` if other parts of the message follow.
            memory: has room for the frame (`chunk_room`).

        Returns:
            The frame, in `memory`.
        """
        begin, frame = _LENGTH_SIZE + _HEADER_SIZE, memoryview(memory)[: len(content) + self._overhead]
        header = HEADER.pack(DATA, flags, self._route, stamp)
        LENGTH.pack_into(frame, 0, len(frame) - _LENGTH_SIZE)
        frame[_LENGTH_SIZE:begin] = header
        self._sealer.seal_into(content, header, frame[begin:])
        self.messages += not flags & MORE
        return frame

    def chunk_room(self, size: int) -> int:
        """Return the bytes of a frame with `size` bytes of a message."""
        return size + self._overhead

    def write_moved(self) -> bytes:
        """Return the frame after which the route goes on on another stream."""
        header = HEADER.pack(MOVED, 0, self._route, 0)
        return pack_frame(header, self._sealer.seal(b"", header))

    def write_resumed(self, again: int = 0) -> bytes:
        """Return the frame with which the route resumes on a stream in place of a lost one.

        Args:
            again: messages, the last that were sealed, which are sealed again next.
        """
        self.messages -= again
        header = HEADER.pack(RESUMED, 0, self._route, self._sealer.sequence)
        return pack_frame(header, self._sealer.seal(_COUNT.pack(self.messages), header))


class Assembly:
    """Chunks of a message. It takes as much memory as the last message had: most messages of a topic are alike.

    Attributes:
        begun: more chunks of a message follow.
        held: bytes of the budget.
    """

    def __init__(self, opener: StreamOpener, limit: int, budget: Budget) -> None:
        """Begin.

        Args:
            limit: bytes of the longest message.
            budget: for the memory.
        """
        self.begun = False
        self.held = 0
        self._open_into = opener.open_into
        self._tag = opener.suite.tag_length
        self._limit = limit
        self._budget = budget
        self._content = io.BytesIO()  # gives its content away without a copy
        self._size = 0
        self._expected = 0

    def resume(self, opener: StreamOpener) -> None:
        """Discard what is incomplete, and open with the keys of the association's next connection."""
        self.close()
        self._open_into = opener.open_into

    def add(self, sealed: Buffer, header: Buffer) -> None:
        """Open the next chunk.

        Raises:
            ProtocolError: the message is too long, or the budget is spent.
            SealError: the seal is invalid.
        """
        at = self._size
        # What is shorter than a tag does not open. A negative length would count from the buffer's end.
        end = at + max(0, len(sealed) - self._tag)
        if end > self._limit:
            raise ProtocolError(Broken.TOO_LONG_IN_CHUNKS(limit=self._limit))
        if end > self.held:
            self._grow(end)
        # Both views end here: a `BytesIO` that has one cannot grow.
        with self._content.getbuffer() as whole, whole[at:end] as place:
            self._open_into(sealed, header, place)
        self.begun = True
        self._size = end

    def take(self) -> bytes:
        """Return the message, which is whole."""
        self._expected = self._size
        self._content.truncate(self._size)
        content = self._content.getvalue()
        self.close()
        return content

    def close(self) -> None:
        """Discard the message."""
        self._budget.give(self.held)
        self.begun = False
        self.held = self._size = 0
        self._content = io.BytesIO()

    def _grow(self, needed: int) -> None:
        """Have room for `needed` bytes, and for more where the budget has it: each time costs a copy."""
        generous = min(max(self._expected, 2 * self.held, needed), self._limit)
        if self._budget.take(generous - self.held):
            self.held = generous
        else:
            self._budget.hold(needed - self.held)
            self.held = needed
        self._content.seek(self.held - 1)
        self._content.write(b"\0")  # `truncate` does not lengthen it


class DataReader:
    """Opens a route's data frames, and reassembles chunks.

    Attributes:
        messages: how many have been opened to their end, each once.
        lost: how many were lost with their streams, and are not sent again.
    """

    def __init__(self, opener: StreamOpener, limit: int = MESSAGE_LIMIT, budget: Budget | None = None) -> None:
        """Read one route.

        Args:
            opener: of the route, in the peer's direction.
            limit: bytes of the longest message.
            budget: for incomplete messages, or None for a budget of its own.
        """
        self.messages = self.lost = 0
        self._known = 0  # of the next messages: have been opened already, before their stream was lost
        self._opener = opener
        self._open = opener.open
        self._chunks = Assembly(opener, limit, budget or Budget(UNFINISHED_LIMIT))

    def resume(self, opener: StreamOpener) -> None:
        """Open with the keys of the association's next connection; what is incomplete is discarded."""
        self._opener, self._open = opener, opener.open
        self._chunks.resume(opener)

    def open_frames(self, frames: Iterable[Buffer]) -> list[Message]:
        """Open whole data frames.

        Args:
            frames: whose headers have the type `DATA` and this route.

        Returns:
            The messages, without one of which more chunks follow.

        Raises:
            ProtocolError: the format is broken, or the budget is spent.
            SealError: a seal is invalid.
        """
        open_, chunks, messages = self._open, self._chunks, list[Message]()
        for frame in frames:
            if len(frame) < _HEADER_SIZE:
                raise ProtocolError(Broken.DATA_FRAME_TOO_SHORT(length=len(frame), header=_HEADER_SIZE))
            header = frame[:_HEADER_SIZE]
            _, flags, _, stamp = _unpack_header(header)
            sealed = frame[_HEADER_SIZE:]
            # Most messages are whole, and need no assembly and no budget.
            if not (flags & MORE or chunks.begun):
                messages.append((open_(sealed, header), stamp, flags))
                continue
            chunks.add(sealed, header)
            if not flags & MORE:
                messages.append((chunks.take(), stamp, flags))
        if self._known and messages:
            known = min(self._known, len(messages))
            self._known -= known
            messages = messages[known:]
        self.messages += len(messages)
        return messages

    def open_moved(self, frame: Buffer) -> None:
        """Open the frame after which the route goes on on another stream.

        Raises:
            SealError: its seal is invalid.
        """
        self._open(frame[_HEADER_SIZE:], frame[:_HEADER_SIZE])

    def open_resumed(self, frame: Buffer) -> None:
        """Open the frame with which the route resumes on a stream in place of a lost one.

        What has come already is not returned again; what the peer does not send again is counted as lost.

        Raises:
            ProtocolError: the peer names no message, or more than there can be.
            SealError: its seal is invalid, or its number is an earlier one.
        """
        header = frame[:_HEADER_SIZE]
        _, _, route, sequence = _unpack_header(header)
        self.close()
        self._opener.skip_to(sequence)
        content = self._open(frame[_HEADER_SIZE:], header)
        told = _COUNT.unpack(content)[0] if len(content) == _COUNT.size else -1
        if not 0 <= told <= _MOST_MESSAGES:
            raise ProtocolError(Broken.RESUMED_WRONG(route=route, told=told))
        came = self.messages + self.lost
        self._known = max(0, came - told)
        self.lost += max(0, told - came)

    def close(self) -> None:
        """Discard incomplete messages."""
        self._chunks.close()

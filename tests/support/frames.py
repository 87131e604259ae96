"""Data frames of one route on a stream of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.wire.framing import HEADER, MESSAGE_LIMIT, MORE, UNFINISHED_LIMIT, Budget, DataReader, FrameReader

if TYPE_CHECKING:
    from rsb_bridge.wire.framing import DataWriter, Message
    from rsb_bridge.wire.sealing import Buffer, StreamOpener


class StreamedReader(DataReader):
    """A reader of data frames behind a reader of frames, with one budget for both."""

    def __init__(self, opener: StreamOpener, limit: int = MESSAGE_LIMIT, budget: Budget | None = None) -> None:
        self.budget = budget or Budget(UNFINISHED_LIMIT)
        super().__init__(opener, limit, self.budget)
        self.frames = FrameReader(HEADER.size + limit + opener.suite.tag_length, self.budget)

    def receive_data(self, data: Buffer) -> list[Message]:
        return self.open_frames(self.frames.feed(data))

    def close(self) -> None:
        self.frames.close()
        super().close()


def write_frame(writer: DataWriter, payload: bytes, stamp: int, flags: int = 0) -> bytes:
    """One message as one frame."""
    return writer.write_many(((payload, stamp, flags),))


def write_chunks(writer: DataWriter, payload: bytes, stamp: int, flags: int, chunk_size: int) -> list[bytes]:
    """Return one message as frames of at most `chunk_size` bytes each, which were written in the same memory."""
    memory = bytearray(writer.chunk_room(chunk_size))
    frames: list[bytes] = []
    for at in range(0, max(1, len(payload)), chunk_size):
        more = MORE if at + chunk_size < len(payload) else 0
        frames.append(bytes(writer.write_chunk(payload[at : at + chunk_size], stamp, flags | more, memory)))
    return frames

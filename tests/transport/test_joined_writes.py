"""Writes that leave together."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from rsb_bridge.transport.streams import JoinedWrites, Stream, StreamHandler


class Kernel(asyncio.Transport):
    """Takes what is written.

    Attributes:
        written: by each call.
    """

    def __init__(self) -> None:
        super().__init__()
        self.written: list[bytes] = []
        self.ended = False

    def write(self, data: Any) -> None:
        self.written.append(bytes(data))

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def resume_reading(self) -> None:
        pass

    def is_closing(self) -> bool:
        return self.ended

    def close(self) -> None:
        self.ended = True

    def abort(self) -> None:
        self.ended = True


def connected(joined: JoinedWrites) -> tuple[Stream, Kernel]:
    stream, kernel = Stream(StreamHandler()), Kernel()
    stream.joined = joined

    async def connect() -> None:
        stream.connection_made(kernel)

    asyncio.run(connect())
    return stream, kernel


def test_each_stream_sends_once() -> None:
    joined = JoinedWrites()
    (first, one), (second, other) = connected(joined), connected(joined)
    joined.is_open = True
    for stream, data in ((first, b"a"), (second, b"x"), (first, memoryview(b"b"))):
        stream.write(data)
    assert (one.written, other.written) == ([], [])
    joined.is_open = False
    joined.send_all()
    assert (one.written, other.written) == ([b"ab"], [b"x"])
    first.write(b"c")
    assert one.written == [b"ab", b"c"]


def test_much_is_not_held() -> None:
    joined = JoinedWrites()
    stream, kernel = connected(joined)
    joined.is_open = True
    stream.write(b"a")
    stream.write(bytes(100_000))
    assert [len(each) for each in kernel.written] == [100_001]


@pytest.mark.parametrize("end", [Stream.close, Stream.abort])
def test_what_is_held_leaves_before_a_close_and_not_after_an_end(end: Any) -> None:
    joined = JoinedWrites()
    stream, kernel = connected(joined)
    joined.is_open = True
    stream.write(b"a")

    async def finish() -> None:
        end(stream, "over")
        joined.send_all()

    asyncio.run(finish())
    assert kernel.written == ([b"a"] if end is Stream.close else [])

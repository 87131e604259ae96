"""Large messages on a stream of their own: sealed piece by piece, as the stream takes them.

A piece is sealed into memory that the next piece uses again, and so is in the processor's cache when the kernel copies
it. The other side opens the first chunks while the last ones are sealed, and nothing else on the I/O loop waits for
more than a few pieces.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.transport.streams import BATCH_BYTES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.wire.framing import DataWriter, Message

LARGE = BATCH_BYTES
"""Bytes from which on it costs less to seal a message in place than to seal it whole and join it with others."""
_CHUNK = 128 * 1024
_A_TURN = 4 * BATCH_BYTES
"""Bytes at one turn of the loop: 0.4 ms."""


class Scratch:
    """Memory that pieces are sealed into, one after another. A link's channels share it, on the I/O loop."""

    def __init__(self) -> None:
        self._memory = bytearray()

    def lend(self, size: int) -> bytearray:
        """Memory of at least that size, for as long as the caller does not return to the loop."""
        if len(self._memory) < size:
            self._memory = bytearray(size)
        return self._memory

    def lost(self) -> None:
        """Forget the lent memory, which its borrower still holds."""
        self._memory = bytearray()


class LargeMessages:
    """Messages of one channel that its stream has not taken whole.

    Args:
        stream: takes them.
        writer: seals them.
        scratch: lends memory.
        resume: calls `go_on`, and everything else that has waited meanwhile.

    Attributes:
        waiting: messages that are not sealed whole yet, oldest first; what is sent now comes after them.
    """

    def __init__(self, stream: Stream, writer: DataWriter, scratch: Scratch, resume: Callable[[], None]) -> None:
        self._stream = stream
        self._writer = writer
        self._piece_size = writer.piece_size(BATCH_BYTES, _CHUNK)
        self._resume = resume
        self.waiting: deque[Message] = deque()
        self._at = 0  # bytes of the oldest that have been sealed
        self._scratch = scratch
        self._turn: asyncio.Handle | None = None

    def send(self, batch: Sequence[Message]) -> None:
        """Send messages of any size, after the waiting ones."""
        self.waiting += batch
        self.go_on()

    def go_on(self) -> None:
        """Send while the stream takes pieces, and this turn of the loop is not over."""
        left = _A_TURN
        while self.waiting and not self._stream.congested and self._turn is None:
            if left <= 0:
                self._turn = asyncio.get_running_loop().call_soon(self._next_turn)
                return
            left -= self._send_piece()

    def close(self) -> None:
        """Drop what waits."""
        self.waiting.clear()
        if self._turn is not None:
            self._turn.cancel()
            self._turn = None

    def _next_turn(self) -> None:
        self._turn = None
        self._resume()

    def _send_piece(self) -> int:
        """Send as much of what waits as a piece has room for; how many bytes that was."""
        piece = memoryview(self._scratch.lend(self._piece_size))
        used = 0
        while self.waiting:
            payload, stamp, flags = self.waiting[0]
            room = piece[used:]
            size, self._at = self._writer.write_piece(memoryview(payload), self._at, stamp, flags, _CHUNK, room)
            used += size
            if not size or self._at < len(payload):
                break
            self.waiting.popleft()
            self._at = 0
        self._stream.write(piece[:used])
        if self._stream.congested:
            self._scratch.lost()  # the stream's, until it has sent it
        return used

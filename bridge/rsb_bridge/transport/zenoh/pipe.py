"""A stream over a Zenoh network, as an asyncio transport.

Zenoh keeps the order of a key's samples, and loses some when a router does, or the way changes. So each sample of data
has a number, and a stream that misses one is over: what follows would not open.

The receiving end says how much it has taken in. No more than `WINDOW` bytes are under way beyond that, so that a
receiver that reads slowly holds up its own streams only, not all that a router carries.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.transport.zenoh.endpoint import Header, Kind

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.transport.zenoh.endpoint import Endpoint

WINDOW = 4 * 1024 * 1024
"""Bytes: 40 MB/s where the way there and back takes 0.1 s."""
SAMPLE = 1024 * 1024
"""Bytes of one sample at most; with `rsb_bridge.transport.zenoh.network.LARGEST_SAMPLE`."""

_SAID_EVERY = WINDOW // 8
_REASON_BYTES = 200


class Pipe(asyncio.Transport):
    """One end of a stream.

    Args:
        endpoint: this side's.
        peer: the other side's address.
        stream: 16 hexadecimal digits.
        rank: of its priority (`rsb_bridge.transport.zenoh.outbox`).
        protocol: is told what happens. Its `connection_made` is called at once.
        when_over: called once the stream is over.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        peer: str,
        stream: str,
        rank: int,
        protocol: asyncio.Protocol,
        when_over: Callable[[], None] | None = None,
    ) -> None:
        super().__init__({"peername": (peer, 0), "sockname": (endpoint.address, 0)})
        self._endpoint = endpoint
        self._peer, self._stream = peer, stream
        self._key = endpoint.key(peer, stream)
        self._rank = rank
        self._protocol = protocol
        self._when_over = when_over
        self._loop = asyncio.get_running_loop()
        self._closing = self._over = self._ended = False
        self._high = 64 * 1024
        self._paused_writing = False
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._sent_samples = self._sent = self._taken_there = 0
        self._reading = True
        self._held: deque[bytes] = deque()
        self._received_samples = self._received = self._taken = self._said = 0
        endpoint.add(peer, stream, self)
        protocol.connection_made(self)

    # --- asyncio.Transport

    def write(self, data: bytes | bytearray | memoryview[int]) -> None:
        if self._closing:
            return
        for begin in range(0, len(data), SAMPLE):
            piece = data if len(data) <= SAMPLE else memoryview(data)[begin : begin + SAMPLE]
            if self._waiting or self._sent - self._taken_there >= WINDOW:
                self._waiting.append(bytes(piece))
                self._waiting_bytes += len(piece)
            else:
                self._send(piece)
        if self._waiting_bytes > self._high and not self._paused_writing:
            self._paused_writing = True
            self._protocol.pause_writing()

    def close(self) -> None:
        """Send what waits, then end it."""
        if not self._closing:
            self._closing = True
            if not self._waiting:
                self._end("")

    def abort(self) -> None:
        self._closing = True
        self._end("")

    def is_closing(self) -> bool:
        return self._closing

    def pause_reading(self) -> None:
        self._reading = False

    def resume_reading(self) -> None:
        self._reading = True
        while self._held and self._reading and not self._closing:
            self._deliver(self._held.popleft())

    def is_reading(self) -> bool:
        return self._reading and not self._closing

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._high = 64 * 1024 if high is None else high

    def get_write_buffer_size(self) -> int:
        return self._waiting_bytes

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        assert isinstance(protocol, asyncio.Protocol)
        self._protocol = protocol

    def get_protocol(self) -> asyncio.BaseProtocol:
        return self._protocol

    def can_write_eof(self) -> bool:
        return False

    # --- what comes

    def arrived(self, header: Header, payload: bytes) -> None:
        """A sample came."""
        if self._over:
            return
        if header.kind == Kind.DATA:
            self._data(header.number, payload)
        elif header.kind == Kind.WINDOW:
            self._taken_there = max(self._taken_there, min(header.number, self._sent))
            self._go_on()
        elif header.kind == Kind.END:
            missing = header.number - self._received_samples
            self._ended = True
            if missing > 0:
                self.cut_off(_missing(missing))
            elif payload:
                self.cut_off(payload[:_REASON_BYTES].decode(errors="replace"))
            else:
                self._protocol.eof_received()
                self.close()

    def cut_off(self, reason: str) -> None:
        """The other end is gone, or cannot be reached any more."""
        self._closing = True
        self._end("", OSError(reason))

    def _data(self, number: int, payload: bytes) -> None:
        if number != self._received_samples:
            error = _missing(number - self._received_samples)
            self._end(error, OSError(error))
            return
        self._received_samples += 1
        self._received += len(payload)
        if self._received - self._taken > WINDOW + SAMPLE:
            error = f"the other side sends more than the {WINDOW:,} bytes that may be under way"
            self._end(error, OSError(error))
        elif self._reading and not self._held:
            self._deliver(payload)
        else:
            self._held.append(payload)

    def _deliver(self, payload: bytes) -> None:
        self._taken += len(payload)
        if self._taken - self._said >= _SAID_EVERY:
            self._said = self._taken
            self._endpoint.outbox.put(self._key, b"", Header(Kind.WINDOW, self._rank, self._taken))
        self._protocol.data_received(payload)

    # --- what goes

    def _send(self, data: bytes | bytearray | memoryview[int]) -> None:
        self._endpoint.outbox.put(self._key, data, Header(Kind.DATA, self._rank, self._sent_samples))
        self._sent_samples += 1
        self._sent += len(data)

    def _go_on(self) -> None:
        while self._waiting and self._sent - self._taken_there < WINDOW:
            data = self._waiting.popleft()
            self._waiting_bytes -= len(data)
            self._send(data)
        if self._closing and not self._waiting:
            self._end("")
        elif self._paused_writing and not self._waiting_bytes:
            self._paused_writing = False
            self._protocol.resume_writing()

    def _end(self, told: str, error: OSError | None = None) -> None:
        """Be over; `told` is the reason that the other side hears, unless it has ended the stream itself."""
        if self._over:
            return
        self._over = self._closing = True
        if not self._ended:
            end = Header(Kind.END, self._rank, self._sent_samples)
            self._endpoint.outbox.put(self._key, told.encode()[:_REASON_BYTES], end)
        self._endpoint.forget(self._peer, self._stream)
        self._waiting.clear()
        self._held.clear()
        self._waiting_bytes = 0
        self._loop.call_soon(self._lost, error)

    def _lost(self, error: OSError | None) -> None:
        self._protocol.connection_lost(error)
        if self._when_over is not None:
            self._when_over()


def _missing(count: int) -> str:
    return f"{count} samples were lost in the Zenoh network" if count > 1 else "a sample was lost in the Zenoh network"

"""A stream over a Zenoh network, as an asyncio transport.

Zenoh keeps the order of a key's samples, and loses some if a router does or the path changes. So each sample of data
has a number, and a stream that misses one ends: later samples would not open. Repeated samples are ignored.

The receiving end reports the bytes that it has read. At most `WINDOW` bytes are in flight beyond that, so that a slow
reader holds up only its own streams, not all of a router's traffic. A report never covers bytes that still wait here
for Zenoh, so a false one cannot make that queue grow.

Any member of the network may publish a sample of any stream. Once both sides have proven their keys,
`Pipe.authenticate` adds tags, and a sample with a wrong tag only makes this side ask whether the other one is there.
Before that, a client takes any number of answers to its first sample, of which one proves the key (`Pipe.begin_trial`).
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording, sanitize_text
from rsb_bridge.transport.streams import OpenNetworkTransport
from rsb_bridge.wire.framing import STRANGER_LIMIT
from rsb_bridge.wire.sealing import SampleTags
from rsb_extras.zenoh.outbox import IN_FLIGHT, LINK_RANK, OWN_COST
from rsb_extras.zenoh.sample_header import Header, SampleKind

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_extras.zenoh.endpoint import ZenohEndpoint

WINDOW = 4 * 1024 * 1024
"""Bytes: 40 MB/s where the way there and back takes 0.1 s."""
SAMPLE = 1024 * 1024
"""Bytes of one sample at most; with `rsb_extras.zenoh.network.LARGEST_SAMPLE`."""

_LONGEST = 2 * SAMPLE
"""Bytes of a peer's sample that is taken at most: `LARGEST_SAMPLE`, too."""
_REPORTED_EVERY = IN_FLIGHT // 4
"""Bytes between two windows: a part of `IN_FLIGHT`, so that what has arrived does not count as in flight for long."""
_ASKED_AFTER = 2.0
"""Seconds after which a sender asks for a missing window, and after which an idle sender reports that it has sent all:
else the loss of the last sample would show only with the next one, perhaps hours later."""
_AT_A_TIME = 256 * 1024
"""Held bytes that are delivered in one turn of the loop after a pause of reading: a round figure."""
_SENT_WITHIN = 5.0
"""s for which a router may take nothing before it counts as lost, as in `rsb_extras.zenoh.network`."""
_REASON = 200  # bytes, of the protocol
_DOUBT = 3.0
"""s without a sample after which a stream ends whose end is not proven: a link's own stream has one a second. Of the
protocol, as are the next two (PROTOCOL.md, 12)."""
_UNDER_WAY = 0.5
"""s after such an end in which samples may come that the peer sent before."""
_ANSWERS = 64
"""Answers to a first sample that are tried; anybody can send them, and one costs about 0.1 ms."""


class PipeProblem(Wording):
    """The reasons why a stream over a Zenoh network ends on both sides."""

    SAMPLE_LOST = "a sample was lost in the Zenoh network"
    SAMPLES_LOST = "{count} samples were lost in the Zenoh network"
    WINDOW_IGNORED = "the other side sends more than the {limit:,} bytes that may be in flight"


class Pipe(OpenNetworkTransport):
    """One end of a stream.

    Args:
        stream: 16 hexadecimal digits.
        rank: of its priority (`rsb_extras.zenoh.outbox`).
        protocol: receives the events. Its `connection_made` is called at once.
        stranger: whether the other end has yet to prove that it has the key; `trust` ends that.

    Attributes:
        trusted: whether the other end has proven it.
        longest: bytes of the longest sample that is taken now, and of all samples together until this side answers a
            stranger.
    """

    network = "Zenoh"

    def __init__(
        self,
        endpoint: ZenohEndpoint,
        peer: str,
        stream: str,
        rank: int,
        protocol: asyncio.Protocol,
        when_over: Callable[[], None] | None = None,
        *,
        stranger: bool = False,
    ) -> None:
        super().__init__({"peername": (peer, 0), "sockname": (endpoint.address, 0)})
        self._endpoint = endpoint
        self._peer, self._stream = peer, stream
        self._key = endpoint.key(peer, stream)
        self._rank = rank
        self._protocol = protocol
        self._when_over = when_over
        self.trusted = not stranger
        self.of_link = rank == LINK_RANK
        self.longest = STRANGER_LIMIT if stranger else _LONGEST
        self._loop = asyncio.get_running_loop()
        self._closing = self._over = False
        self._ended: str | None = None
        """The reason for which the other side has ended it, or an empty string if it has sent all."""
        self._tags: SampleTags | None = None
        self._trial = False
        self._answers = 0
        self._heard = False
        self._doubting: asyncio.TimerHandle | None = None
        self.when_doubted: Callable[[], None] = _nothing
        self._high = 64 * 1024
        self._paused_writing = False
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._sent_samples = self._sent = self._taken_there = self._cost_in_flight = 0
        self._reading = True
        self._resuming = self._saying = False
        self._asking: asyncio.TimerHandle | None = None
        self._held = bytearray()  # and no list of samples, of which each, however small, would take memory of its own
        self._received_samples = self._received = self._taken = self._reported = 0
        endpoint.add(peer, stream, self)
        protocol.connection_made(self)

    def trust(self) -> None:
        if not self.trusted and not self._over:
            self.trusted = True
            self.longest = _LONGEST
            self._endpoint.trust(self._peer, self._stream)

    # --- asyncio.Transport

    def write(self, data: bytes | bytearray | memoryview[int]) -> None:
        if self._closing:
            return
        if self._received:
            self.longest = _LONGEST  # it is answered: what follows its proof may come before that is read
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
        """Send what waits, then end it. Nothing is delivered any more."""
        if not self._closing:
            self._closing = True
            self._held.clear()
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
        if not self._resuming and (self._held or self._ended is not None):
            self._resuming = True
            self._loop.call_soon(self._resume)  # not now: the protocol may be handling earlier data

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._high = 64 * 1024 if high is None else high

    def get_write_buffer_size(self) -> int:
        return self._waiting_bytes

    # --- who sends

    def begin_trial(self) -> None:
        self._trial = True

    def adopt(self) -> None:
        self._trial = False
        self.longest = _LONGEST

    def authenticate(self, secret: bytes, *, opener: bool) -> None:
        self._tags = SampleTags(secret, self._stream, opener=opener)

    # --- receiving

    def arrived(self, header: Header, payload: bytes) -> None:
        """Take a sample."""
        if self._over:
            return
        if self._tags is not None:
            if self._tags.proves(header.kind, header.number, payload, header.tag):
                self._proven(header, payload)
            elif header.kind == SampleKind.END:  # a peer that has forgotten the stream has no key for it either
                self.doubt(_reason(payload))
        elif self._trial:
            if header.kind == SampleKind.DATA:
                self._try(header.number, payload)
        elif header.kind == SampleKind.END:
            missing = header.number - self._received_samples
            self.doubt(_missing(missing) if missing > 0 else _reason(payload))
        else:
            self._proven(header, payload)

    def _proven(self, header: Header, payload: bytes) -> None:
        """Take a sample that the peer has sent, as far as that can be known."""
        if header.kind == SampleKind.DATA:
            self._data(header.number, payload)
        elif header.kind == SampleKind.WINDOW:
            self._heard = True
            # No more than Zenoh has been given: a false window could make the queue before it grow.
            there = min(header.number, self._sent - self._endpoint.outbox.waiting(self._key, self._rank))
            if there > self._taken_there:
                self._arrived_there(there)
            self._go_on()
        elif header.kind == SampleKind.END and self._ended is None:
            missing = header.number - self._received_samples
            self._take_end(_missing(missing) if missing > 0 else _reason(payload))

    def _arrived_there(self, there: int) -> None:
        """Count the samples that have arrived; of a part of the bytes in flight, they count by that part."""
        cost = self._cost_in_flight * (there - self._taken_there) // (self._sent - self._taken_there)
        self._taken_there = there
        self._cost_in_flight -= cost
        self._endpoint.outbox.arrived(self._rank, cost)

    def _take_end(self, reason: str) -> None:
        self._ended = reason
        if not self._held:
            self._finish()

    def _try(self, number: int, payload: bytes) -> None:
        """Give the protocol one of several answers."""
        if number or self._answers >= _ANSWERS:
            return
        self._answers += 1
        self._protocol.data_received(payload)
        if not self._trial:  # it is adopted, and so it was the first sample
            self._received_samples = 1
            self._received = self._taken = len(payload)

    def cut_off(self, reason: str) -> None:
        """End: the other end is gone, or cannot be reached any more."""
        self._closing = True
        self._end("", OSError(reason))

    def doubt(self, reason: str) -> None:
        """End unless a sample of the other side comes soon: somebody says that the other end is gone."""
        if self._doubting is None and self._ended is None and not self._over:
            self._doubting = self._loop.call_later(_UNDER_WAY, self._ask_in_doubt, reason)
            self.when_doubted()

    def _ask_in_doubt(self, reason: str) -> None:
        self._heard = False
        self._doubting = self._loop.call_later(_DOUBT - _UNDER_WAY, self._believe, reason)
        if self._sent_samples and not self._closing:
            self._put(b"")  # which the other side answers by a window

    def _believe(self, reason: str) -> None:
        """End, unless the other side was heard."""
        self._doubting = None
        if not self._heard:
            self._take_end(reason)

    def _data(self, number: int, payload: bytes) -> None:
        if number < self._received_samples or self._ended is not None:
            return  # somebody plays it again
        self._heard = True
        if number > self._received_samples:
            error = _missing(number - self._received_samples)
            self._end(error, OSError(error))
            return
        self._received_samples += 1
        self._received += len(payload)
        if self._received > STRANGER_LIMIT == self.longest:  # of a stranger that has no answer yet
            error = f"more than {STRANGER_LIMIT:,} bytes came before the handshake"
            self._end(error, OSError(error))
        elif not payload:
            self._say_soon()
        elif self._received - self._taken > WINDOW + SAMPLE:
            error = PipeProblem.WINDOW_IGNORED(limit=WINDOW)
            self._end(error, OSError(error))
        elif self._closing:  # discarded: else the peer would seem to ignore the window, though it cannot know yet
            self._taken += len(payload)
        elif self._reading and not self._held:
            self._deliver(payload)
        else:
            self._held += payload

    def _resume(self) -> None:
        """Deliver the held bytes, unless reading is paused again."""
        self._resuming = False
        if not self._reading or self._closing:
            return
        if self._held:
            data = bytes(self._held[:_AT_A_TIME])
            del self._held[:_AT_A_TIME]
            self._deliver(data)
            if self._reading:
                self.resume_reading()
        elif self._ended is not None:
            self._finish()

    def _finish(self) -> None:
        """End after the other side has, once its data is delivered; drop what waits here, as nobody would read it."""
        if self._ended:
            self._end("", OSError(self._ended))
        else:
            self._protocol.eof_received()
            self._end("")

    def _deliver(self, payload: bytes) -> None:
        self._taken += len(payload)
        if self._taken - self._reported >= _REPORTED_EVERY:
            self._say()
        self._protocol.data_received(payload)

    def _say_soon(self) -> None:
        """Answer all questions of one turn at once: strangers may send any number of them."""
        if not self._saying:
            self._saying = True
            self._loop.call_soon(self._say)

    def _say(self) -> None:
        self._saying = False
        if not self._over:
            self._reported = self._taken
            self._put_sample(SampleKind.WINDOW, self._taken, b"")

    # --- sending

    def _send(self, data: bytes | bytearray | memoryview[int]) -> None:
        self._put(data)
        self._sent += len(data)
        if self._asking is None:
            self._ask_later()

    def _put(self, data: bytes | bytearray | memoryview[int]) -> None:
        self._put_sample(SampleKind.DATA, self._sent_samples, data)
        self._sent_samples += 1
        self._cost_in_flight += len(data) + OWN_COST

    def _put_sample(self, kind: SampleKind, number: int, payload: bytes | bytearray | memoryview[int]) -> None:
        tag = b"" if self._tags is None else self._tags.tag(kind, number, payload)
        self._endpoint.outbox.put(self._key, payload, Header(kind, self._rank, number, tag))

    def _ask_later(self) -> None:
        self._asking = self._loop.call_later(_ASKED_AFTER, self._ask, self._sent_samples, self._taken_there)

    def _ask(self, sent_then: int, taken_then: int) -> None:
        """Send empty data, which the other side answers by a window, where nothing has moved for a while."""
        self._asking = None
        still = sent_then == self._sent_samples and taken_then == self._taken_there
        if still:
            self._put(b"")
        if self._waiting or not still:
            self._ask_later()

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
        """End; `told` is the reason for the other side, unless that has ended the stream itself."""
        if self._over:
            return
        self._over = self._closing = True
        if self._ended is None:
            self._put_sample(SampleKind.END, self._sent_samples, told.encode()[:_REASON])
        self._endpoint.forget(self._peer, self._stream)
        # Zenoh may still have it; after that time it has sent it, or the router is lost.
        self._loop.call_later(_SENT_WITHIN, self._endpoint.outbox.arrived, self._rank, self._cost_in_flight)
        if self._asking is not None:
            self._asking.cancel()
        if self._doubting is not None:
            self._doubting.cancel()
        self._waiting.clear()
        self._held.clear()
        self._waiting_bytes = 0
        self._loop.call_soon(self._lost, error)

    def _lost(self, error: OSError | None) -> None:
        protocol, self._protocol = self._protocol, asyncio.Protocol()  # nothing leads back to whom it belonged to
        self.when_doubted = _nothing
        protocol.connection_lost(error)
        if self._when_over is not None:
            self._when_over()


def _nothing() -> None:
    """Nobody cares for doubts."""


def _reason(payload: bytes) -> str:
    return sanitize_text(payload[:_REASON].decode(errors="replace"))


def _missing(count: int) -> str:
    return PipeProblem.SAMPLES_LOST(count=count) if count > 1 else PipeProblem.SAMPLE_LOST()

"""The ends of internal routes that measure: sources of messages, and drains that count them and their latencies."""

from __future__ import annotations

import secrets
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import RawMessage
from rsb_bridge.ros.internal_ends import GID, HEADER
from rsb_bridge.ros.ros_interface import Liveliness

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from rsb_bridge.ros.ros_interface import Sink

_STAMP = 8  # bytes
_SAMPLES = 100_000
"""Latencies of a run that are kept. A round figure: a peer decides how long the run is."""
_AT_ONCE, _BYTES_AT_ONCE = 64, 8 << 20
"""Messages and bytes of a batch: as many messages as the ROS thread takes (`ros_interface.BATCH`)."""
_PAUSE = 0.0005
"""s between two looks at the clock: rates above 2 kHz come in bursts (bench/README.md, Method)."""
_LATE, _LATE_SECONDS = 2, 0.5
"""A run ends after this multiple of its duration plus these seconds: the sender does not keep up."""
_BYTES_PER_KB = 1024


class BenchArrivals(NamedTuple):
    """Messages that have arrived on an internal route since its last reset.

    Attributes:
        latencies: s on the two wall clocks: the 50th, 99th and 99.9th percentile.
    """

    messages: int
    latencies: tuple[float, float, float]


class Time:
    """The clocks that messages are made by."""

    def __init__(self, wall_ns: Callable[[], int] = time.time_ns) -> None:
        self.wall_ns = wall_ns
        self.now = time.monotonic
        self.sleep = time.sleep


class BenchSource:
    """Makes the messages of one internal route that measures, as the ROS thread does for topics."""

    def __init__(self, sink: Sink, clocks: Time, closed: Callable[[], None]) -> None:
        self._sink = sink
        self._clocks = clocks
        self._closed = closed
        self._thread: threading.Thread | None = None
        self._stops = False
        self.lost, self.liveliness = 0, Liveliness(alive=1)
        self.matched, self.refuses = 1, False
        self.sent = 0
        self.rate = 0.0

    @property
    def busy(self) -> bool:
        """Whether messages are being sent."""
        return self._thread is not None and self._thread.is_alive()

    def start(self, size: int, rate: float, count: int) -> None:
        """Send messages of a size at a rate (Hz), on a thread of its own."""
        self.sent, self.rate = 0, 0.0
        self._thread = threading.Thread(target=self.send, args=(size, rate, count), name="rsb-bench", daemon=True)
        self._thread.start()

    def send(self, size: int, rate: float, count: int) -> None:
        """Send messages; return when the sink has the last one."""
        clocks, rest = self._clocks, bytes(max(0, size - _STAMP - len(HEADER)))
        most = max(1, min(_AT_ONCE, _BYTES_AT_ONCE // max(1, size)))
        began = clocks.now()
        ends = began + _LATE * count / rate + _LATE_SECONDS
        sent = 0
        while sent < count and not self._is_over(ends):
            due = min(count, int((clocks.now() - began) * rate) + 1)
            while sent < due and not self._is_over(ends):
                batch = []
                for number in range(sent, min(due, sent + most)):
                    stamp = clocks.wall_ns()
                    payload = b"%b%b%b" % (HEADER, stamp.to_bytes(_STAMP, "little"), rest)
                    batch.append(RawMessage(payload, stamp, GID, number + 1))
                self._sink(batch)
                sent += len(batch)
                self.sent = sent
            clocks.sleep(_PAUSE)
        passed = clocks.now() - began
        # The last message is due before its interval is over, so that the quotient of a short run is too high.
        self.rate = min(rate, sent / passed) if passed > 0 else rate

    def _is_over(self, ends: float) -> bool:
        return self._stops or self._clocks.now() >= ends

    def close(self) -> None:
        """Stop sending."""
        self._stops = True
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(1.0)
        self._closed()


class BenchDrain:
    """Takes the messages of one internal route that measures, where they arrive.

    Args:
        admits: whether a message of so many bytes may come.

    Attributes:
        count: messages since the last reset.
        messages: in all, and `bytes` of them.
    """

    subscriber_count = 1
    refuses = False
    acknowledged = True

    def __init__(
        self, clocks: Time, closed: Callable[[], None], admits: Callable[[BenchDrain, int], bool] = lambda *_: True
    ) -> None:
        self._clocks = clocks
        self._closed = closed
        self._admits = admits
        self._latencies: list[int] = []
        self.count = self.messages = self.bytes = 0
        self.closed = False
        self.gid = secrets.token_bytes(len(GID))

    def assert_liveliness(self) -> None:
        """Do nothing: its messages have no lease."""

    def publish(self, payload: bytes) -> None:
        """Take one message, if the limit admits it."""
        if not self._admits(self, len(payload)):
            return
        self.count += 1
        self.messages += 1
        self.bytes += len(payload)
        if len(self._latencies) < _SAMPLES:
            stamp = int.from_bytes(payload[len(HEADER) : len(HEADER) + _STAMP], "little")
            self._latencies.append(self._clocks.wall_ns() - stamp)

    def reset(self) -> None:
        """Count from 0."""
        self.count = 0
        self._latencies.clear()

    @property
    def arrived(self) -> BenchArrivals:
        """Messages since the last reset."""
        self._latencies.sort()  # the peer may ask often, and what is sorted already takes a tenth of the time
        p50, p99, p999 = (each / 1e9 for each in percentiles(self._latencies))
        return BenchArrivals(self.count, (p50, p99, p999))

    def close(self) -> None:
        """Stop taking messages."""
        self.closed = True
        self._closed()


def resources() -> tuple[float, int]:
    """Processor time (s) and resident memory (bytes) of this process."""
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    return time.process_time(), int(status.partition("VmRSS:")[2].split()[0]) * _BYTES_PER_KB


def percentiles(values: Collection[int]) -> tuple[int, int, int]:
    """Return the 50th, 99th and 99.9th percentile, each rounded up to a value, or zeros without values."""
    ordered = sorted(values)
    if not ordered:
        return 0, 0, 0
    last = len(ordered) - 1
    return (
        ordered[len(ordered) // 2],
        ordered[min(last, len(ordered) * 99 // 100)],
        ordered[min(last, len(ordered) * 999 // 1000)],
    )

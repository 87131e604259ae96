"""The ends of internal routes: sources of their messages, and drains where they arrive. They never reach DDS.

A route gets its endpoints from the `InternalEnds` of its purpose, as a topic's route gets them from
`rsb_bridge.ros.ros_interface.RosInterface`.
"""

from __future__ import annotations

import secrets
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import Endpoint, Liveliness, Publisher, RawMessage, RosError, Subscription

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Hashable

    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.ros.ros_interface import OnFailure, Sink, TopicSpec

_NODE = "/rsb_internal"
_GID = b"rsb_internal".ljust(16, b"\0")
_HEADER = b"\x00\x01\x00\x00"
"""The encapsulation header of CDR, little endian, with which each message of a route begins (PROTOCOL.md, 13)."""
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

SourceT = TypeVar("SourceT", bound=Subscription)
DrainT = TypeVar("DrainT", bound=Publisher)


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
        self.matched = 1
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
        clocks, rest = self._clocks, bytes(max(0, size - _STAMP - len(_HEADER)))
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
                    payload = b"%b%b%b" % (_HEADER, stamp.to_bytes(_STAMP, "little"), rest)
                    batch.append(RawMessage(payload, stamp, _GID, number + 1))
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
        self.gid = secrets.token_bytes(len(_GID))

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
            stamp = int.from_bytes(payload[len(_HEADER) : len(_HEADER) + _STAMP], "little")
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


class PictureSource:
    """Sends the pictures of one view."""

    def __init__(self, sink: Sink, closed: Callable[[], None]) -> None:
        self._sink = sink
        self._closed = closed
        self._number = 0
        self.lost, self.liveliness = 0, Liveliness(alive=1)
        self.matched = 1
        self.closed = False

    def send(self, encoded: bytes, stamp: int) -> None:
        """Send a picture. This may block, so not on the I/O thread.

        Args:
            stamp: ns since the epoch, when it came to the link.
        """
        if not self.closed:
            self._number += 1
            self._sink([RawMessage(_HEADER + encoded, stamp, _GID, self._number)])

    def close(self) -> None:
        """Send nothing more."""
        self.closed = True
        self._closed()


class PictureSink:
    """Takes the pictures of one view where they arrive.

    Attributes:
        taken: called with each picture; set by the user.
    """

    subscriber_count = 1
    acknowledged = True

    def __init__(self, closed: Callable[[], None]) -> None:
        self._closed = closed
        self.taken: Callable[[bytes], None] = lambda _: None
        self.gid = secrets.token_bytes(len(_GID))

    def assert_liveliness(self) -> None:
        """Do nothing: its messages have no lease."""

    def publish(self, payload: bytes) -> None:
        """Take a picture."""
        self.taken(payload[len(_HEADER) :])

    def close(self) -> None:
        """Take no more."""
        self._closed()


class InternalEnds(Generic[SourceT, DrainT]):
    """The ends of all internal routes of one purpose, over all links. Only a link that serves the purpose has ends.

    Attributes:
        sources: make the messages of the internal routes that this side sends on, by internal route and link.
        drains: take the messages of the internal routes that this side receives on, by internal route and link.
    """

    def __init__(self, purpose: Purpose) -> None:
        self._endpoint = Endpoint(_NODE, purpose.type_name, purpose.type_hash, Qos(), _GID)
        self._purpose = purpose
        self._made: dict[Hashable, tuple[Callable[[Sink, Callable[[], None]], SourceT], Callable[..., DrainT]]] = {}
        self.sources: dict[tuple[str, Hashable], SourceT] = {}
        self.drains: dict[tuple[str, Hashable], DrainT] = {}

    def serve(
        self,
        link: Hashable,
        source: Callable[[Sink, Callable[[], None]], SourceT],
        drain: Callable[[Callable[[], None]], DrainT],
    ) -> None:
        """Make the ends of a link's internal routes from now on.

        Args:
            source: makes a source, which passes its messages to the sink, and calls the function once it is closed.
            drain: makes a drain, which calls the function once it is closed.
        """
        self._made[link] = source, drain

    def forget(self, link: Hashable) -> None:
        """Make no more ends of a link that was removed."""
        self._made.pop(link, None)

    def publishers(self, topic: str) -> list[Endpoint]:
        """See `rsb_bridge.ros.ros_interface.RouteEnds`, also for the methods below."""
        return [self._endpoint] if self._purpose.has_name(topic) else []

    subscriptions = publishers

    def subscribe(
        self, spec: TopicSpec, sink: Sink, origin: Hashable, on_failure: OnFailure | None = None
    ) -> Subscription:
        key, (make, _) = (spec.topic, origin), self._makers(origin)
        source: SourceT = make(sink, lambda: _forget(self.sources, key, source))
        self.sources[key] = source
        return source

    def advertise(self, spec: TopicSpec, origin: Hashable) -> Publisher:
        key, (_, make) = (spec.topic, origin), self._makers(origin)
        drain: DrainT = make(lambda: _forget(self.drains, key, drain))
        self.drains[key] = drain
        return drain

    def _makers(self, link: Hashable) -> tuple[Callable[[Sink, Callable[[], None]], SourceT], Callable[..., DrainT]]:
        if link not in self._made:
            raise RosError(f"{link} has no internal routes for {self._purpose.name}")
        return self._made[link]


def _forget(held: dict[tuple[str, Hashable], Any], key: tuple[str, Hashable], which: object) -> None:
    # A route that was opened again has another end under this key by now.
    if held.get(key) is which:
        del held[key]


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

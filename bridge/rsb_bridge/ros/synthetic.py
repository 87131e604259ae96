"""Topics without nodes, for measuring a link and for pictures: `Synthetic` makes and takes their messages.

A route handles them like other topics: it seals, limits and counts their messages. They never reach DDS.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from rsb_bridge.model import pictures
from rsb_bridge.model.benchmark import TYPE, TYPE_HASH, is_bench_topic
from rsb_bridge.model.pictures import is_view_topic
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import Endpoint, RawMessage

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Hashable

    from rsb_bridge.model.clock import Clock
    from rsb_bridge.ros.ros_interface import OnFailure, Publisher, RosInterface, Sink, Subscription

_NODE = "/rsb_bench"
_GID = b"rsb_bench".ljust(16, b"\0")
_HEADER = b"\x00\x01\x00\x00"
_STAMP = 8  # bytes
_SAMPLES = 100_000
_AT_ONCE, _BYTES_AT_ONCE = 64, 8 << 20
_PAUSE = 0.0005
_LATE, _LATE_SECONDS = 2, 0.5
"""A run ends after this multiple of its duration plus these seconds: the sender does not keep up."""
_BYTES_PER_KB = 1024


class SyntheticArrivals(NamedTuple):
    """Messages that have arrived on a topic since its last reset.

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


class SyntheticSource:
    """Makes the messages of one topic, as the ROS thread does for ordinary topics."""

    def __init__(self, sink: Sink, clocks: Time, closed: Callable[[], None]) -> None:
        self._sink = sink
        self._clocks = clocks
        self._closed = closed
        self._thread: threading.Thread | None = None
        self._stops = False
        self.lost = 0
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
        self.rate = min(rate, sent / passed) if passed > 0 else rate

    def _is_over(self, ends: float) -> bool:
        return self._stops or self._clocks.now() >= ends

    def close(self) -> None:
        """Stop sending."""
        self._stops = True
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(1.0)
        self._closed()


class SyntheticReader:
    """Takes the messages of one topic where they arrive.

    Args:
        closed: called at the end.
        admits: whether a message of so many bytes may come.

    Attributes:
        count: messages since the last reset.
        messages: in all, and `bytes` of them.
        closed: whether it takes no more.
        gid: an id as publishers have, which no source has; the bridge announces it as its own.
    """

    subscriber_count = 1
    acknowledged = True

    def __init__(
        self, clocks: Time, closed: Callable[[], None], admits: Callable[[SyntheticReader, int], bool] = lambda *_: True
    ) -> None:
        self._clocks = clocks
        self._closed = closed
        self._admits = admits
        self._latencies: list[int] = []
        self.count = self.messages = self.bytes = 0
        self.closed = False
        self.gid = secrets.token_bytes(len(_GID))

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
    def arrived(self) -> SyntheticArrivals:
        """Messages since the last reset."""
        self._latencies.sort()  # the peer may ask often, and what is sorted already takes a tenth of the time
        p50, p99, p999 = (each / 1e9 for each in percentiles(self._latencies))
        return SyntheticArrivals(self.count, (p50, p99, p999))

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
        self.lost = 0
        self.closed = False

    def send(self, encoded: bytes, stamp: int) -> None:
        """Send a picture. This may block, so not on the I/O thread.

        Args:
            stamp: ns since the epoch, from which its way over the link counts.
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
        gid: as of `SyntheticReader`.
    """

    subscriber_count = 1
    acknowledged = True

    def __init__(self, closed: Callable[[], None]) -> None:
        self._closed = closed
        self.taken: Callable[[bytes], None] = lambda _: None
        self.gid = secrets.token_bytes(len(_GID))

    def publish(self, payload: bytes) -> None:
        """Take a picture."""
        self.taken(payload[len(_HEADER) :])

    def close(self) -> None:
        """Take no more."""
        self._closed()


class Synthetic:
    """A ROS side with such topics in addition to its graph's.

    Attributes:
        picture_sources: the sources of pictures that routes send, by topic and link.
        picture_sinks: where the pictures of the other side go, by topic and link.
        sources: the sources that routes send from, by topic and link: several links may have a topic of one name.
        drains: the drains that routes publish to, by topic and link.
        admits: by link, a function that tells whether a drain may take a message of so many bytes.
    """

    def __init__(self, ros: RosInterface, clocks: Time) -> None:
        self._ros = ros
        self._clocks = clocks
        self.sources: dict[tuple[str, Hashable], SyntheticSource] = {}
        self.drains: dict[tuple[str, Hashable], SyntheticReader] = {}
        self.admits: dict[Hashable, Callable[[SyntheticReader, int], bool]] = {}
        self.picture_sources: dict[tuple[str, Hashable], PictureSource] = {}
        self.picture_sinks: dict[tuple[str, Hashable], PictureSink] = {}
        self._opened: defaultdict[Hashable, list[SyntheticReader]] = defaultdict(list)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._ros, name)

    def publishers(self, topic: str) -> list[Endpoint]:
        """See `rsb_bridge.ros.ros_interface.RosInterface`, also for the methods below."""
        return [endpoint] if (endpoint := _endpoint_of(topic)) else self._ros.publishers(topic)

    def subscriptions(self, topic: str) -> list[Endpoint]:
        return [endpoint] if (endpoint := _endpoint_of(topic)) else self._ros.subscriptions(topic)

    def subscribe(
        self,
        topic: str,
        type_name: str,
        type_hash: str,
        qos: Qos,
        sink: Sink,
        origin: Hashable,
        on_failure: OnFailure | None = None,
    ) -> Subscription:
        key = topic, origin
        if is_view_topic(topic):
            views = self.picture_sources
            picture_source = views[key] = PictureSource(sink, lambda: _forget(views, key, picture_source))
            return picture_source
        if not is_bench_topic(topic):
            return self._ros.subscribe(topic, type_name, type_hash, qos, sink, origin, on_failure)
        source = self.sources[key] = SyntheticSource(sink, self._clocks, lambda: _forget(self.sources, key, source))
        return source

    def advertise(self, topic: str, type_name: str, type_hash: str, qos: Qos, origin: Hashable) -> Publisher:
        key = topic, origin
        if is_view_topic(topic):
            views = self.picture_sinks
            picture_sink = views[key] = PictureSink(lambda: _forget(views, key, picture_sink))
            return picture_sink
        if not is_bench_topic(topic):
            return self._ros.advertise(topic, type_name, type_hash, qos, origin)
        drain = self.drains[key] = SyntheticReader(
            self._clocks,
            lambda: _forget(self.drains, key, drain),
            lambda of, size: origin not in self.admits or self.admits[origin](of, size),
        )
        self._opened[origin].append(drain)
        return drain

    def opened(self, origin: Hashable) -> list[SyntheticReader]:
        """Return a link's drains that were opened since the last call, including closed ones."""
        return self._opened.pop(origin, [])


def _endpoint_of(topic: str) -> Endpoint | None:
    """Return the end of a topic without nodes, or None if it is an ordinary topic."""
    if is_bench_topic(topic):
        return Endpoint(_NODE, TYPE, TYPE_HASH, Qos(), _GID)
    if is_view_topic(topic):
        return Endpoint(_NODE, pictures.TYPE, pictures.TYPE_HASH, Qos(), _GID)
    return None


def _forget(held: dict[tuple[str, Hashable], Any], key: tuple[str, Hashable], which: object) -> None:
    if held.get(key) is which:
        del held[key]


def synthetic_of(ros: RosInterface) -> Synthetic | None:
    """Return the side as a `Synthetic`, or None if it is an ordinary one."""
    return ros if isinstance(ros, Synthetic) else None


def resources() -> tuple[float, int]:
    """Processor time (s) and resident memory (bytes) of this process."""
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    return time.process_time(), int(status.partition("VmRSS:")[2].split()[0]) * _BYTES_PER_KB


def ros_side(ros: RosInterface | None, domain: int, name: str, clock: Clock) -> RosInterface:
    """Return the ROS side in a domain, with these topics, not started yet.

    Args:
        ros: the side to extend, or None for rclpy's.
        clock: the wall clock.
    """
    return cast("RosInterface", Synthetic(ros or _node(domain, name), Time(clock.time_ns)))


def _node(domain: int, name: str) -> RosInterface:
    from rsb_bridge.ros.node import RosNode  # noqa: PLC0415 -- only a running engine needs ROS

    return RosNode(domain, name)


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

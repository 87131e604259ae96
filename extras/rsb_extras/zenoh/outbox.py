"""Sends an endpoint's samples, on a thread if it may take long.

Zenoh blocks a sender while its queue is full (`CongestionControl.BLOCK`), for up to 5 s, and the loop must not
wait. The queue of each priority has 16 batches of 64 kB, each at least half full while it waits. So these fit it, even
if the router takes nothing (one that takes nothing for longer than 5 s counts as lost):

- 5 s of samples at less than `AT_ONCE` bytes a second,
- samples of data, while at most `IN_FLIGHT` bytes of them have not reached the other end, by its own reports.

A thread for each rank sends the excess, so that urgent samples never wait for others. If the network itself is slower
than `AT_ONCE`, a long call shows it. If the other end's reports are false, it shows that, too.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING, Any, NamedTuple

from rsb_extras.zenoh.sample_header import SampleKind

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    import zenoh

    from rsb_extras.zenoh.sample_header import Header

AT_ONCE = 100 * 1024
"""Bytes of one rank in one second that are sent on the loop's thread: in 5 s less than the 512 KiB below."""
IN_FLIGHT = 256 * 1024
"""Bytes of one rank that may be in flight for a further sample to be sent on the loop's thread: half of the 512 KiB
that 16 batches hold at the least. Such samples, and samples that Zenoh's thread takes, save 11 to 18 % of the CPU
(bench/README.md, *Zenoh*)."""
LINK_RANK = 0
"""Of streams that carry a link's own messages, before all routes."""
_RANKS = 4
OWN_COST = 200
"""Bytes of a sample in addition to its payload, for its key and its attachment."""
_MAY_WAIT = 5 * AT_ONCE
"""Bytes that Zenoh's queue holds if the router takes nothing until it counts as lost."""
_COUNTED = 2 * 1024 * 1024
"""Bytes at most of what went lately: after more, the thread sends for another 15 s. A round figure."""
_LONG = 0.05
"""s of a call that had to wait: a round figure, and so are the next two."""
_SLOW_FOR = 30.0
"""s for which the thread sends after such a call: if the network is still slow then, one call in so long holds up the
loop."""
_DISBELIEVED_FOR = 600.0
"""s for which reports do not count after such a call while little was in flight by them: false reports hold up the loop
once in so long."""


class SampleOutbox:
    """Sends samples, in order within a rank. Used on the loop.

    Ranks are `LINK_RANK` and, from 1 on, the ranks of `rsb_bridge.model.session`, highest first.
    """

    def __init__(self, session: zenoh.Session, loop: asyncio.AbstractEventLoop) -> None:
        import zenoh as package  # noqa: PLC0415 (an extra)

        priority, control = package.Priority, package.CongestionControl
        ranks = (priority.INTERACTIVE_HIGH, priority.INTERACTIVE_LOW, priority.DATA, priority.DATA_LOW)
        self._block, self._drop = control.BLOCK, control.DROP
        # A queue that no stream has: were it theirs, datagrams would fill it, and a stream's sender would have to wait.
        self._datagrams = priority.DATA_HIGH
        self._closed_error = package.ZError
        self._session = session
        self._lanes = [_Lane(self._sender(each), loop.time) for each in ranks]

    def put(self, key: str, payload: bytes | bytearray | memoryview[int], header: Header) -> None:
        """Send a sample of a stream; it is held back, and never dropped, while the network is congested."""
        # A copy: the memory may be used again at once, and the thread may send later.
        self._lane(header.rank).put(
            _Sample(key, bytes(payload), header.pack()), reported=header.kind == SampleKind.DATA
        )

    def arrived(self, rank: int, size: int) -> None:
        """Count data of a stream as arrived, of that many bytes with each sample's `OWN_COST`."""
        self._lane(rank).in_flight -= size

    def waiting(self, key: str, rank: int) -> int:
        """Return the bytes of a stream that Zenoh has yet to be given."""
        return self._lane(rank).waiting.get(key, 0)

    def drop(self, key: str, payload: bytes, header: Header | None = None) -> None:
        """Send a datagram, or lose it."""
        attachment = None if header is None else header.pack()
        try:
            self._session.put(
                key, payload, attachment=attachment, congestion_control=self._drop, priority=self._datagrams
            )
        except self._closed_error:
            return

    def close(self) -> None:
        """Stop sending, and drop what waits."""
        for lane in self._lanes:
            lane.close()

    def _lane(self, rank: int) -> _Lane:
        return self._lanes[min(rank, _RANKS - 1)]  # of an inbound stream, the peer has chosen it

    def _sender(self, priority: Any) -> Callable[[_Sample], None]:
        def send(sample: _Sample) -> None:
            try:
                self._session.put(
                    sample.key,
                    sample.payload,
                    attachment=sample.attachment,
                    congestion_control=self._block,
                    priority=priority,
                )
            except self._closed_error:
                return  # the network is closed: so is every stream

        return send


class _Sample(NamedTuple):
    key: str
    payload: bytes
    attachment: bytes


class _Lane:
    """The samples of one priority, in order.

    Attributes:
        waiting: bytes not yet handed to Zenoh, by key; they are subtracted before the call.
        in_flight: bytes of data that have not arrived yet, as far as reported, with each sample's `OWN_COST`.
    """

    def __init__(self, send: Callable[[_Sample], None], now: Callable[[], float]) -> None:
        self.waiting: dict[str, int] = {}
        self.in_flight = 0
        self._send = send
        self._now = now
        self._lately = 0.0
        self._counted_at = self._slow_until = self._disbelieved_until = 0.0
        self._queue: deque[_Sample] = deque()
        self._filled = threading.Condition()
        self._thread: threading.Thread | None = None
        self._closed = False

    def put(self, sample: _Sample, *, reported: bool) -> None:
        """Send a sample, or queue it; `reported` says whether the other end will report its arrival."""
        size = len(sample.payload) + OWN_COST
        if reported:
            self.in_flight += size
        # In this order: it counts each sample. And what is queued goes first.
        if self._has_room(size, reported=reported) and not self._queue:
            self._send_timed(sample)
            return
        with self._filled:
            if self._closed:
                return
            self._queue.append(sample)
            self.waiting[sample.key] = self.waiting.get(sample.key, 0) + len(sample.payload)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="zenoh-send", daemon=True)
                self._thread.start()
            self._filled.notify()

    def close(self) -> None:
        with self._filled:
            self._closed = True
            self._filled.notify()

    def _has_room(self, size: int, *, reported: bool) -> bool:
        """Count a sample, and say whether Zenoh's queue is sure to have room for it."""
        now = self._now()
        left = max(0.0, self._lately - (now - self._counted_at) * AT_ONCE)
        self._lately, self._counted_at = min(left + size, _COUNTED), now
        if now < self._slow_until:
            return False
        return left + size <= _MAY_WAIT or (reported and self.in_flight <= IN_FLIGHT and now >= self._disbelieved_until)

    def _run(self) -> None:
        while True:
            with self._filled:
                self._filled.wait_for(lambda: self._queue or self._closed)
                if self._closed:
                    return
                sample = self._queue[0]
                self._count_out(sample)
            self._send_timed(sample)
            self._queue.popleft()  # only now: while it is queued, new samples queue behind it

    def _count_out(self, sample: _Sample) -> None:
        left = self.waiting.pop(sample.key, 0) - len(sample.payload)
        if left > 0:
            self.waiting[sample.key] = left

    def _send_timed(self, sample: _Sample) -> None:
        began = self._now()
        self._send(sample)
        ended = self._now()
        if ended - began > _LONG:
            self._slow_until = ended + _SLOW_FOR
            if self.in_flight <= IN_FLIGHT:
                self._disbelieved_until = ended + _DISBELIEVED_FOR

"""A latched topic on the receiving side: late joiners here get what late joiners on the sending side get.

Every publisher of the sending side has publishers of its own here, which keep as many of its messages as it keeps
itself. A DDS publisher's depth cannot change, and how much a publisher keeps may become known only as it publishes. So
a history may be spread over several publishers here, each with some of its messages.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import TYPE_CHECKING

from rsb_bridge.model.limits import LATCHED_DEPTH
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.peer import KEPT_LIMIT

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from rsb_bridge.ros.ros_interface import Publisher
    from rsb_bridge.wire.framing import Budget
    from rsb_bridge.wire.headers import HistoryHeader

PUBLISHER_COST = 1 << 20
"""Bytes that are counted with each publisher, which bounds their number. DDS needs about 170 kB."""
MESSAGE_COST = 256  # bytes, for what DDS keeps with each message: an estimate
_ALONE = 16
"""Messages of a growing history for which there is a publisher each, so that each can be dropped alone: as many as the
sender probes each message for (`history_depth`)."""
_MATCHED_WITHIN = 0.5
"""s that subscriptions have to discover a new publisher. They get its earlier messages late, after messages of
other publishers, or never if they want no history."""
_LOOKS_AGAIN_AFTER = 0.02  # s until DDS is asked again who has discovered what: a round figure
_AT_ONCE, _GOES_ON_AFTER = 100, 0.005
"""Messages that waited are published so many at once, and the next ones after so many s: 20,000 a second, which an
rclpy subscriber can take. All at once they overran the depth of one that keeps 500."""
_MANY = 5000
"""Messages that may wait; what is more than these goes at once, so that they come to an end at any rate."""
_ACKNOWLEDGED_WITHIN = 0.5
"""s that a message has to arrive, until that of another publisher may follow: no longer, as a stopped subscriber never
acknowledges one. From 2 kHz on, messages wait for so long once (bench/README)."""
_ASKED = 4
"""Publishers asked for their subscribers: the oldest, which have been discovered by all."""
_GONE_AFTER = 10.0
"""Seconds that a history outlives its publisher: the sender may have just started, and not have discovered it yet."""


class LatchedFullError(Exception):
    """The link's latched topics would keep too much."""

    def __init__(self) -> None:
        super().__init__(
            f"this link's latched topics keep more than {KEPT_LIMIT:,} bytes ({PUBLISHER_COST:,} are counted with "
            "each publisher): give some a smaller depth"
        )


class _OutputHistory:
    """A publisher here, and what it keeps.

    Attributes:
        kept: number of each message that it keeps, and size of its memory, oldest first.
    """

    def __init__(self, publisher: Publisher, depth: int, now: float) -> None:
        self.publisher = publisher
        self.depth = depth
        self.made_at = now
        self.kept: deque[tuple[int, int]] = deque()

    @property
    def full(self) -> bool:
        return len(self.kept) >= self.depth


@dataclass(slots=True)
class _History:
    """The history of one publisher of the sending side.

    Attributes:
        seen_at: time (s) when it was last seen.
        newest: number of its newest message that came here.
        outputs: the publishers here that have its messages.
        waiting: messages that wait for the newest output to be discovered.
        last: the output that published last, or None.
    """

    seen_at: float
    newest: int = 0
    outputs: list[_OutputHistory] = field(default_factory=list)
    waiting: deque[tuple[_OutputHistory, bytes, Callable[[], bool] | None]] = field(default_factory=deque)
    last: _OutputHistory | None = None
    last_at: float = 0.0


class LatchedTopic:
    """The histories of one topic, for as long as its type and QoS stay. It belongs to the I/O loop."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        advertise: Callable[[int], Publisher],
        budget: Budget,
        depth: int,
        failed: Callable[[Exception], None],
    ) -> None:
        """Create a first publisher, so that the topic is there before its first message.

        Args:
            advertise: makes a publisher with a depth; may raise RosError.
            depth: initial depth of a history, until its own has been found.
            failed: called when a message that had waited, or a publisher, fails later.

        Raises:
            RosError: the publisher cannot be created.
            LatchedFullError: the link's latched topics keep too much.
        """
        self._loop = loop
        self._advertise = advertise
        self._budget = budget
        self._failed = failed
        self._histories: dict[bytes, _History] = {}
        self._retired: deque[tuple[float, _OutputHistory]] = deque()
        self._present: Mapping[bytes, int] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._first_depth = depth
        self._spare: _OutputHistory | None = None  # which `_output` looks for
        self._spare = self._output(depth)

    @property
    def subscriber_count(self) -> int:
        """Subscriptions of other nodes that match now."""
        return max((output.publisher.subscriber_count for output in islice(self._outputs(), _ASKED)), default=0)

    def newest(self) -> dict[bytes, int]:
        """Return the number of the newest message of each publisher of the sending side."""
        return {publisher: history.newest for publisher, history in self._histories.items() if history.newest}

    @property
    def has_kept(self) -> bool:
        return any(history.newest for history in self._histories.values())

    def close(self) -> None:
        """Close all publishers: nothing is kept any more."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for output in (*self._outputs(), *(output for _, output in self._retired)):
            self._close(output)
        self._spare = None
        self._retired.clear()
        self._histories.clear()

    # --- publishers of the sending side

    def opened(self) -> None:
        """Begin a new opening; the sender may not have discovered its publishers yet."""
        for history in self._histories.values():
            history.seen_at = self._loop.time()

    def present(self, publishers: Mapping[bytes, int]) -> None:
        """Take the sender's present publishers, and the depth of each or 0. Messages beyond it are kept no longer."""
        now = self._loop.time()
        self._present = publishers
        for publisher, depth in publishers.items():
            if (history := self._histories.get(publisher)) is not None:
                history.seen_at = now
                if depth:
                    self._drop_older(history, history.newest - depth)

    def tick(self) -> None:
        """Drop the histories of publishers that are gone, and expired outputs; called once a second."""
        now = self._loop.time()
        for publisher, history in tuple(self._histories.items()):
            if publisher in self._present:
                history.seen_at = now
            elif now - history.seen_at > _GONE_AFTER:
                del self._histories[publisher]
                self._retire(history.outputs)
        self._keep_one(now)
        while self._retired and now - self._retired[0][0] >= _ACKNOWLEDGED_WITHIN:
            self._close(self._retired.popleft()[1])

    # --- messages

    def publish(self, header: HistoryHeader, content: bytes, still_wanted: Callable[[], bool] | None = None) -> bool:
        """Publish a message, now or as soon as its publisher is discovered by those who have discovered the others.

        Args:
            still_wanted: asked right before it is published if it had to wait, or None if it is wanted in any case.

        Returns:
            Whether it was new; one that was published before is left out.

        Raises:
            RosError: the middleware refused it.
            LatchedFullError: it would be too much to keep.
        """
        now = self._loop.time()
        history = self._histories.get(header.publisher) or _History(now)
        # It was sent again, or a newer one has overtaken it, as datagrams may: late joiners get the newest last.
        if header.number and header.number <= history.newest:
            return False
        history.seen_at = now
        number = header.number or history.newest + 1
        # A depth that the sender has found since also holds for messages that it sent before.
        depth = min(header.depth, self._present.get(header.publisher, 0) or LATCHED_DEPTH)
        output = self._output_for(history, number, depth)
        # Only now, as a history without outputs would have the spare publisher closed, the topic's last one.
        self._histories[header.publisher] = history
        # The message that gives way leaves its memory, so that a full publisher costs no more than before.
        evicted = output.kept[0][1] if output.full else 0
        memory = max(len(content) + MESSAGE_COST, evicted)  # DDS uses it again, and never makes it smaller
        if not self._budget.take(memory - evicted):
            raise LatchedFullError
        if output.full:
            output.kept.popleft()
        output.kept.append((number, memory))
        history.newest = number
        if history.waiting or not self._is_next(history, output, now):
            history.waiting.append((output, content, still_wanted))
            self._look_again()
        else:
            self._publish(history, output, content, now)
        self._drop_older(history, number - depth)
        return True

    def _output_for(self, history: _History, number: int, depth: int) -> _OutputHistory:
        """Return the output for the next message of a history, so that just the newest `depth` are kept."""
        outputs = history.outputs
        if outputs and outputs[-1].depth == depth:
            return outputs[-1]
        filled = [output for output in outputs if output.kept]
        oldest = min(filled, key=lambda output: output.kept[0][0], default=None)
        if oldest is not None and oldest.full and sum(len(output.kept) for output in filled) == depth:
            return oldest  # the message that gives way is kept no longer on the sending side either
        needed = [output for output in filled if output.kept[-1][0] > number - depth]
        count = sum(len(output.kept) for output in needed)
        for output in needed:
            if count < depth and not output.full:
                return output
        if not needed or count >= depth:
            made = self._output(depth)
        else:
            # At first each message gets a publisher; later each one doubles the history, so that a long one needs few.
            made = self._output(max(depth - count, count if count >= _ALONE else 1))
        outputs.append(made)
        return made

    def _drop_older(self, history: _History, number: int) -> None:
        """Drop the outputs of a history all of whose messages have that number or an older one."""
        kept = [output for output in history.outputs if not output.kept or output.kept[-1][0] > number]
        if len(kept) < len(history.outputs):
            self._retire(output for output in history.outputs if output not in kept)
            history.outputs = kept

    # --- outputs

    def _outputs(self) -> Iterator[_OutputHistory]:
        if self._spare is not None:
            yield self._spare
        for history in self._histories.values():
            yield from history.outputs

    def _output(self, depth: int) -> _OutputHistory:
        """Return an output of that depth, the spare one if it fits."""
        spare = self._spare
        if spare is not None and spare.depth == depth:
            self._spare = None
            return spare
        if not self._budget.take(PUBLISHER_COST):
            raise LatchedFullError
        try:
            return _OutputHistory(self._advertise(depth), depth, self._loop.time())
        except RosError:
            self._budget.give(PUBLISHER_COST)
            raise

    def _keep_one(self, now: float) -> None:
        """Have a publisher even without any history, so that the topic stays; a spare one is closed when others do."""
        if self._histories:
            if self._spare is not None and now - self._spare.made_at > _MATCHED_WITHIN:
                self._retire([self._spare])
                self._spare = None
        elif self._spare is None:
            try:
                self._spare = self._output(self._first_depth)
            except (RosError, LatchedFullError) as error:
                self._failed(error)

    def _retire(self, outputs: Iterable[_OutputHistory]) -> None:
        """Close outputs a little later: their last messages may still be on their way to a subscriber."""
        now = self._loop.time()
        self._retired.extend((now, output) for output in outputs)

    def _close(self, output: _OutputHistory) -> None:
        output.publisher.close()
        self._budget.give(PUBLISHER_COST + sum(size for _, size in output.kept))
        output.kept.clear()

    def _publish(self, history: _History, output: _OutputHistory, content: bytes, now: float) -> None:
        history.last, history.last_at = output, now
        output.publisher.publish(content)

    def _is_next(self, history: _History, output: _OutputHistory, now: float) -> bool:
        """Whether a message may be published: it overtakes none that another output has published before."""
        if not self._matched(output, now):
            return False
        last = history.last  # discovered here, a publisher may still be unknown there: then its message comes later
        return (
            last is None
            or last is output
            or now - history.last_at >= _ACKNOWLEDGED_WITHIN
            or last.publisher.acknowledged
        )

    def _matched(self, output: _OutputHistory, now: float) -> bool:
        """Whether those who have discovered the other publishers have discovered an output's, or had time to."""
        if now - output.made_at >= _MATCHED_WITHIN:
            return True
        # The messages just retired may be the only others: once a depth is found, all older ones go at once.
        others = chain(islice(self._outputs(), _ASKED), islice((each for _, each in self._retired), _ASKED))
        return output.publisher.subscriber_count >= max(each.publisher.subscriber_count for each in others)

    def _look_again(self, after: float = _LOOKS_AGAIN_AFTER) -> None:
        if self._timer is None:
            self._timer = self._loop.call_later(after, self._publish_waiting)

    def _publish_waiting(self) -> None:
        self._timer = None
        now = self._loop.time()
        left = max(_AT_ONCE, sum(len(history.waiting) for history in self._histories.values()) - _MANY)
        for history in self._histories.values():
            while left and history.waiting and self._is_next(history, history.waiting[0][0], now):
                left -= 1
                output, content, still_wanted = history.waiting.popleft()
                if still_wanted is not None and not still_wanted():
                    continue
                try:
                    self._publish(history, output, content, now)
                except RosError as error:
                    self._failed(error)
            if history.waiting:
                self._look_again(_LOOKS_AGAIN_AFTER if left else _GOES_ON_AFTER)

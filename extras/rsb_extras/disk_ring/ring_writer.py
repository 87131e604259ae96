"""The thread that writes the ring on disk, and what waits for it."""

from __future__ import annotations

import threading
from collections import deque
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Level, LinkError, why_not_written
from rsb_extras.disk_ring.ring_codes import RingCode, RingProblem, RingText
from rsb_extras.disk_ring.ring_files import RingFiles, undescribed
from rsb_extras.recording.keep_last import RING
from rsb_extras.recording.latched_messages import LatchedMessages
from rsb_extras.recording.message_ring import RingMessage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rsb_bridge.feature_api import EventLog, TopicSpec
    from rsb_extras.disk_ring.ring_files import RingClocks, RingPlace
    from rsb_extras.disk_ring.stretches import Occasion
    from rsb_extras.recording import RecordLimits
    from rsb_extras.recording.mcap_file import RecordedTopic

_QUEUE = 64 << 20
"""Bytes that wait for the disk, beyond which messages are lost: 0.3 s of a camera with 180 MB/s. A round figure."""
_WAKES = 1 << 20
"""Bytes that wait, by which the thread wakes before its time. A round figure."""
_EVERY = 1.0
"""s between two looks at what waits, after each of which the disk has it: up to twice as much is lost with the power. A
round figure: more often, and a memory card wears out."""
_BREATH_AFTER, _BREATH = 64 << 10, 0.0005
"""Bytes that are written before the thread lets others run, and for how long (s), as `recording.keeping` has it."""
_DEFINED_WITHIN = 1.0
"""s that messages wait for their type's definition. A round figure: nodes answer within milliseconds."""
_ASKED_EVERY = 120.0
"""s between two questions for definitions that nobody had: a node may be asked later than its first message comes. As
long as such an answer counts at most (`rsb_bridge.ros.type_descriptions`)."""
_TOPICS = 4096  # topics, with each of their types, that are remembered. A round figure
_ENDS_WITHIN = 10.0  # s that a bridge which ends waits for the disk. A round figure
_RETRIES_EVERY, _TOLD_EVERY = 10.0, 10.0
"""s between two tries after a failure, and between two events on lost messages. Round figures."""


class RingWriter:
    """Writes the ring of one bridge, from `start` to `stop`.

    Args:
        describe: has `described` called with a topic, soon; called on the thread.

    Attributes:
        latched: what late joiners get, for the next writer, once this one has ended; or None.
    """

    def __init__(
        self,
        place: RingPlace,
        limits: RecordLimits,
        clocks: RingClocks,
        log: EventLog,
        describe: Callable[[TopicSpec], None],
    ) -> None:
        self._left_out = self._discarded = 0  # messages, each counted by one thread
        self._place, self._limits, self._clocks, self._log, self._describe = place, limits, clocks, log, describe
        self._queue: deque[RingMessage | Callable[[], None]] = deque()
        self._put = self._taken = 0  # bytes, each counted by one thread
        self._news, self._stopping = threading.Event(), threading.Event()
        self._files: RingFiles | None = None
        self._topics: dict[int, tuple[TopicSpec, RecordedTopic]] = {}
        self._described: dict[TopicSpec, RecordedTopic] = {}
        self._awaited: dict[TopicSpec, float] = {}
        self._failed_at, self._lost_at_failure = float("-inf"), -1
        self._told, self._told_at = 0, float("-inf")
        self._asked_at = clocks.now()
        self._before: RingWriter | None = None
        self._has_next = False
        self.latched: LatchedMessages | None = None
        self._thread = threading.Thread(target=self._run, name="rsb-ring", daemon=True)

    # --- from the I/O thread

    def start(self, before: RingWriter | None = None) -> None:
        """Begin, once the writer before it has left its files."""
        self._before = before
        self._thread.start()

    def put(self, message: RingMessage) -> None:
        """Have a message written, or lose it if too many wait."""
        waiting = self._put - self._taken
        if waiting > _QUEUE:
            self._left_out += 1
            return
        self._put += message.cost
        self._queue.append(message)
        if waiting > _WAKES and not self._news.is_set():
            self._news.set()

    def described(self, topic: TopicSpec, recorded: RecordedTopic) -> None:
        """Take what a file says of a topic."""
        if len(self._described) >= _TOPICS:
            self._described.clear()
        self._described[topic] = recorded
        self._news.set()

    def keep(self, occasion: Occasion) -> Future[Path]:
        """Keep a stretch around an occasion. The result is the folder where it will be; a `LinkError` says why not."""
        answer: Future[Path] = Future()
        self._queue.append(partial(self._keep, occasion, answer))
        self._news.set()
        return answer

    def stop(self, *, has_next: bool = False) -> None:
        """Have it end soon, with all that waits.

        Args:
            has_next: whether another one goes on from here, which misses no message.
        """
        self._has_next = has_next
        self._stopping.set()
        self._news.set()

    def join(self) -> None:
        """Wait until it has ended, but not for ever: a disk may hang."""
        self._thread.join(_ENDS_WITHIN)

    # --- on the thread

    def _run(self) -> None:
        if self._before is not None:
            self._before.join()
            self.latched = self._before.latched
            self._before = None
        try:
            while not self._stopping.is_set():
                self._work()
                self._news.wait(_EVERY)
                self._news.clear()
            self._work()
            if self._files is not None and not self._is_failing:
                with self._may_fail():
                    self._files.end(self.lost)
        finally:
            if self._files is not None:
                self._files.close()
                self.latched, self._files = self._files.latched, None
            if not self._has_next:
                self.latched = None

    @property
    def lost(self) -> int:
        """Number of messages that were not written, as too many waited or nothing could be written."""
        return self._left_out + self._discarded

    @property
    def _is_failing(self) -> bool:
        return self._lost_at_failure >= 0

    def _work(self) -> None:
        if not self._is_failing or self._clocks.now() - self._failed_at >= _RETRIES_EVERY:
            with self._may_fail():
                if self._files is None or self._is_failing:
                    self._begin()
                self._write_all()
                assert self._files is not None
                self._files.look_after(self.lost)
                self._ask_again()
                self._tell_lost()
        if self._is_failing:
            self._discard()

    @contextmanager
    def _may_fail(self) -> Iterator[None]:
        """Write no more for a while if that fails."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 -- whatever it is, the ring begins anew, and the bridge goes on
            self._failed_at = self._clocks.now()
            if self._files is not None:
                self._files.abandon()
            if not self._is_failing:
                self._lost_at_failure = self.lost
                folder = self._place.folder / RING
                why = why_not_written(error, folder) if isinstance(error, OSError) else str(error)
                self._log.add(Level.WARNING, RingCode.STOPPED, RingText.STOPPED(folder=folder, error=why))

    def _begin(self) -> None:
        if self._files is None:
            self._files = RingFiles(
                self._place, self._limits, self._clocks, self._log, self._described, self.latched or LatchedMessages()
            )
            self.latched = None  # they are the files' by now
        self._files.begin()
        if self._is_failing:
            text = RingText.GOES_ON(count=self.lost - self._lost_at_failure)
            self._log.add(Level.INFO, RingCode.GOES_ON, text)
            self._told, self._lost_at_failure = self.lost, -1

    def _discard(self) -> None:
        """Lose what waits while nothing can be written."""
        while self._queue:
            each = self._queue.popleft()
            if isinstance(each, RingMessage):
                self._taken += each.cost
                self._discarded += 1
            else:
                each()

    def _write_all(self) -> None:
        assert self._files is not None
        unbroken = 0
        while self._queue:
            each = self._queue[0]
            if not isinstance(each, RingMessage):
                self._queue.popleft()
                each()
                continue
            if (topic := self._recorded(each.topic)) is None:
                return
            self._queue.popleft()
            self._taken += each.cost
            self._files.write(topic, each)
            unbroken += each.cost
            if unbroken > _BREATH_AFTER:
                unbroken = 0
                self._stopping.wait(_BREATH)

    def _recorded(self, topic: TopicSpec) -> RecordedTopic | None:
        """Return what a file says of a topic, or None while it is asked."""
        known = self._topics.get(id(topic))  # by its identity: to hash it would cost as much as all else
        return known[1] if known is not None else self._newly_recorded(topic)

    def _newly_recorded(self, topic: TopicSpec) -> RecordedTopic | None:
        recorded = self._described.get(topic)
        if recorded is not None:
            if recorded.description and self._files is not None and self._files.lacks_definition(topic.topic):
                self._files.finish_segment()
            if len(self._topics) >= _TOPICS:
                self._topics.clear()
            self._topics[id(topic)] = topic, recorded
            return recorded
        now = self._clocks.now()
        if topic not in self._awaited:
            if len(self._awaited) >= _TOPICS:
                self._awaited.clear()
            self._awaited[topic] = now
            self._describe(topic)
        is_awaited = now - self._awaited[topic] < _DEFINED_WITHIN and not self._stopping.is_set()
        return None if is_awaited else undescribed(topic)

    def _ask_again(self) -> None:
        """Ask anew for definitions that nobody had; those known by now count from the topic's next message on."""
        now = self._clocks.now()
        if now - self._asked_at < _ASKED_EVERY:
            return
        self._asked_at = now
        for key, (topic, recorded) in [*self._topics.items()]:
            if not recorded.description:
                del self._topics[key]
                self._describe(topic)

    def _keep(self, occasion: Occasion, answer: Future[Path]) -> None:
        is_awaited = answer.set_running_or_notify_cancel()  # from here on, nobody can take the question back
        if self._files is None or self._is_failing:
            found: Path | str = RingProblem.NOT_WRITTEN()
        else:
            try:
                found = self._files.keep(occasion, self.lost)
            except Exception:
                if is_awaited:
                    answer.set_exception(LinkError(RingProblem.NOT_WRITTEN()))
                raise
        if not is_awaited:
            return
        if isinstance(found, str):
            answer.set_exception(LinkError(found))
        else:
            answer.set_result(found)

    def _tell_lost(self) -> None:
        now = self._clocks.now()
        if self.lost > self._told and now - self._told_at >= _TOLD_EVERY:
            text = RingText.LOST(count=self.lost - self._told, folder=self._place.folder / RING)
            self._log.add(Level.WARNING, RingCode.LOST, text)
            self._told, self._told_at = self.lost, now

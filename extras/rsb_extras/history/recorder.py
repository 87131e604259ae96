"""Watches an engine once a second, on a thread of its own, and answers what happened."""

from __future__ import annotations

import math
import queue
import threading
from concurrent.futures import Future
from typing import TYPE_CHECKING, TypeVar

from rsb_bridge.feature_api import Level
from rsb_extras.history.history_codes import HistoryCode
from rsb_extras.history.history_data import KEPT_FOR
from rsb_extras.history.timeline import FROM_THE_FUTURE, Timeline, is_from_the_future

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rsb_bridge.feature_api import Clock, Event, EventLog, Snapshot
    from rsb_extras.history.history_data import HistoryReport
    from rsb_extras.history.timeline import Saved

_SET_BY = 2.0
"""s by which the wall clock must jump to count as set."""
SET_WITHIN = 600.0
"""s in which the clock of a machine that starts without the time is set, by NTP over a network that has to come first.
A round figure."""
T = TypeVar("T")
_EVERY = 1.0  # s, as often as the engine makes a snapshot
_GAP = 30.0
"""s without a new snapshot that count as a gap in the history; not measured.

The engine makes one a second. A much shorter time would give a busy machine gaps; through a longer one, the state
before it would count on.
"""


class ClockAxis:
    """Times in s since the epoch that go on evenly, as long as `advance` reports no jump.

    A machine without a battery for its clock starts with an old time, and is set right later. Until then, time goes on
    from `floor`, so that nothing seems to happen before what happened earlier.

    Args:
        steady: s on a clock that nobody sets and that goes on while the machine sleeps.
        wall: s since the epoch.
        floor: the time of what is remembered last.

    Attributes:
        jump: s by which the clock was set, as noticed by the last `advance`, or 0.
    """

    def __init__(self, steady: float, wall: float, floor: float = 0.0) -> None:
        self.now = max(wall, floor)
        self.jump = 0.0
        self._steady = steady
        self._offset = wall - steady

    def advance(self, steady: float, wall: float) -> float:
        """Move on to the present time.

        Args:
            steady: as in the constructor.
            wall: as in the constructor.

        Returns:
            s that have passed.
        """
        passed = steady - self._steady
        self._steady = steady
        self.now += passed
        offset = wall - steady
        self.jump = offset - self._offset if abs(offset - self._offset) > _SET_BY else 0.0
        if self.jump:
            self._offset = offset
        return passed

    def set(self, wall: float, earliest: float) -> float:
        """After a jump: go on from the wall clock's time, but from no earlier one.

        Returns:
            s by which the axis moved.
        """
        before, self.now = self.now, max(wall, earliest)
        return self.now - before

    def of_wall(self, moment: float) -> float:
        """Convert a recent time of the wall clock to this axis."""
        return moment + self.now - (self._steady + self._offset)


class Recorder:
    """Remembers what an engine's snapshots and events show, from `start` to `stop`.

    Args:
        latest: gives its newest snapshot; a new object each time that it is renewed.

    Attributes:
        changes: grows with everything that is worth saving soon.
    """

    def __init__(self, name: str, role: str, events: EventLog, latest: Callable[[], Snapshot], clock: Clock) -> None:
        self.changes = 0
        self._events = events
        self._latest = latest
        self._clock = clock
        self._timeline = Timeline(name, role)
        self._name, self._role = name, role
        self._axis = ClockAxis(clock.steady(), clock.time_ns() / 1e9)
        self._seen: Snapshot | None = None
        self._observed = self._axis.now
        self._trusted_at = math.inf  # on the steady clock: from then on, the wall clock is right, and the past is not
        self._followed = 0
        self._work: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._asking = threading.Lock()
        self._has_ended = False
        self._thread = threading.Thread(target=self._run, name="rsb-history", daemon=True)

    # --- from any thread

    def start(self) -> None:
        """Begin to watch."""
        with self._asking:
            self._thread.start()

    def stop(self, timeout: float) -> None:
        """Take note of how everything is at the end, and watch no more."""
        self._work.put(None)
        if self._thread.is_alive():
            self._thread.join(timeout)

    def history(self, seconds: float, link: str = "") -> Future[HistoryReport]:
        """Report on the last `seconds`, 24 h at most, of one link or of all."""

        def report() -> HistoryReport:
            whole = self.report(min(seconds, KEPT_FOR))
            return whole.of_link(link) if link else whole

        return self.ask(report)

    def ask(self, question: Callable[[], T]) -> Future[T]:
        """Have a method of this called on its thread; on the calling one, while that does not run.

        Args:
            question: the method; an exception of it becomes the future's.
        """
        answer: Future[T] = Future()

        def work() -> None:
            if not answer.set_running_or_notify_cancel():
                return
            try:
                result = question()
            except Exception as error:  # noqa: BLE001 -- it is the future's, and no end of this thread
                answer.set_exception(error)
            else:
                answer.set_result(result)

        # Without the lock, a question could come after the thread's last look at the queue, and never be answered.
        with self._asking:
            if self._thread.ident is None or self._has_ended:
                work()
            else:
                self._work.put(work)
        return answer

    # --- on the thread

    def _run(self) -> None:
        try:
            self._watch()
        finally:  # after an error of `_watch`, too: nobody may wait for an answer of a thread that has ended
            with self._asking:
                while not self._work.empty():
                    if (work := self._work.get()) is not None:
                        work()
                self._has_ended = True

    def _watch(self) -> None:
        due = self._clock.steady()
        while True:
            try:
                work = self._work.get(timeout=max(0.0, due - self._clock.steady()))
            except queue.Empty:
                self.record()
                # After a sleep of the machine, missed looks are not made up for.
                due = max(due + _EVERY, self._clock.steady())
                continue
            if work is None:
                break
            work()
        self.record()
        self._timeline.cut()

    def restore(self, saved: Saved, events: Iterable[Event] = ()) -> None:
        """Continue a saved time line; the seconds that this process has recorded so far are dropped.

        Args:
            saved: by an earlier process.
            events: later ones of that process; those with a time in the future are ignored.

        Raises:
            ValueError: it contradicts itself, or the clock is days behind it.
        """
        self.record()  # a new axis does not notice that the clock was set before it began
        wall = self._clock.time_ns() / 1e9
        if is_from_the_future(saved, wall):
            raise ValueError(FROM_THE_FUTURE)
        self._timeline = Timeline.restore(saved, self._name, self._role)
        self._timeline.go_on(each for each in events if each.time - wall <= KEPT_FOR)
        steady = self._clock.steady()
        self._axis = ClockAxis(steady, wall, floor=self._timeline.last)
        self._trusted_at = steady + SET_WITHIN
        self._observed = self._axis.now
        # The dropped time line had the events of this process so far; the new one gets them again.
        self._followed, self._seen = 0, None

    def record(self) -> None:
        """Take note of how everything is now."""
        axis, timeline = self._axis, self._timeline
        wall = self._clock.time_ns() / 1e9
        axis.advance(self._clock.steady(), wall)
        if axis.now - self._observed > _GAP:
            timeline.cut()
        if axis.jump:
            self._clock_set(wall)
        elif self._clock.steady() >= self._trusted_at:
            self._trusted_at = math.inf
            self._was_ahead(axis.now - wall, wall)
        self._follow()
        snapshot, seen = self._latest(), self._seen
        if not snapshot.running:
            timeline.cut()
        elif snapshot is not seen:  # an engine that hangs makes no new one, and the history has a gap
            # If the engine had ended, the gap needs no explanation.
            if seen is not None and seen.running and axis.now - self._observed > _GAP:
                self._slept(axis.now - self._observed)
            self._observed = axis.now
            before = timeline.changes
            timeline.observe(snapshot, axis.now)
            self.changes += timeline.changes - before
        self._seen = snapshot

    def report(self, seconds: float) -> HistoryReport:
        """Return what `history` returns; called on this recorder's thread."""
        self.record()
        return self._timeline.report(self._axis.now, seconds, running=True)

    def save(self) -> Saved:
        """Return all that is remembered, to be restored by the next process."""
        if not self._has_ended:
            self.record()
        return self._timeline.save(self._axis.now)

    def _follow(self) -> None:
        for event in self._events.after(self._followed):
            self._followed = event.number
            self.changes += self._timeline.did(event, self._axis.of_wall(event.time))

    def _slept(self, seconds: float) -> None:
        text = f"no history of the last {_span(seconds)}: the machine slept, or the process could not run"
        self._events.add(Level.WARNING, HistoryCode.GAP, text)

    def _clock_set(self, wall: float) -> None:
        jump = self._axis.jump
        moved = self._axis.set(wall, self._timeline.earliest(self._axis.now))
        self._timeline.move(moved)
        self._observed += moved
        direction = "forward" if jump > 0 else "back"
        text = f"the clock was set {direction} by {_span(abs(jump))}; the time line since the start moves with it"
        self._events.add(Level.WARNING, HistoryCode.CLOCK_SET, text)

    def _was_ahead(self, seconds: float, wall: float) -> None:
        """Go on from the wall clock's time, and move what came before, if an earlier process was so far ahead."""
        if seconds <= _SET_BY:
            return
        self._timeline.move_back(seconds)
        self._observed += self._axis.set(wall, wall)
        text = f"the clock of an earlier process was ahead by {_span(seconds)} or more; its time line moves back"
        self._events.add(Level.WARNING, HistoryCode.CLOCK_SET, text)


def _span(seconds: float) -> str:
    whole = round(seconds)
    hours, minutes = divmod(whole // 60, 60)
    parts = [f"{hours} h"] * bool(hours) + [f"{minutes} min"] * bool(minutes) + [f"{whole % 60} s"] * (not hours)
    return " ".join(parts)

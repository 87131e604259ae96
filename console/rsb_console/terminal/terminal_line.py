"""The operator's line: how fast it carries what is written to the terminal, and how late the terminal is.

The terminal's answers tell it: each stands behind all that was written before its question. A terminal that gives none
leaves only the kernel, which takes no more once its own buffer is full, 4 to 20 kB later.
"""

from __future__ import annotations

import contextlib
import os
import termios
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

FRAME: Final = 0.15
"""s of the line that one frame may take. With what may be in flight before it, a key's effect waits half as long as a
person notices (0.5 s)."""
_NEXT_AFTER: Final = 0.05
"""s of the line that may be in flight when the next frame is written: enough that it never waits for this program."""
_AT_FIRST: Final = 11_520
"""Bytes/s to begin with: those of a serial console, 115,200 baud. On a faster line, the first answers raise it."""
_LEAST: Final = 120
"""Bytes that a frame may have over any line: some words."""
_TELLS: Final = 300
"""Bytes from which on an answer tells the line's rate, or half a frame of a line that has less."""
_MUCH: Final = 2.0
"""Times as fast as known, which an answer alone proves: jitter makes answers late, never early. And times as long as
what has passed that a frame may be: radio links and queues let some bytes pass at once after a rest, at any rate."""
_STALE_AFTER: Final = 5.0
"""s without such an answer after which the rate may be another one: the next frame is of that size, and is answered
before the one after it. A round figure."""
_AT_ONCE: Final = 0.01
"""s. What takes no longer tells only that the line is no slower."""
_SLACK: Final = 0.1
"""s by which an answer may be later than expected."""
_TRIED_EVERY: Final = 1.0
"""s between two frames while an expected answer does not come: it may be lost, or the line hangs."""
_ASKED_AFTER: Final = 1.0
"""s after which a small frame is followed by a question, too."""
_SECONDS: Final = 5
"""s over which `TerminalLine.per_second` is measured, if something is written in each."""
_GIVEN_UP_AFTER: Final = 30.0
"""s after which an answer that has not come will not: another terminal may be there, which gives none. As for keys."""
_ASKED_AT_MOST: Final = 16
"""Questions to a terminal that has given no answer, of which the newest are remembered."""
_EMPTIED_EVERY: Final = 20.0
"""s after which a line that is in full use is let run empty, for as long as a round trip. A round figure."""
_FASTER, _FASTER_AFTER, _AGAIN_AFTER = 1.1, 2.0, 30.0
"""Times by which a line without answers is tried to be faster, s of full use without a wait that allow it, and the same
once it was too slow: as its buffer hides that for long, each such trial may make it some seconds late."""


_PSEUDO_TERMINALS: Final = range(136, 144)
"""Linux's major device numbers of pseudo-terminals (devices.txt), which have a speed that nobody keeps to."""
_OUTPUT_SPEED: Final = 5
"""Place of the output's speed in `termios.tcgetattr`."""
_SPEEDS: Final = {getattr(termios, f"B{baud}"): baud for baud in (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)}
_BITS: Final = 10
"""Bits of a byte on a serial line, with its start and its stop."""


class _Asked(NamedTuple):
    at: float
    size: int  # bytes since the question before that were in flight
    due: float
    alone: bool  # nothing else was in flight


class TerminalLine:
    """The bytes in flight to one terminal. Its methods may be called from any thread.

    Args:
        rate: bytes/s, if they are known from the start, or 0.

    Attributes:
        rate: bytes/s that it carries, as far as is known.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, rate: float = 0.0) -> None:
        self.rate = rate or _AT_FIRST
        self._clock = clock
        self._lock = threading.RLock()
        self._trip: float | None = None
        """s of an answer over an empty line, or None for a terminal that has given none, and when that was seen."""
        self._trip_seen = 0.0
        self._asked: deque[_Asked] = deque()
        self._since_question = self._written = 0
        self._answered_at = self._asked_at = self._wrote_at = self._gave_up_at = float("-inf")
        self._in_flight, self._at = 0.0, clock()
        """Bytes that the line has not carried yet, by estimate, and when it was made."""
        self._told_at = self._at
        """When an answer told the rate last."""
        self._passed_since, self._passed = float("-inf"), 0
        """When a frame's time began in which answers came at once, and the bytes before them."""
        self._began = self._at
        self._marks: deque[tuple[float, int]] = deque([(self._at, 0)], maxlen=_SECONDS)
        """How much was written until when, a second apart."""
        self._kernels = 0.0
        self._full_since: float | None = None

    # --- what happens

    def wrote(self, size: int) -> None:
        """Note bytes that were written."""
        with self._lock:
            if not self._carry():
                self._full_since = None
            self._in_flight += size
            self._written += size
            if self._at - self._marks[-1][0] >= 1.0:
                self._marks.append((self._at, self._written))
            self._since_question += size
            self._wrote_at = self._at

    def asked(self, at: float) -> None:
        """Note a question of a time (s), written after all else."""
        with self._lock:
            trip = self._trip or 0.0
            due = self._carry() / self.rate + at + trip + max(_SLACK, trip / 2)
            alone = not self._asked and self._in_flight <= self._since_question
            # What was written long before it has left by now.
            size = min(self._since_question, round(self._in_flight))
            self._asked.append(_Asked(at, size, due, alone))
            while not self.answers and len(self._asked) > _ASKED_AT_MOST:
                self._asked.popleft()
            self._asked_at, self._since_question = at, 0

    def answered(self, asked_at: float) -> None:
        """Take the answer to the question of a time (s)."""
        with self._lock:
            self._carry()
            size, alone, was_given_up = 0, False, asked_at <= self._gave_up_at
            while self._asked and self._asked[0].at <= asked_at:
                asked = self._asked.popleft()
                alone = asked.alone
                if was_given_up or asked.at > self._gave_up_at:  # else it went to another terminal
                    size += asked.size
            took = self._at - asked_at
            # Where the rate may be another one, what much takes beyond it is no round trip.
            is_trip = alone and self._is_to_empty and not (self._is_stale and size >= self._telling)
            # An answer that was given up may have waited for a line that is slower than known.
            if not was_given_up and (self._trip is None or took <= self._trip or is_trip):
                self._trip, self._trip_seen = min(took, max(_AT_ONCE, took - size / self.rate)), self._at
            # One that waited in a bunch with the answer before, or in this process, tells nothing.
            trip = self._trip or 0.0
            if not self._at - self._answered_at <= _AT_ONCE < took - trip:
                self._learn(size, self._at - max(asked_at + trip, self._answered_at))
            self._answered_at = self._at
            # What was written before the question has arrived; of the rest, what a round trip carries does not wait.
            self._in_flight = max(0.0, self._not_answered - trip * self.rate)

    def expect_no_answers(self) -> None:
        """Note that the terminal, which may be another one, answers nothing: frames wait for the line alone."""
        with self._lock:
            self._gave_up_at = self._clock()
            self._trip = None

    def waited(self, size: int, seconds: float) -> None:
        """Note that the kernel let a write wait: its buffer is full, and only the line empties it."""
        with self._lock:
            self._carry()
            self._full_since = None
            if not self.answers:
                # A part may have found room, so both are too much. A line that has stood still is no slow one yet.
                found = min(size / seconds, self.per_second)
                self.rate = min(self.rate, max(found, self.rate / _MUCH))
                at_first = self._written - self.rate * (self._at - self._began)
                self._in_flight = self._kernels = max(self._kernels, self._in_flight, at_first)

    def _learn(self, size: int, seconds: float) -> None:
        found, tells, was_stale = size / max(seconds, _AT_ONCE), size >= self._telling, self._is_stale
        if tells:
            self._told_at = self._at
        if seconds <= _AT_ONCE or found > _MUCH * self.rate:
            if self._at - self._passed_since > FRAME:
                self._passed_since, self._passed = self._at, 0
            self._passed += size
            self.rate = max(self.rate, min(found, _MUCH * self._passed / FRAME))
        elif tells:
            # A delay of a moment may be jitter; a longer one is the line's, or it costs little: rates rise at once.
            if seconds > _TRIED_EVERY or was_stale:
                self.rate = found
            elif found * _MUCH < self.rate:
                self.rate = max(found, self.rate / 2)
            else:
                self.rate += (found - self.rate) / 4

    def _carry(self) -> float:
        """Have the line carry what it can until now, and return the bytes that are left."""
        before, self._at = self._at, self._clock()
        self._in_flight = max(0.0, self._in_flight - (self._at - before) * self.rate)
        return self._in_flight

    # --- what is asked

    @property
    def answers(self) -> bool:
        """Whether the terminal has answered."""
        return self._trip is not None

    @property
    def _is_to_empty(self) -> bool:
        """Whether the line has to be empty once, as only then an answer tells its round trip."""
        return self._trip is not None and self._at - self._trip_seen > _EMPTIED_EVERY

    @property
    def _telling(self) -> float:
        """Bytes whose answer tells the rate: fewer are lost in the jitter of a radio link."""
        return min(_TELLS, max(_LEAST, self.rate * FRAME) / 2)

    @property
    def _is_stale(self) -> bool:
        return self.answers and self._at - self._told_at > _STALE_AFTER

    @property
    def _not_answered(self) -> int:
        return self._since_question + sum(each.size for each in self._asked)

    @property
    def _overdue(self) -> float:
        return max(0.0, self._at - self._asked[0].due) if self._asked and self.answers else 0.0

    @property
    def per_second(self) -> float:
        """Bytes/s that were written lately."""
        with self._lock:
            at, written = self._marks[0]
            return (self._written - written) / max(1.0, self._clock() - at)

    @property
    def most(self) -> float:
        """Bytes of the next frame at most."""
        with self._lock:
            if self._overdue:
                return _LEAST
            return self._telling if self._is_stale else max(_LEAST, self.rate * FRAME)

    @property
    def is_to_be_asked(self) -> bool:
        """Whether an answer now would tell how the line is."""
        return self._since_question >= self._telling or self._clock() - self._asked_at > _ASKED_AFTER

    @property
    def late(self) -> float:
        """Seconds until the terminal has all that was written, as far as overdue answers and the rate tell."""
        with self._lock:
            return max(self._carry() / self.rate, self._overdue)

    @property
    def is_free(self) -> bool:
        """Whether the next frame may be written."""
        with self._lock:
            is_tried = self._is_stale and sum(each.size for each in self._asked) >= self._telling
            is_carried = self.late <= (0.0 if self._is_to_empty else _NEXT_AFTER)
            if is_carried and not is_tried and not (self._is_to_empty and self._asked):
                return True
            if self._overdue > _GIVEN_UP_AFTER:
                self.expect_no_answers()
            if self._full_since is None:
                self._full_since = self._at
            elif not self.answers and self._at - self._full_since > (_AGAIN_AFTER if self._kernels else _FASTER_AFTER):
                self._full_since, self.rate = self._at, self.rate * _FASTER
            return self._overdue > 0.0 and self._at - self._wrote_at > _TRIED_EVERY


def rate_of(terminal: int) -> float:
    """Return the bytes/s of a serial line behind a file descriptor, or 0 for another terminal."""
    with contextlib.suppress(OSError, termios.error):
        if os.major(os.fstat(terminal).st_rdev) not in _PSEUDO_TERMINALS:
            speed = termios.tcgetattr(terminal)[_OUTPUT_SPEED]
            return _SPEEDS.get(speed, 0) / _BITS
    return 0.0

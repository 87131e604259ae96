"""The lease of a link: proof that the two sides heard each other within the last second. Sans-IO.

Each side sends numbers, and the newest number that it has heard. A message carries the newest number that its sender
had heard when the message was taken from ROS, so the receiver knows by its own clock alone that the message is younger
than that number. Neither a clock of the other side nor the order in which streams arrive matters.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.ros_interface import RawMessage, Request
    from rsb_bridge.ros.ros_thread import RosTurns

# In s. Where these were measured: bench/README.md, *Constants of arming*.
LASTS = 1.0  # that a message of an armed route may be old at most when it is published
BEAT = 0.25  # from one number to the next (PROTOCOL.md, 7.2): of four in `LASTS`, one may be lost
GIVEN_UP_AFTER = 3.0  # without an answer, until everything is disarmed; nothing passes after `LASTS`
_FIRST_WITHIN = 10.0  # in which it has to begin (PROTOCOL.md, 7.2); the asking side waits for half of that
SLOW = LASTS - BEAT  # round trip from which on a link is too slow: most messages would be too old
_KEPT = 64  # numbers that each side remembers: more than are sent within `GIVEN_UP_AFTER`


class Standstill(Enum):
    """The place where nothing moved, in words."""

    LOOP = "this side's bridge stood still"
    ROS_THREAD = "this side's ROS thread stood still"
    PEER = "the other side or the link stood still"


class LeasePhase(Enum):
    """The phases of one side's half of a lease; a standstill ends each but the first."""

    OFF = auto()  # nothing is armed, so that no numbers are sent
    SENDS = auto()  # numbers are sent, and none has been answered in time yet
    ANSWERED = auto()  # the other side hears this one, and does not know yet that it is heard itself
    BEGUN = auto()  # the other side knows that it is heard, so that it takes what is sent from now on
    OVER = auto()  # something stood still; it stays dead until it is switched off and on again


_BEGINS = (LeasePhase.SENDS, LeasePhase.ANSWERED)
_MOVES = (*_BEGINS, LeasePhase.BEGUN)
M = TypeVar("M", "RawMessage", "Request")


class LeaseHalf:
    """One side's half. It belongs to the I/O loop, except `newest_before`.

    Args:
        steady: s on a clock that nobody sets, and that goes on while the machine sleeps.
        ended: called once when it is over, after the last message has passed.
    """

    def __init__(self, steady: Callable[[], float], turns: RosTurns, ended: Callable[[], None]) -> None:
        self._steady = steady
        self._turns = turns
        self._ended = ended
        self.phase = LeasePhase.OFF
        self.number = 0  # the newest that this side has sent
        self.over: Standstill | None = None  # where nothing moved, if it is or was OVER
        self._began = self._beaten = 0.0
        self._sent: dict[int, float] = {}  # when, by number
        self._newest_before = 0  # the newest number of this side before `begin`
        self._first_answer = 0  # the first number since `begin` that carried one of the other side's, or 0
        self._acknowledged = 0  # the newest number that the other side has heard
        self._confirmed = float("-inf")  # when that was sent
        self.round_trip = 0.0  # s from the newest number that was answered to its answer
        self._heard: tuple[tuple[int, float], ...] = ()  # numbers of the other side, and when; replaced, never changed

    # --- on and off

    def begin(self) -> None:
        """Send numbers from now on. It is alive once the other side has answered one of them."""
        self._turns.watch(self)
        self.phase, self.over = LeasePhase.SENDS, None
        self._began = self._beaten = self._steady()
        self._confirmed = float("-inf")
        self._first_answer = 0
        self._acknowledged = self._newest_before = self.number  # those up to this one do not count

    def end(self) -> None:
        """Send no more numbers, and forget the other side's."""
        self._turns.leave(self)
        self.phase = LeasePhase.OFF
        self._heard = ()

    # --- numbers

    def beat(self) -> tuple[int, int]:
        """Return the next number of this side, and the newest of the other one. To be called every `BEAT` s."""
        now = self._end_at_standstill()  # as this number would hide a standstill before it
        self._beaten = now
        self.number += 1
        self._sent[self.number] = now
        if len(self._sent) > _KEPT:
            del self._sent[next(iter(self._sent))]
        if self._heard and not self._first_answer:
            self._first_answer = self.number
        return self.number, self._heard[-1][0] if self._heard else 0

    def hear(self, number: int, echo: int) -> None:
        """Take a number of the other side, and the number of this side that it has heard."""
        now = self._end_at_standstill()  # as numbers that waited through a standstill would revive the lease
        if 0 < echo <= self._newest_before:
            return  # it is of the lease before this one: datagrams may come late
        # While it is off, a number that answers one of this side belongs to a lease that is over, and came late. If it
        # counted, the next lease could count as begun before the other side had begun it, and a goal would be refused.
        if (self.phase is not LeasePhase.OFF or not echo) and (not self._heard or number > self._heard[-1][0]):
            self._heard = (*self._heard[1 - _KEPT :], (number, now))
        sent = self._sent.get(echo)
        if sent is not None and echo > self._acknowledged:
            self._acknowledged, self._confirmed, self.round_trip = echo, sent, now - sent
            if self.round_trip <= LASTS and self.phase in _BEGINS:
                self.phase = LeasePhase.BEGUN if 0 < self._first_answer <= echo else LeasePhase.ANSWERED

    # --- what it is asked

    @property
    def begun(self) -> bool:
        """Whether the two sides have answered each other in time since `begin`, as far as this one knows."""
        return self.phase is LeasePhase.BEGUN

    @property
    def now(self) -> float:
        """Seconds on the clock of the lease."""
        return self._steady()

    @property
    def alive(self) -> bool:
        """Whether the other side has heard a number that this side has sent within the last second."""
        now = self._end_at_standstill()
        return self.phase in _MOVES and now - self._confirmed <= LASTS

    @property
    def lasts_for(self) -> float:
        """Seconds for which it stays alive if nothing more is heard, or 0 if it is not alive."""
        return max(0.0, self._confirmed + LASTS - self._steady()) if self.alive else 0.0

    @property
    def slow(self) -> bool:
        """Whether the last answer took too long for messages to arrive in time."""
        return not self.alive or self.round_trip > SLOW

    def passes(self, number: int) -> bool:
        sent = self._sent.get(number)
        return sent is not None and self.alive and self._steady() - sent <= LASTS

    @property
    def left(self) -> float:
        """Seconds in which the other side may still publish what this side has sent."""
        return max(0.0, self._heard[-1][1] + LASTS - self._steady()) if self._heard else 0.0

    def newest_before(self, time: float) -> int:
        """Return the newest number of the other side that was heard before a time (s), or 0. From any thread."""
        return next((number for number, heard_at in reversed(self._heard) if heard_at <= time), 0)

    def _end_at_standstill(self) -> float:
        """End it if nothing has moved for too long, and return the time."""
        phase, now = self.phase, self._steady()
        if phase not in _MOVES:
            return now
        # This side comes first: while it stands still, it hears nothing of the other one either.
        if now - self._beaten > LASTS:
            self.over = Standstill.LOOP
        elif now - self._turns.at > LASTS:
            self.over = Standstill.ROS_THREAD
        elif (phase is not LeasePhase.SENDS and now - self._confirmed > GIVEN_UP_AFTER) or (
            phase in _BEGINS and now - self._began > _FIRST_WITHIN
        ):
            self.over = Standstill.PEER
        else:
            return now
        self.phase = LeasePhase.OVER
        self._ended()
        return now


class Marker:
    """Marks what one endpoint takes from ROS. It is made right before the endpoint, and belongs to the taking thread.

    Args:
        batch: most messages taken at once; after that many there may be more, which the next turn takes.
    """

    def __init__(self, lease: LeaseHalf, turns: RosTurns, batch: int) -> None:
        self._lease = lease
        self._turns = turns
        self._batch = batch
        self._is_empty = True
        self._turn = turns.count
        self._made = self._since = lease.now

    def marked(self, taken: Sequence[M]) -> Sequence[M]:
        """Return messages with the number of the lease that bounds their age."""
        turn, before = self._turns.count, self._turn
        if self._is_empty or turn > before + 1:  # a turn in between has found the queue empty
            self._since = max(self._made, self._turns.since)  # nothing is older than its endpoint
        self._turn, self._is_empty = turn, len(taken) < self._batch
        number = self._lease.newest_before(self._since)
        return [each._replace(lease=number) for each in taken]

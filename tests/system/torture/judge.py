"""Judges the messages that reached the robot, by records from outside the bridge."""

from __future__ import annotations

import time
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from tests.system.torture.ends import WITNESS, Arrival

OLDEST = 1.0
"""s: nothing older may reach a robot on a topic that has to be armed."""

CLOCK_TOLERANCE = 0.02
"""s by which figures may be off, in addition to the witness's delay: DDS stamps by another clock, and a bridge has
to get from its last look at the clock to the call that publishes."""

_AROUND = 0.25
_DESCRIBED = 3


@dataclass
class Window:
    """A time in which an operator meant messages to cross.

    Attributes:
        asked: the moment before the operator armed the topic.
        shown: the moment when either side first said that it is disarmed, or None while it is armed.
        by: what said so first.
        agreed: whether the operator got the answer that it is armed. Before that, a console may show an earlier arming.
    """

    asked: float
    shown: float | None = None
    by: str = ""
    agreed: bool = False

    def show(self, by: str) -> None:
        """Note the time of the first report that the topic is disarmed."""
        if self.shown is None:
            self.by, self.shown = by, time.monotonic()


@dataclass
class Findings:
    """The figures of a case.

    Attributes:
        crossed: messages that reached the robot.
        old: of these, how many were too old.
        oldest: the age of the oldest one (s).
        after: how many arrived after a side had said that the topic is disarmed.
        unarmed: how many were published while nobody had armed the topic.
        wrong: how many were any of this.
        in_hand: of these, how many the bridge had looked at for the last time, or given to DDS, in time, as far as its
            clock is true. A process that is frozen just then publishes the message later, and no program can help that.
        tolerance: s that the harness itself may be off.
        notes: what else there is to say.
    """

    crossed: int = 0
    old: int = 0
    oldest: float = 0.0
    after: int = 0
    unarmed: int = 0
    wrong: int = 0
    in_hand: int = 0
    tolerance: float = CLOCK_TOLERANCE
    notes: list[str] = field(default_factory=list)


class _Wrong(NamedTuple):
    """Whether a message should not have been published at a moment, and why."""

    old: bool
    after: bool
    unarmed: bool


class Witness:
    """The harness's own lateness: the age of messages that no bridge carries, around the same moment."""

    def __init__(self, arrivals: Iterable[Arrival]) -> None:
        self._ages = sorted((each.arrived, each.arrived - each.published) for each in arrivals if each.topic == WITNESS)
        self._moments = [arrived for arrived, _ in self._ages]

    def tolerance(self, moment: float) -> float:
        """Return how much (s) a figure of that moment may be off."""
        begin, end = bisect_left(self._moments, moment - _AROUND), bisect_right(self._moments, moment + _AROUND)
        return CLOCK_TOLERANCE + max((age for _, age in self._ages[begin:end]), default=0.0)

    @property
    def worst(self) -> float:
        """The largest such figure."""
        return CLOCK_TOLERANCE + max((age for _, age in self._ages), default=0.0)


def judge(
    arrivals: Sequence[Arrival],
    windows: Sequence[Window],
    *,
    frozen: Sequence[tuple[float, float]] = (),
    true_clock: bool = True,
) -> Findings:
    """Count what reached the robot and should not have.

    Args:
        arrivals: of one topic, and of the witness.
        frozen: from when to when the robot's bridge stood still.
        true_clock: whether the robot's bridge has this machine's wall clock.
    """
    witness = Witness(arrivals)
    found = Findings(tolerance=witness.worst)
    for each in arrivals:
        if each.topic == WITNESS:
            continue
        tolerance = witness.tolerance(each.arrived)
        wrong = _wrong(each.published, each.arrived, windows, tolerance)
        found.crossed += 1
        found.oldest = max(found.oldest, each.arrived - each.published)
        found.old += wrong.old
        found.after += wrong.after
        found.unarmed += wrong.unarmed
        if any(wrong):
            if found.wrong < _DESCRIBED:
                found.notes.append(_describe(each, wrong, windows))
            found.wrong += 1
            looked = _looked_at(each, frozen, tolerance)
            found.in_hand += true_clock and not any(_wrong(each.published, looked, windows, tolerance))
    return found


def _looked_at(arrival: Arrival, frozen: Iterable[tuple[float, float]], tolerance: float) -> float:
    """Return when the bridge may have looked at a message for the last time: as it gave it, or before it froze."""
    bridged = arrival.bridged
    for begin, end in frozen:
        if arrival.published <= begin and end <= bridged <= end + tolerance:
            return bridged - (end - begin)
    return bridged


def _describe(arrival: Arrival, wrong: _Wrong, windows: Sequence[Window]) -> str:
    """Say when a message was published, by its age and from the nearest moments at which people did something."""
    names = "+".join(name for name, value in wrong._asdict().items() if value)
    asked = [("asked", each.asked) for each in windows if each.asked]
    shown = [(f"shown by {each.by}", each.shown) for each in windows if each.shown is not None]
    past = sorted((each for each in asked + shown if each[1] <= arrival.arrived), key=lambda each: each[1])
    since = ", ".join(f"{name} {arrival.arrived - moment:.2f} s before" for name, moment in past[-3:])
    ages = (
        f"{arrival.arrived - arrival.published:.2f} s old, given to DDS at {arrival.bridged - arrival.published:.2f} s"
    )
    return f"[{names}: number {arrival.number}, {ages}; {since}]"


def _wrong(published: float, moment: float, windows: Sequence[Window], tolerance: float) -> _Wrong:
    """Judge a message that was published by a bridge, or reached the robot, at that moment."""
    window = next((each for each in reversed(windows) if each.asked <= published), None)
    shown = window.shown if window is not None and window.shown is not None else float("inf")
    unarmed = window is None or published > shown + tolerance
    return _Wrong(moment - published > OLDEST + tolerance, not unarmed and moment > shown + tolerance, unarmed)

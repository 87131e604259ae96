"""Judges what reached the robot, from what was noted outside of the bridge."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tests.system.torture.ends import WITNESS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from tests.system.torture.ends import Arrival

OLDEST = 1.0
"""s: nothing older may reach a robot on a topic that has to be armed."""

CLOCK_TOLERANCE = 0.02
"""s that the harness's figures may be off, beside what the witness shows: DDS stamps by another clock, and a bridge has
to get from its last look at the clock to the call that publishes."""

_AROUND = 0.25


@dataclass
class Window:
    """A time in which an operator meant messages to cross.

    Attributes:
        asked: the moment before the operator armed the topic.
        shown: the moment when either side first said that it is disarmed, or None while it is armed.
    """

    asked: float
    shown: float | None = None


@dataclass
class Findings:
    """The figures of a case.

    Attributes:
        crossed: messages that reached the robot.
        old: of these, how many were too old.
        old_in_dds: of these, how many the bridge had given to DDS in time; with a true clock on the robot.
        oldest: the age of the oldest one (s).
        after: how many arrived after a side had said that the topic is disarmed.
        unarmed: how many were published while nobody had armed the topic.
        tolerance: s that the harness itself may be off.
    """

    crossed: int = 0
    old: int = 0
    old_in_dds: int = 0
    oldest: float = 0.0
    after: int = 0
    unarmed: int = 0
    tolerance: float = CLOCK_TOLERANCE
    notes: list[str] = field(default_factory=list)

    @property
    def wrong(self) -> int:
        """How many messages should not have reached the robot."""
        return self.old + self.after + self.unarmed


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


def judge(arrivals: Sequence[Arrival], windows: Sequence[Window], oldest: float = OLDEST) -> Findings:
    """Count what reached the robot and should not have.

    Args:
        arrivals: of one topic, and of the witness.
        windows: in order.
        oldest: s that a message may have at its arrival.
    """
    witness = Witness(arrivals)
    found = Findings(tolerance=witness.worst)
    for each in arrivals:
        if each.topic == WITNESS:
            continue
        age, tolerance = each.arrived - each.published, witness.tolerance(each.arrived)
        found.crossed += 1
        found.oldest = max(found.oldest, age)
        if age > oldest + tolerance:
            found.old += 1
            found.old_in_dds += each.bridged - each.published <= oldest + tolerance
        window = next((window for window in reversed(windows) if window.asked <= each.published), None)
        if window is None or (window.shown is not None and each.published > window.shown + tolerance):
            found.unarmed += 1
        elif window.shown is not None and each.arrived > window.shown + tolerance:
            found.after += 1
    return found

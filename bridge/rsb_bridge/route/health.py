"""Whether a sending half's messages are slow, stopped or lost."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.telemetry.watches import LATELY, LossWatch, SlowWatch, StopWatch

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import Ledger


class Flow(NamedTuple):
    """The figures of a route's messages that `Health` watches.

    Attributes:
        flowing: whether messages could cross now.
        awaited: whether messages are missing if none come.
        last: time (s) of the last message, or when the first one was missing.
        given_rate: Hz that an operator expects, or 0 for none.
        usual_rate: Hz, learned, or None if unknown.
        limit: Hz that may cross, or 0 for any.
        publishers: ids of the topic's publishers.
    """

    flowing: bool
    awaited: bool
    last: float
    rate: float
    given_rate: float
    usual_rate: float | None
    limit: float
    publishers: frozenset[bytes]
    ledger: Ledger


class Health:
    """Watches once a second whether a sending half's messages are slow, stopped or lost.

    Attributes:
        expected_rate: Hz that the route is judged by, or None if it is unknown or messages come at random.
        losses: between the two sides.
    """

    def __init__(self) -> None:
        self.expected_rate: float | None = None
        self.slow = SlowWatch()
        self.stop = StopWatch()
        self.losses = LossWatch()
        self._lost_in_dds: deque[int] = deque(maxlen=LATELY)

    def judge(self, flow: Flow, now: float) -> None:
        """Judge the flow at `now` (s). Called once a second."""
        ledger = flow.ledger
        self._lost_in_dds.append(ledger.lost_in_dds)
        self.losses.judge(ledger.delivered, ledger.dropped, now)
        expected = flow.given_rate or flow.usual_rate
        if expected and flow.limit:
            expected = min(expected, flow.limit)
        self.expected_rate = expected
        if expected is None or not flow.awaited:
            self.stop.reset()
            self.slow.reset()
            return
        self.stop.judge(flow.last, expected, now, flow.publishers, promised=bool(flow.given_rate))
        if self.stop.since is not None or not flow.flowing:
            self.slow.reset()
        elif not self.stop.quiet:  # a pause is not slow
            self.slow.judge(flow.rate, expected, now)

    def lost_in_dds(self) -> int:
        """Return the messages that DDS lost in the last `LATELY` s before they could be taken."""
        return max(0, self._lost_in_dds[-1] - self._lost_in_dds[0]) if self._lost_in_dds else 0

"""How well a sending half's messages flow, watched once a second."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.route.verdict import LATELY
from rsb_bridge.telemetry.watches import LossWatch, SlowWatch, StopWatch

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import Ledger
    from rsb_bridge.route.verdict import Facts


class Flow(NamedTuple):
    """A route's messages, as far as they are watched.

    Attributes:
        flowing: messages could cross now.
        last: s, when the last one was sent, or since when they could cross.
        rate: Hz.
        given_rate: Hz, that an operator expects; 0: none.
        usual_rate: Hz, learned; None: not known.
        limit: Hz that an operator allows; 0: all.
        publishers: which there are.
        ledger: where the messages went.
    """

    flowing: bool
    last: float
    rate: float
    given_rate: float
    usual_rate: float | None
    limit: float
    publishers: frozenset[bytes]
    ledger: Ledger


class Health:
    """What the watches say.

    Attributes:
        expected_rate: Hz, that the route is judged by; None: it is not known, or messages come at random.
    """

    def __init__(self) -> None:
        self.expected_rate: float | None = None
        self._slow = SlowWatch()
        self._stop = StopWatch()
        self._loss = LossWatch()
        self._lost_in_dds: deque[int] = deque(maxlen=LATELY)

    def tick(self, flow: Flow, now: float) -> None:
        """Once a second, at `now` (s)."""
        ledger = flow.ledger
        self._lost_in_dds.append(ledger.lost_in_dds)
        self._loss.tick(ledger.delivered, ledger.dropped, now)
        expected = flow.given_rate or flow.usual_rate
        if expected and flow.limit:
            expected = min(expected, flow.limit)
        self.expected_rate = expected
        if expected is None or not flow.flowing:
            self._stop.reset()
            self._slow.reset()
            return
        self._stop.tick(flow.last, expected, now, flow.publishers, promised=bool(flow.given_rate))
        if self._stop.since is not None:
            self._slow.reset()
        elif not self._stop.quiet:  # a pause is not slow
            self._slow.tick(flow.rate, expected, now)

    def added_to(self, facts: Facts) -> Facts:
        """The facts of a route with what the watches say."""
        lost = self._lost_in_dds
        return facts._replace(
            expected_rate=self.expected_rate,
            stopped_since=self._stop.since,
            slow_since=self._slow.since,
            loss=self._loss.loss,
            lost_in_dds=max(0, lost[-1] - lost[0]) if lost else 0,
        )

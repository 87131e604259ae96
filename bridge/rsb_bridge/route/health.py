"""Whether a sending half's messages are slow, stopped or lost."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.telemetry.watches import LATELY, LossWatch, SlowWatch, StopWatch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.model.snapshot import Ledger
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.route import Route


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
        self._publishers: Sequence[Endpoint] = ()
        self._gids: frozenset[bytes] = frozenset()  # of these

    def judge(
        self,
        route: Route,
        ledger: Ledger,
        now: float,
        publishers: Sequence[Endpoint],
        *,
        usual_rate: float | None,
        quiet_since: float,
        flows: bool,
        awaited: bool,
    ) -> None:
        """Judge a topic at `now` (s). Called once a second.

        Args:
            publishers: of the topic here.
            usual_rate: Hz, learned, or None if unknown.
            quiet_since: time (s) of the last message, or when the first one was missing.
            flows: whether messages could cross now.
            awaited: whether messages are missing if none come.
        """
        self._lost_in_dds.append(ledger.lost_in_dds)
        self.losses.judge(ledger.delivered, ledger.dropped, now)
        promised, limit = bool(route.spec.expected_rate), route.limit.rate
        expected = route.spec.expected_rate or usual_rate
        if expected and limit:
            expected = min(expected, limit)
        self.expected_rate = expected
        if expected is None or not awaited:
            self.stop.reset()
            self.slow.reset()
            return
        if publishers is not self._publishers:  # they are replaced, never changed
            self._publishers, self._gids = publishers, frozenset([each.gid for each in publishers])
        self.stop.judge(quiet_since, expected, now, self._gids, promised=promised)
        if self.stop.since is not None or not flows:
            self.slow.reset()
        elif not self.stop.quiet:  # a pause is not slow
            self.slow.judge(route.meter.rate, expected, now)

    @property
    def finds_nothing(self) -> bool:
        """Whether messages are neither lost nor slow nor missing."""
        return self.losses.loss is None and self.slow.since is None and self.stop.since is None

    @property
    def is_calm(self) -> bool:
        """Whether none was lost in the last seconds."""
        return self.losses.is_calm and not self.lost_in_dds()

    def next_change(self, now: float) -> float:
        """Return when (s) one of these may change without a message, `now` if at any moment, or infinity."""
        return now if self.losses.loss is not None or self.slow.since is not None else self.stop.next_change

    def lost_in_dds(self) -> int:
        """Return the messages that DDS lost in the last `LATELY` s before they could be taken."""
        return max(0, self._lost_in_dds[-1] - self._lost_in_dds[0]) if self._lost_in_dds else 0

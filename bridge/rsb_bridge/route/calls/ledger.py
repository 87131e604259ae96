"""What became of a route's calls, as one side counts them: asked = answered + expired + refused + lost + in flight."""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING

from rsb_bridge.model.calls import CallsSnapshot
from rsb_bridge.telemetry.meters import LatencyMeter
from rsb_bridge.wire.records import CallsReport, VerdictRecord

if TYPE_CHECKING:
    from rsb_bridge.route.calls.refusals import Refused

LATELY = 10
"""s: what verdicts look back on."""


class CallsLedger:
    """One half's, since the route was made.

    Attributes:
        asked: calls that came.
        answered: whose answers went back.
        expired: given up after their timeout.
        refused: by why.
        lost: given up because the link or the provider went.
        late: answers whose call had been given up; no part of `asked`.
        node: s that the providing node took.
        way: s that the way there and back took.
        last_failure: the last call without an answer, in words; empty: there was none.
        unanswered: a call has expired, and none was answered in that second or since.
    """

    def __init__(self) -> None:
        self.asked = 0
        self.answered = 0
        self.expired = 0
        self.refused: Counter[Refused] = Counter()
        self.lost = 0
        self.late = 0
        self.node = LatencyMeter()
        self.way = LatencyMeter()
        self.last_failure = ""
        self.unanswered = False
        self._before = 0, 0  # answered and expired, a second ago
        self._lately: deque[tuple[int, Counter[Refused]]] = deque(maxlen=LATELY + 1)

    @property
    def in_flight(self) -> int:
        """Calls under way."""
        return self.asked - self.answered - self.expired - self.refused.total() - self.lost

    def tick(self) -> None:
        """Once a second."""
        self.node.tick()
        self.way.tick()
        answered, expired = self._before
        if self.answered > answered:
            self.unanswered = False
        elif self.expired > expired:
            self.unanswered = True
        self._before = self.answered, self.expired
        self._lately.append((self.expired, self.refused.copy()))

    def expired_lately(self) -> int:
        """Calls that expired in the last `LATELY` s."""
        return self.expired - self._lately[0][0] if self._lately else 0

    def refused_lately(self) -> Counter[Refused]:
        """Calls refused in the last `LATELY` s, by why."""
        return self.refused - self._lately[0][1] if self._lately else Counter()

    def forget_lately(self) -> None:
        """What has been is over: the route was paused, or opened anew, or its server has gone."""
        self.unanswered = False
        self._before = self.answered, self.expired
        self._lately.clear()

    def timed(self, took: float, total: float) -> None:
        """An answer came after `total` s, of which the node took `took` as the peer says: it cannot be more."""
        took = min(took, total)
        self.node.add(took)
        self.way.add(total - took)

    def snapshot(self) -> CallsSnapshot:
        """As user interfaces show it."""
        return CallsSnapshot(
            asked=self.asked,
            answered=self.answered,
            expired=self.expired,
            refused={str(why): count for why, count in self.refused.items()},
            lost=self.lost,
            in_flight=self.in_flight,
            late=self.late,
            node_p50=self.node.p50,
            node_p99=self.node.p99,
            way_p50=self.way.p50,
            way_p99=self.way.p99,
            last_failure=self.last_failure,
        )

    def report(self, route_id: int, verdict: VerdictRecord | None, nodes: tuple[str, ...]) -> CallsReport:
        """As the other side is told."""
        return CallsReport(
            route=route_id,
            asked=self.asked,
            answered=self.answered,
            expired=self.expired,
            refused={str(why): count for why, count in self.refused.items()},
            lost=self.lost,
            in_flight=self.in_flight,
            verdict=verdict,
            nodes=nodes,
        )

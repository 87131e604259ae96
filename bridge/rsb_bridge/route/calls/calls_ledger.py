"""One side's counts of a route's calls, and why calls had no answer."""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING

from rsb_bridge.model.calls import CallsSnapshot, Refused
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.telemetry.meters import LatencyMeter
from rsb_bridge.wire.framing import CALL_LIMIT

if TYPE_CHECKING:
    from rsb_bridge.route.route import Route

LATELY = 10
"""s that verdicts look back, as `telemetry.watches.LATELY`."""
_TIMED = 512
"""Calls that are timed at most in a second: the newest. A round figure, which bounds memory."""
_REPEATED_AFTER = 60.0
"""s until the log repeats a failure of the same route, as `combined_verdict._AGAIN_AFTER`."""
_MOST_LOGGED = 32
"""Texts that are remembered: nodes' names in them make ever new ones. A round figure."""

REMEDIES = {
    Refused.CALLS_UNDER_WAY: "too many calls wait for answers on this link: make fewer at once, or shorten the timeout",
    Refused.BYTES_UNDER_WAY: "the calls that wait for answers on this link hold too many bytes: make fewer at once",
    Refused.TOO_FAST: "more calls a second are made than are allowed: call less often, or raise max_rate",
    Refused.PAUSED: "it is paused: resume it",
    Refused.DISARMED: "it was not armed when the request was made: ask again once it is armed",
    Refused.UNHEARD: "it is armed, but the two sides do not hear each other: ask again, or check the link",
    Refused.PROVIDER_GONE: "nobody serves it any more: start its node",
    Refused.TOO_LARGE: f"the request or the response is longer than {CALL_LIMIT >> 20} MiB: use a topic for it",
    Refused.MALFORMED: "the request or the response is malformed: the log names the field",
    Refused.TOO_COMPLEX: "the link's calls have more strings and sequences than are checked: send less",
    Refused.NOT_SENT: "the middleware refused the request; the log of the providing side says why",
    Refused.TOO_OLD: "the request was older than max_age: find what delays it, and ask again",
    Refused.LOST: "its server was lost before it answered, and may have acted on the call",
    Refused.OTHER: "the other side gives a reason that this version does not know: update this side",
}
"""Texts for operators."""


def refused_as(content: bytes) -> Refused:
    """Return the cause that a peer's refusal names."""
    try:
        return Refused(content.decode())
    except ValueError:  # a UnicodeDecodeError is one, too
        return Refused.OTHER


class CallsLedger:
    """Counts of one half, since the route was made: asked = answered + expired + refused + lost + in flight.

    Attributes:
        answered: calls with an answer that went back.
        expired: calls given up after their timeout.
        waited: calls of these that the node never got, because it had not read earlier ones.
        refused: refused calls, by cause.
        lost: calls given up because the link or the provider was lost.
        late: answers to calls that had been given up; not part of `asked`.
        node: s that the providing node took.
        way: s that the two bridges and the link took.
        last_failure: the reason why the last call without an answer had none, or an empty string.
        unanswered: whether a call has expired, and none was answered in that second or since.
    """

    def __init__(self) -> None:
        self.asked = 0
        self.answered = 0
        self.expired = self.waited = 0
        self.refused: Counter[Refused] = Counter()
        self.lost = 0
        self.late = 0
        self.node = LatencyMeter()
        self.way = LatencyMeter()
        self.last_failure = ""
        self.unanswered = False
        self._timed: deque[tuple[float, float | None]] = deque(maxlen=_TIMED)  # calls since the last tick
        self._before = 0, 0  # answered and expired, a second ago
        # One more than `LATELY`, so that the first one is that old.
        self._lately: deque[tuple[int, int, Counter[Refused]]] = deque(maxlen=LATELY + 1)

    @property
    def in_flight(self) -> int:
        """Calls that wait for their answers."""
        return self.asked - self.answered - self.expired - self.refused.total() - self.lost

    def tick(self) -> None:
        """Update what is measured over time; called once a second."""
        for took, total in self._timed:
            if total is None:
                self.node.add(took)
            else:
                # `took` is the peer's word.
                self.node.add(min(took, total))
                self.way.add(max(0.0, total - took))
        self._timed.clear()
        answered, expired = self._before
        if self.answered > answered:
            self.unanswered = False
        elif self.expired > expired:
            self.unanswered = True
        self._before = self.answered, self.expired
        self._lately.append((self.expired, self.waited, self.refused.copy()))

    def expired_lately(self) -> int:
        """Return the number of calls that expired in the last `LATELY` s."""
        return self.expired - self._lately[0][0] if self._lately else 0

    def waited_lately(self) -> bool:
        """Whether a call expired in the last `LATELY` s without having reached the node."""
        return bool(self._lately) and self.waited > self._lately[0][1]

    def refused_lately(self) -> Counter[Refused]:
        """Return the calls refused in the last `LATELY` s, by cause."""
        return self.refused - self._lately[0][2] if self._lately else Counter()

    def forget_lately(self) -> None:
        """Begin a new period: the route was paused or reopened, or its server has gone."""
        self.unanswered = False
        self._before = self.answered, self.expired
        self._lately.clear()

    def timed(self, took: float, total: float | None = None) -> None:
        """Measure an answer at the next tick.

        Args:
            took: s that the node took, on the callers' side as the peer says.
            total: s after which the answer came to the callers' side, or None on the other side.
        """
        # The meters get all of a second at once, so that a call costs fewer functions.
        self._timed.append((took, total))

    def snapshot(self, waiting: int = 0) -> CallsSnapshot:
        """Return the counts for user interfaces.

        Args:
            waiting: calls that wait until their node has read earlier ones.
        """
        node, way = self.node.percentiles(), self.way.percentiles()
        return CallsSnapshot(
            asked=self.asked,
            answered=self.answered,
            expired=self.expired,
            refused={str(why): count for why, count in self.refused.items()},
            lost=self.lost,
            in_flight=self.in_flight,
            waiting=waiting,
            late=self.late,
            node_p50=node[0],
            node_p99=node[1],
            way_p50=way[0],
            way_p99=way[1],
            last_failure=self.last_failure,
        )


class CallFailures:
    """Counts the calls of one half that have no answer, and tells operators why.

    Attributes:
        since: when (s) calls began to fail, or None if none has failed lately.
    """

    def __init__(self, route: Route, calls: CallsLedger) -> None:
        self.since: float | None = None
        self._route = route
        self._calls = calls
        self._logged_at: dict[str, float] = {}

    def refused(self, why: Refused) -> str:
        """Count a call that either side refuses, log it once, and return the reason in words."""
        if why is Refused.LOST:
            self._calls.lost += 1
            self.say(REMEDIES[why])
        else:
            self._calls.refused[why] += 1
            self.say(f"a call was refused: {REMEDIES[why]}")
        return self._calls.last_failure

    def lost(self, calls: int, why: str) -> None:
        """Count calls that lost the link or their server. The log reports that loss elsewhere."""
        if calls:
            self._calls.lost += calls
            self._calls.last_failure = f"given up before its answer came: {why}"

    def say(self, text: str, code: EventCode = EventCode.ROUTE_CALL_FAILED) -> None:
        """Note why a call had no answer. The log repeats the same text once a minute at most."""
        self._calls.last_failure = text
        self._route.notices.record(text)
        now = self._route.context.now()
        if now - self._logged_at.get(text, float("-inf")) < _REPEATED_AFTER:
            return
        if len(self._logged_at) >= _MOST_LOGGED:
            self._logged_at.clear()
        self._logged_at[text] = now
        self._route.log(Level.WARNING, code, text)

    def tick(self) -> None:
        """Note whether calls fail; called once a second."""
        if not (self._calls.unanswered or self._calls.expired_lately() or self._calls.refused_lately()):
            self.since = None
        elif self.since is None:
            self.since = self._route.context.now()

    def forget(self) -> None:
        """Begin a new period, because calls may cross from now on, or no longer."""
        self._calls.forget_lately()
        self.since = None

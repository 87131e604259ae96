"""The calls of one half of a route: counts, how far the other side says that they are, and what follows their goals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeVar

from rsb_bridge.channel.scheduler import SendingChannel
from rsb_bridge.model.by_hand import END_NONE, more_careful_end
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.session import CALL_TIMEOUT
from rsb_bridge.route.calls.calls_ledger import CallFailures, CallsLedger
from rsb_bridge.route.calls.pending_calls import PendingCall
from rsb_bridge.route.half import Carried

if TYPE_CHECKING:
    from rsb_bridge.route.calls.goals import Goals
    from rsb_bridge.route.calls.pending_calls import PendingCalls
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.records import CallsReport

C = TypeVar("C", bound=PendingCall)


class CallsFlow:
    """The facts that all parts of one half of a route of calls share.

    Attributes:
        members: the services and topics that the route consists of.
        calls: counts of its calls on this side.
        failures: counts those without an answer, and tells operators why.
        came: whether a call came in the present opening.
        report: the other side's last one in the present opening, or None.
    """

    def __init__(self, route: Route) -> None:
        self.route = route
        self.carried = Carried[SendingChannel]()
        self.members = LANES[route.spec.kind]
        self.calls = CallsLedger()
        self.failures = CallFailures(route, self.calls)
        self.came = False
        self.report: CallsReport | None = None

    @property
    def call_timeout(self) -> float:
        """Seconds after which a call expires, unless its lane has no timeout."""
        return self.route.proposal.timeout or CALL_TIMEOUT

    def timeout_of(self, lane: int) -> float | None:
        """Return the seconds after which a lane's call expires, or None if it never does."""
        # Not by `call_timeout`, which would be one more function for each call.
        return None if self.members[lane].patient else self.route.proposal.timeout or CALL_TIMEOUT

    def open(self) -> None:
        """Begin a new opening."""
        self.report = None
        self.came = False

    def asked(self, size: int) -> None:
        """Count a call with a request of `size` bytes."""
        if self.route.idle:
            self.route.wake()
        self.calls.asked += 1
        self.came = True
        self.route.meter.add(1, size, self.route.context.now())

    def answered(self, size: int) -> None:
        """Count an answer of `size` bytes."""
        self.calls.answered += 1
        self.route.meter.add(0, size, self.route.context.now())
        self.route.notices.flowing()


class CallsKind(Generic[C]):
    """Follows an action's goals; nothing to follow is there for services and parameters.

    Attributes:
        goals: of an action, all that are known, or None.
    """

    goals: Goals | None = None

    def __init__(self, flow: CallsFlow, pending: PendingCalls[C]) -> None:
        self._flow, self._route, self._pending = flow, flow.route, pending

    @property
    def on_end(self) -> str:
        """The effect of an arming's end on goals, or an empty string for calls that are no goals."""
        if self.goals is None:
            return ""
        arming = self._route.arming
        return more_careful_end((arming.own.on_end, arming.peer_on_end, END_NONE))

    def server_gone(self) -> None:
        """Note that there is no server any more."""
        if self.goals is not None:
            self.goals.server_gone()

    def act(self, now: float) -> None:
        """Do what is due at `now` (s), once a second: a request for the result of an ended goal gets a timeout."""
        if self.goals is None:
            return
        for number, call in self._pending.items():
            if call.goal and self.goals.is_over(call.goal):
                self._pending.limit(number, self._flow.call_timeout)

    def awaited(self) -> set[bytes]:
        """Return the goals whose results are asked for and not there yet."""
        return {call.goal for _, call in self._pending.items() if call.goal}

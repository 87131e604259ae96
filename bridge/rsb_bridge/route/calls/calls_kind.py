"""What calls do by their kind besides passing on, in either half of their route: the part that the halves share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeVar

from rsb_bridge.model.by_hand import END_NONE, more_careful_end
from rsb_bridge.route.calls.pending_calls import PendingCall

if TYPE_CHECKING:
    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.calls.goals import Goals
    from rsb_bridge.route.calls.pending_calls import PendingCalls

C = TypeVar("C", bound=PendingCall)


class CallsKind(Generic[C]):
    """Follows an action's goals; nothing to follow is there for services and parameters.

    Attributes:
        goals: of an action, all that are known, or None.
    """

    goals: Goals | None = None

    def __init__(self, flow: CallsFlow, pending: PendingCalls[C]) -> None:
        self._flow, self._route, self._pending = flow, flow.route, pending

    @property
    def never_idle(self) -> bool:
        """Whether it has times of its own, as goals do. A robot has few actions."""
        return self.goals is not None

    @property
    def on_end(self) -> str:
        """What happens to goals once an arming ends, or an empty string for calls that are no goals."""
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

"""Cancels the goals of a link's callers once their arming ends (``on_end: cancel``), on the side of their server."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.calls import CANCEL_GOAL
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.goals import cancel_request, refuses_cancel

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from rsb_bridge.ros.ros_interface import Response, ServiceClient

_ANSWERED_WITHIN = 5.0
"""s. A round figure: an operator has to hear soon that a robot may go on."""


class GoalCancels:
    """The cancels of one providing half.

    Args:
        clients: gives the clients of the action's services, by lane.
        failed: is called with the reason if a goal cannot be cancelled.
        now: s.
    """

    def __init__(
        self,
        clients: Callable[[], Mapping[int, ServiceClient]],
        failed: Callable[[str], None],
        now: Callable[[], float],
    ) -> None:
        self._clients = clients
        self._failed = failed
        self._now = now
        # The goal and the time of each call, by client, too, because another one numbers from the start.
        self._unanswered: dict[tuple[ServiceClient, int], tuple[bytes, float]] = {}

    def cancel(self, goals: Iterable[bytes]) -> None:
        """Ask the server to cancel goals."""
        client = self._clients().get(CANCEL_GOAL)
        for goal in goals:
            try:
                if client is None:
                    raise RosError("its server has gone")
                self._unanswered[client, client.call(cancel_request(goal))] = goal, self._now()
            except RosError as error:
                self._may_go_on(goal, str(error))

    def takes(self, lane: int, response: Response) -> bool:
        """Whether a response is the answer to one of these cancels, and of no call of the other side's."""
        client = self._clients().get(CANCEL_GOAL)
        if lane != CANCEL_GOAL or client is None or (client, response.number) not in self._unanswered:
            return False
        goal, _ = self._unanswered.pop((client, response.number))
        if refuses_cancel(response.payload):
            self._may_go_on(goal, "its server refuses that")
        return True

    def tick(self) -> None:
        """Report cancels that their server does not answer; called once a second."""
        latest = self._now() - _ANSWERED_WITHIN
        for call, (goal, asked_at) in tuple(self._unanswered.items()):
            if asked_at < latest:
                del self._unanswered[call]
                self._may_go_on(goal, f"its server has not answered for {_ANSWERED_WITHIN:g} s")

    def _may_go_on(self, goal: bytes, why: str) -> None:
        self._failed(f"the robot may go on: goal {goal.hex()} is not cancelled: {why}")

"""Cancels the goals of a link's callers once their arming ends (``on_end: cancel``), on the side of their server."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.calls import CANCEL_GOAL
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.goals import cancel_request

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from rsb_bridge.ros.ros_interface import ServiceClient


class GoalCancels:
    """The cancels of one providing half.

    Args:
        clients: gives the clients of the action's services, by lane.
        failed: is called with the reason if a goal cannot be cancelled.
    """

    def __init__(self, clients: Callable[[], Mapping[int, ServiceClient]], failed: Callable[[str], None]) -> None:
        self._clients = clients
        self._failed = failed
        self._client: ServiceClient | None = None
        self._unanswered: set[int] = set()  # calls of this client: another one numbers from the start

    def cancel(self, goals: Iterable[bytes]) -> None:
        """Ask the server to cancel goals."""
        client = self._clients().get(CANCEL_GOAL)
        if client is not self._client:
            self._client = client
            self._unanswered.clear()
        for goal in goals:
            try:
                if client is None:
                    raise RosError("its server has gone")
                self._unanswered.add(client.call(cancel_request(goal)))
            except RosError as error:
                self._failed(f"the robot may go on: goal {goal.hex()} is not cancelled: {error}")

    def takes(self, lane: int, number: int) -> bool:
        """Whether a response is the answer to one of these cancels, and of no call of the other side's."""
        if lane != CANCEL_GOAL or number not in self._unanswered or self._clients().get(lane) is not self._client:
            return False
        self._unanswered.discard(number)
        return True

"""An action server of any node's, without ROS: goals, feedback, status, results and cancels, as rcl_action has them.

Every goal has a plan. What a goal's messages say of it is its id, so that nothing of another goal's can pass for it.
"""

from __future__ import annotations

import contextvars
import struct
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from tests.simulation.ros import Writer, hash_of
from tests.simulation.services import Server

from rsb_bridge.model.calls import CANCEL_GOAL, FEEDBACK, GET_RESULT, LANES, SEND_GOAL, STATUS
from rsb_bridge.route.calls.goals import STATES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tests.simulation.action_flow import ActionFlow
    from tests.simulation.ros import Domain

    from rsb_bridge.ros.ros_interface import Request

TYPE = "sim_msgs/action/Patrol"
CDR = b"\0\1\0\0"
SERVICES = (SEND_GOAL, CANCEL_GOAL, GET_RESULT)
RESULT_TIMEOUT = 10.0
"""s that a result is kept: rcl_action's default."""
_RUNNING = ("accepted", "executing", "canceling")
_OF_NOBODY = contextvars.Context()


class Plan(NamedTuple):
    """A server's behaviour for one goal.

    Attributes:
        after: s until it answers, or None if it never does.
        state: in which it ends, unless it is cancelled.
    """

    accepts: bool = True
    after: float | None = 0.0
    runs: float = 5.0
    state: str = "succeeded"


def names(action: str) -> list[str]:
    return [lane.name_on(action) for lane in LANES["action"]]


def lane_type(lane: int) -> tuple[str, str]:
    type_name = LANES["action"][lane].type_in(TYPE)
    return type_name, hash_of(type_name)


class ActionServer:
    """A server of an action.

    Attributes:
        said: its last status message, or empty before the first.
        said_at: s, when that was.
    """

    def __init__(self, domain: Domain, action: str, node: str, watcher: ActionFlow) -> None:
        self.closed = False
        self.said, self.said_at = b"", 0.0
        self._domain, self._loop, self._watcher = domain, domain.loop, watcher
        self._states: dict[bytes, str] = {}
        self._waiting: dict[bytes, list[bytes]] = {}  # callers for whom a result is due, by goal
        sinks = {SEND_GOAL: self._send_goal, CANCEL_GOAL: self._cancel, GET_RESULT: self._get_result}
        called = names(action)
        self._servers = {
            lane: Server(domain.services, node, called[lane], *lane_type(lane), sink) for lane, sink in sinks.items()
        }
        self._writers = {
            lane: Writer(domain, node, called[lane], *lane_type(lane), qos)
            for lane in (FEEDBACK, STATUS)
            if (qos := LANES["action"][lane].qos) is not None
        }

    def close(self, *, killed: bool = False) -> None:
        self.closed = True
        ends: list[Server | Writer] = [*self._servers.values(), *self._writers.values()]
        for end in ends:
            end.close(killed=killed)

    @property
    def seen(self) -> bool:
        return any(server.seen for server in self._servers.values())

    def remembers(self, goal: bytes) -> bool:
        return goal in self._states

    def runs(self, goal: bytes) -> bool:
        return not self.closed and self._states.get(goal) in _RUNNING

    # --- requests

    def _send_goal(self, batch: Sequence[Request]) -> None:
        for request in batch:
            goal = request.payload[4:20]
            plan = self._watcher.arrived(self, goal)
            if plan.after is not None:
                self._later(plan.after, partial(self._decide, request, goal, plan))

    def _decide(self, request: Request, goal: bytes, plan: Plan) -> None:
        accepts = plan.accepts and goal not in self._states
        if accepts:
            self._watcher.accepted(self, goal)
            self._change(goal, "accepted")
            self._change(goal, "executing")
            self._later(plan.runs, lambda: self._end(goal, plan.state))
            for part in range(1, 4):
                self._later(plan.runs * part / 4, partial(self._feed, goal, part))
        self._servers[SEND_GOAL].answer(request.caller, CDR + bytes((accepts,)) + bytes(11))

    def _cancel(self, batch: Sequence[Request]) -> None:
        for request in batch:
            goal = request.payload[4:20]
            self._watcher.cancelled(goal)
            if self.runs(goal):
                self._change(goal, "canceling")
                self._later(0.2, partial(self._end, goal, "canceled"))
            self._servers[CANCEL_GOAL].answer(request.caller, CDR + goal)

    def _get_result(self, batch: Sequence[Request]) -> None:
        for request in batch:
            goal = request.payload[4:20]
            if self.runs(goal):
                self._waiting.setdefault(goal, []).append(request.caller)
            else:
                self._tell(request.caller, goal)

    # --- outcomes

    def _feed(self, goal: bytes, part: int) -> None:
        if self.runs(goal):
            self._writers[FEEDBACK].publish(CDR + goal + bytes((part,)))

    def _end(self, goal: bytes, state: str) -> None:
        if not self.runs(goal):
            return
        self._watcher.ended(goal, state)
        self._change(goal, state)
        for caller in self._waiting.pop(goal, ()):
            self._tell(caller, goal)
        self._later(RESULT_TIMEOUT, lambda: self._forget(goal))

    def _forget(self, goal: bytes) -> None:
        self._states.pop(goal, None)
        self._say()

    def _tell(self, caller: bytes, goal: bytes) -> None:
        state = self._states.get(goal, "unknown")
        about = bytes(16) if state == "unknown" else goal
        self._servers[GET_RESULT].answer(caller, CDR + bytes((STATES.index(state),)) + about)

    def _change(self, goal: bytes, state: str) -> None:
        self._states[goal] = state
        self._say()

    def _say(self) -> None:
        told = struct.pack("<I", len(self._states))
        for number, (goal, state) in enumerate(self._states.items()):
            told += struct.pack("<16s3x8xB" if number else "<16s8xB", goal, STATES.index(state))
        self.said, self.said_at = CDR + told, self._loop.time()
        self._writers[STATUS].publish(self.said)

    def _later(self, seconds: float, doing: Callable[[], None]) -> None:
        def do() -> None:
            if not self.closed:
                doing()

        self._loop.call_later(seconds, do, context=_OF_NOBODY)

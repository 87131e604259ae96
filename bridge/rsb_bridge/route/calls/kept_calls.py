"""The calls of an action that outlive an interruption, on the callers' side.

A service's call that is under way when the link drops is given up: nobody knows whether the node has got it, and it
must not get it twice. An action's calls are about a goal that has an id, so they are asked about again by that id once
the action can be reached again: cancels first, then what became of goals that were under way, then results.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import NamedTuple

from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL
from rsb_bridge.route.calls.goal_messages import cancel_of, goal_of

INTERRUPTION = 3600.0
"""s: how long a call outlives an interruption at most, and its answer on the other side."""
MOST_CALLS = 256
MOST_BYTES = 8 << 20
"""Of their requests."""

_FIRST = (CANCEL_GOAL, SEND_GOAL, GET_RESULT)


class KeptCall(NamedTuple):
    """One of them.

    Attributes:
        lane: of an action's, a service.
        caller: for `rsb_bridge.ros.ros_interface.ServiceServer.answer`.
        payload: the serialized request.
        asked: s, when the caller asked.
        again: it has been under way before.
        instance: of the peer's process that it was sent to; empty: it has not been.
        stamp: ns, from which its age counts, or 0 if that is not limited.
    """

    lane: int
    caller: bytes
    payload: bytes
    asked: float
    again: bool
    instance: str = ""
    stamp: int = 0


class KeptCalls:
    """They wait for the end of an interruption.

    Args:
        timeout: s that a call which names no goal waits: a late "cancel all goals" would end goals that came after it.
    """

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self._calls: OrderedDict[bytes, tuple[KeptCall, float]] = OrderedDict()  # by caller; until when
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._calls)

    def keep(self, call: KeptCall, now: float) -> bool:
        """Keep a call; False: it does not outlive an interruption, or there are too many."""
        until = self._until(call, now)
        if until <= now or call.caller in self._calls:
            return False
        if len(self._calls) >= MOST_CALLS or self._bytes + len(call.payload) > MOST_BYTES:
            return False
        self._calls[call.caller] = (call, until)
        self._bytes += len(call.payload)
        return True

    def _until(self, call: KeptCall, now: float) -> float:
        if call.lane == CANCEL_GOAL:
            cancel = cancel_of(call.payload)
            return now + INTERRUPTION if cancel is not None and cancel.goal is not None else call.asked + self.timeout
        if goal_of(call.payload) is None:
            return now
        if call.lane == SEND_GOAL:  # one that has not been under way must not begin late
            return now + INTERRUPTION if call.again else now
        return now + INTERRUPTION if call.lane == GET_RESULT else now

    def requests(self, lane: int) -> list[bytes]:
        """What the calls of a lane ask."""
        return [call.payload for call, _ in self._calls.values() if call.lane == lane]

    def expire(self, now: float) -> list[KeptCall]:
        """Those that have waited too long, which wait no longer."""
        return [self._drop(caller) for caller, (_, until) in list(self._calls.items()) if until <= now]

    def release(self) -> list[KeptCall]:
        """All of them, in the order in which to ask; they wait no longer."""
        calls = [call for call, _ in self._calls.values()]
        self._calls.clear()
        self._bytes = 0
        return sorted(calls, key=lambda call: _FIRST.index(call.lane))

    def _drop(self, caller: bytes) -> KeptCall:
        call, _ = self._calls.pop(caller)
        self._bytes -= len(call.payload)
        return call

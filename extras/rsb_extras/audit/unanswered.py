"""Calls and goals in a recording: which of them have no answer, by service introspection and by an action's status."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

SERVICE_EVENTS = "/_service_event"
GOAL_STATUS = "/_action/status"
CALL_TIME = 10_000_000_000
"""ns before a recording's end in which a call may still be waiting for its answer. A round figure."""
_MOST = 100_000  # open calls of one service, and goals of one action, that are remembered. A round figure: some 20 MB
_REQUESTS, _ANSWERS = {0: "caller", 1: "provider"}, {3: "caller", 2: "provider"}  # service_msgs/msg/ServiceEventInfo
_FINISHED = 4  # action_msgs/msg/GoalStatus: from here on, a goal has its result
_ORDERS = {b"\0\0": ">", b"\0\1": "<"}
"""Byte orders of CDR, by the first two bytes of a message."""


@dataclass
class SeenCalls:
    """Calls of one service, as the caller's and the provider's events tell in one recording.

    Attributes:
        asked: number of calls, by whose events they are: ``caller`` or ``provider``.
        forgotten: calls without an answer that are no longer in `open`, in the same way.
        open: log times of calls without an answer so far, by whose events they are, caller and number.
    """

    asked: dict[str, int] = field(default_factory=lambda: dict.fromkeys(_REQUESTS.values(), 0))
    forgotten: dict[str, int] = field(default_factory=lambda: dict.fromkeys(_REQUESTS.values(), 0))
    open: dict[tuple[str, bytes], int] = field(default_factory=dict)

    def add(self, content: memoryview, time: int) -> None:
        """Take in an event of service introspection; one of another encoding is left out."""
        if len(content) < 44 or bytes(content[:2]) not in _ORDERS:
            return
        # Behind 4 bytes of encapsulation: event_type, 3 of padding, stamp (8), client_gid (16), 4, sequence_number (8).
        kind, call = content[4], bytes(content[16:32]) + bytes(content[36:44])
        if (side := _REQUESTS.get(kind)) is not None:
            self.asked[side] += 1
            self.open[side, call] = time
            if len(self.open) > _MOST:
                (oldest, _) = key = next(iter(self.open))
                del self.open[key]
                self.forgotten[oldest] += 1
        elif (side := _ANSWERS.get(kind)) is not None:
            self.open.pop((side, call), None)

    def unanswered(self, until: int) -> dict[str, int]:
        """Count the calls before a moment that have no answer, by whose events they are."""
        found = dict(self.forgotten)
        for (side, _), time in self.open.items():
            found[side] += time <= until
        return found


@dataclass
class SeenGoals:
    """Goals of one action, as its status tells in one recording: whether each has ended, and since when, by its id."""

    goals: dict[bytes, tuple[bool, int]] = field(default_factory=dict)

    def add(self, content: memoryview, time: int) -> None:
        """Take in a message of type GoalStatusArray; one of another encoding is left out, as is what is cut off."""
        order = _ORDERS.get(bytes(content[:2]))
        if order is None or len(content) < 8:
            return
        (count,) = struct.unpack_from(f"{order}I", content, 4)
        at = 8
        for _ in range(count):
            # An id of 16 bytes, a stamp of 8, aligned to 4, and the status.
            status = at + 16 + (-at % 4) + 8
            if status >= len(content):
                return
            goal, is_finished = bytes(content[at : at + 16]), content[status] >= _FINISHED
            if self.goals.get(goal, (None, 0))[0] != is_finished and (goal in self.goals or len(self.goals) < _MOST):
                self.goals[goal] = is_finished, time
            at = status + 1

    def has_ended(self, goal: bytes) -> bool:
        return self.goals.get(goal, (False, 0))[0]

"""What a user interface sees of the calls of a service, an action or a node's parameters: immutable data."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class CallsSnapshot:
    """The calls of a service, an action or a node's parameters, as this side counts them since the route was made.

    ``asked = answered + expired + refused + lost + in_flight``.

    Attributes:
        asked: calls taken from callers; on the providing side, calls that came over the link.
        answered: with an answer that went back to its caller.
        expired: given up after the timeout.
        refused: not carried, by cause: ``calls under way``, ``bytes under way``, ``calls a second``, ``paused``,
            ``disarmed``, ``provider gone``, ``too large``, ``not sent``, ``not arrived``, ``other``.
        lost: given up because the link or the provider went while they were under way.
        in_flight: under way now.
        late: answers that came after their call was given up. Not a part of `asked`.
        node_p50: s that the far node took for an answer; None: no figure.
        node_p99: s.
        way_p50: s that the way there and back took, both bridges and the link; None: no figure.
        way_p99: s.
        last_failure: the last call that had no answer, and why, in words; or empty.
    """

    asked: int = 0
    answered: int = 0
    expired: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    lost: int = 0
    in_flight: int = 0
    late: int = 0
    node_p50: float | None = None
    node_p99: float | None = None
    way_p50: float | None = None
    way_p99: float | None = None
    last_failure: str = ""


@dataclass(frozen=True, slots=True)
class GoalSnapshot:
    """A goal of an action.

    Attributes:
        id: 32 hexadecimal digits.
        state: as action_msgs/msg/GoalStatus has them, ``accepted``, ``executing``, ``canceling``, ``succeeded``,
            ``canceled`` or ``aborted``; ``asked`` or ``rejected``; ``unknown``: nobody here knows what became of it.
        since: s since the epoch, when it came to that state.
        feedbacks: feedback messages that crossed.
        result_awaited: a caller waits for its result.
    """

    id: str
    state: str
    since: float
    feedbacks: int = 0
    result_awaited: bool = False

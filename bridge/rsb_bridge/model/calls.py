"""What a user interface sees of the calls of a service, an action or a node's parameters: immutable data."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.model.qos import Qos

if TYPE_CHECKING:
    from rsb_bridge.model.session import Kind

MOST_LANES = 16
FEATURE = "calls"
"""What a side that carries services, actions and parameters names among its features."""


class Lane(NamedTuple):
    """One service or topic.

    Attributes:
        name: short, for people and for calls by hand; of a service, empty.
        suffix: behind the route's name: ``/_action/send_goal``.
        is_topic: it is a topic, from the providing side to the callers'.
        type_suffix: behind the route's type: ``_SendGoal``.
        type_name: where that does not depend on the route's type; empty: it does.
        absolute: the topic's name where it does not depend on the route's; empty: it does.
        qos: of a topic, to publish and to subscribe with.
        patient: of a service, its answer comes when a goal is over: it has no timeout, and its latency says nothing.
        limited: what operators limit is about it: calls a second, a pause, arming. What stops a robot or tells of it,
            once it moves, is never held up.
    """

    name: str
    suffix: str = ""
    is_topic: bool = False
    type_suffix: str = ""
    type_name: str = ""
    absolute: str = ""
    qos: Qos | None = None
    patient: bool = False
    limited: bool = True


_FEEDBACK = Qos("reliable", "volatile", "keep_last", 10)
_STATUS = Qos("reliable", "transient_local", "keep_last", 1)
_EVENTS = Qos("reliable", "volatile", "keep_last", 1000)

SEND_GOAL, CANCEL_GOAL, GET_RESULT, FEEDBACK, STATUS = range(5)
"""The lanes of an action."""

LANES: dict[Kind, tuple[Lane, ...]] = {
    "topic": (),
    "service": (Lane(""),),
    "action": (
        Lane("send_goal", "/_action/send_goal", type_suffix="_SendGoal"),
        Lane("cancel_goal", "/_action/cancel_goal", type_name="action_msgs/srv/CancelGoal", limited=False),
        Lane("get_result", "/_action/get_result", type_suffix="_GetResult", patient=True, limited=False),
        Lane(
            "feedback", "/_action/feedback", is_topic=True, type_suffix="_FeedbackMessage", qos=_FEEDBACK, limited=False
        ),
        Lane(
            "status",
            "/_action/status",
            is_topic=True,
            type_name="action_msgs/msg/GoalStatusArray",
            qos=_STATUS,
            limited=False,
        ),
    ),
    "parameters": (
        Lane("list_parameters", "/list_parameters", type_name="rcl_interfaces/srv/ListParameters"),
        Lane("get_parameters", "/get_parameters", type_name="rcl_interfaces/srv/GetParameters"),
        Lane("get_parameter_types", "/get_parameter_types", type_name="rcl_interfaces/srv/GetParameterTypes"),
        Lane("describe_parameters", "/describe_parameters", type_name="rcl_interfaces/srv/DescribeParameters"),
        Lane("set_parameters", "/set_parameters", type_name="rcl_interfaces/srv/SetParameters"),
        Lane(
            "set_parameters_atomically",
            "/set_parameters_atomically",
            type_name="rcl_interfaces/srv/SetParametersAtomically",
        ),
        Lane(
            "events",
            is_topic=True,
            type_name="rcl_interfaces/msg/ParameterEvent",
            absolute="/parameter_events",
            qos=_EVENTS,
        ),
    ),
}
"""By kind; a frame names a lane by its place."""


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


FIELDS_LENGTH = 32 << 10
"""Bytes of the text that they are written in."""

Fields: TypeAlias = str | list["Fields"] | dict[str, "Fields"] | None
"""As it stands in YAML. Whether ``1.10`` is a number or a text, the field's type says. None: nothing is written."""


class FieldError(ValueError):
    """Something does not fit into its field; the text names the field, and says what it takes."""


class Refused(StrEnum):
    """Why a call was refused, or given up on the other side. Counts are kept by these words, so they are stable."""

    CALLS_UNDER_WAY = "calls under way"
    """The link has as many as it may."""
    BYTES_UNDER_WAY = "bytes under way"
    """Likewise, of what calls and answers hold."""
    CALLS_A_SECOND = "calls a second"
    """More come than the link, the entry or the rights allow."""
    PAUSED = "paused"
    DISARMED = "disarmed"
    UNHEARD = "link silent"
    """It is armed, and the two sides have not heard each other for a second; an older peer reads `OTHER`."""
    PROVIDER_GONE = "provider gone"
    """Nobody serves it any more; the call reached nobody."""
    TOO_LARGE = "too large"
    """The request or the response is longer than a message may be."""
    MALFORMED = "malformed"
    """The request or the response is not one of its type; ROS did not get it."""
    TOO_COMPLEX = "too complex"
    """The request or the response has too many strings and sequences to check, or the link's calls have."""
    NOT_SENT = "not sent"
    """The middleware refused the request."""
    NOT_ARRIVED = "not arrived"
    """A goal was under way when the link went, never arrived, and does not begin late."""
    TOO_OLD = "too old"
    """The request was older than `max_age` when it would have been handed on; the call reached nobody."""
    LOST = "lost"
    """It was under way when its provider went. Counted as lost, not as refused."""
    OTHER = "other"
    """A newer peer's reason."""

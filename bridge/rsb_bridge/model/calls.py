"""Services and topics that actions and parameters consist of, and immutable data about calls for user interfaces."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.model.qos import Qos

if TYPE_CHECKING:
    from rsb_bridge.model.session import Kind

MOST_LANES = 16
FEATURE = "calls"
"""The feature of a side that carries services, actions and parameters."""


class ServiceMember(NamedTuple):
    """One service or topic of a route of calls; frames name it by its place among them, the *lane*.

    Attributes:
        name: short, for people and for calls by hand, or empty for a route that is one service.
        suffix: added to the route's name: ``/_action/send_goal``.
        is_topic: whether it is a topic, from the providing side to the callers'.
        type_suffix: added to the route's type: ``_SendGoal``.
        type_name: the type, or empty if it depends on the route's.
        absolute: the topic's name, or empty if it depends on the route's.
        qos: the QoS of a topic.
        patient: whether a service answers when a goal is over, so that it has no timeout and no meaningful latency.
        limited: whether rate limits, pauses and arming apply. They never hold up what stops or watches a robot.
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

LANES: dict[Kind, tuple[ServiceMember, ...]] = {
    "topic": (),
    "service": (ServiceMember(""),),
    "action": (
        ServiceMember("send_goal", "/_action/send_goal", type_suffix="_SendGoal"),
        ServiceMember("cancel_goal", "/_action/cancel_goal", type_name="action_msgs/srv/CancelGoal", limited=False),
        ServiceMember("get_result", "/_action/get_result", type_suffix="_GetResult", patient=True, limited=False),
        ServiceMember(
            "feedback", "/_action/feedback", is_topic=True, type_suffix="_FeedbackMessage", qos=_FEEDBACK, limited=False
        ),
        ServiceMember(
            "status",
            "/_action/status",
            is_topic=True,
            type_name="action_msgs/msg/GoalStatusArray",
            qos=_STATUS,
            limited=False,
        ),
    ),
    "parameters": (
        ServiceMember("list_parameters", "/list_parameters", type_name="rcl_interfaces/srv/ListParameters"),
        ServiceMember("get_parameters", "/get_parameters", type_name="rcl_interfaces/srv/GetParameters"),
        ServiceMember("get_parameter_types", "/get_parameter_types", type_name="rcl_interfaces/srv/GetParameterTypes"),
        ServiceMember("describe_parameters", "/describe_parameters", type_name="rcl_interfaces/srv/DescribeParameters"),
        ServiceMember("set_parameters", "/set_parameters", type_name="rcl_interfaces/srv/SetParameters"),
        ServiceMember(
            "set_parameters_atomically",
            "/set_parameters_atomically",
            type_name="rcl_interfaces/srv/SetParametersAtomically",
        ),
        ServiceMember(
            "events",
            is_topic=True,
            type_name="rcl_interfaces/msg/ParameterEvent",
            absolute="/parameter_events",
            qos=_EVENTS,
        ),
    ),
}
"""By kind."""


@dataclass(frozen=True, slots=True)
class CallsSnapshot:
    """The calls of a service, an action or a node's parameters, as this side counts them since the route was made.

    ``asked = answered + expired + refused + lost + in_flight``.

    Attributes:
        asked: calls taken from callers; on the providing side, calls that came over the link.
        answered: answered to their callers.
        expired: given up after the timeout.
        refused: not carried, by cause (`Refused`).
        lost: given up because the link or the provider was lost.
        in_flight: waiting for an answer now.
        late: answers that came after their call was given up. Not a part of `asked`.
        node_p50: s that the far node took for an answer, or None without a figure.
        node_p99: s.
        way_p50: s that both bridges and the link took, or None without a figure.
        way_p99: s.
        last_failure: the reason why the last call without an answer had none, or empty.
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
            ``canceled`` or ``aborted``; ``asked`` or ``rejected``; or ``unknown``.
        since: s since the epoch, when it came to that state.
        feedbacks: feedback messages that crossed.
        result_awaited: whether a caller waits for its result.
    """

    id: str
    state: str
    since: float
    feedbacks: int = 0
    result_awaited: bool = False


FIELDS_LENGTH = 32 << 10
"""Bytes of the longest YAML text of fields."""

Fields: TypeAlias = str | list["Fields"] | dict[str, "Fields"] | None
"""Fields as parsed from YAML. The field's type decides whether ``1.10`` is a number or a text; None is no value."""


class FieldError(ValueError):
    """A value does not fit into its field; the text names the field and its type."""


class Refused(StrEnum):
    """The cause of a refusal, or of a call given up on the other side. Counts use these words: they are stable."""

    CALLS_UNDER_WAY = "calls under way"
    """Too many calls wait for answers on the link."""
    BYTES_UNDER_WAY = "bytes under way"
    """Calls and answers on the link hold too many bytes."""
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
    """The link was lost before a goal arrived, and a goal must not begin late."""
    TOO_OLD = "too old"
    """The request was older than `max_age` when it would have been handed on; the call reached nobody."""
    LOST = "lost"
    """Its provider was lost before it answered. Counted as lost, not as refused."""
    OTHER = "other"
    """A cause that only a newer version knows."""

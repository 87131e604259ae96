"""Services and topics that actions and parameters consist of, and immutable data about calls for user interfaces."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.model.qos import Qos

if TYPE_CHECKING:
    from rsb_bridge.model.session import Kind

MOST_LANES = 16  # of the protocol (PROTOCOL.md, 3: Provide); parameters have the most, seven


class ServiceMember(NamedTuple):
    """One service or topic of a route of calls; frames name it by its place among them, the *lane*."""

    name: str  # short, for people and for calls by hand, or empty for a route that is one service
    suffix: str = ""  # added to the route's name: ``/_action/send_goal``
    is_topic: bool = False  # whether it is a topic, from the providing side to the callers'
    type_suffix: str = ""  # added to the route's type: ``_SendGoal``
    type_name: str = ""  # the type, or empty if it depends on the route's
    absolute: str = ""  # the topic's name, or empty if it depends on the route's
    qos: Qos | None = None  # the QoS of a topic
    patient: bool = False
    """Whether a service answers when a goal is over, so that it has no timeout and no meaningful latency."""
    limited: bool = True
    """Whether rate limits, pauses and arming apply. They never hold up what stops or watches a robot."""

    def name_on(self, route_name: str) -> str:
        """Return the name of a route's service or topic: ``/navigate/_action/send_goal``."""
        return self.absolute or route_name + self.suffix

    def type_in(self, route_type: str) -> str:
        """Return its type, ``pkg/action/Navigate_SendGoal``, or an empty string if a route's is not known yet."""
        return self.type_name or (route_type + self.type_suffix if route_type else "")

    def route_type(self, lane_type: str) -> str:
        """Return the route's type, derived from this one's, or an empty string if they are independent."""
        if self.type_name or not lane_type.endswith(self.type_suffix):
            return ""
        return lane_type.removesuffix(self.type_suffix)


# As rcl_action and rclcpp make these topics: another QoS would not match, or keep another number of messages.
_FEEDBACK = Qos("reliable", "volatile", "keep_last", 10)
_STATUS = Qos("reliable", "transient_local", "keep_last", 1)
_EVENTS = Qos("reliable", "volatile", "keep_last", 1000)

SEND_GOAL, CANCEL_GOAL, GET_RESULT, FEEDBACK, STATUS = range(5)  # the lanes of an action

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
"""Lanes by kind; a frame names a lane by its index."""


@dataclass(frozen=True, slots=True)
class CallsSnapshot:
    """Counts of the calls of a service, an action or a node's parameters on this side since the route was made.

    ``asked = answered + expired + refused + lost + in_flight``.
    """

    asked: int = 0  # calls taken from callers; on the providing side, calls that came over the link
    answered: int = 0  # calls with a reply that went back to the caller
    expired: int = 0  # calls given up after the timeout
    refused: dict[str, int] = field(default_factory=dict)
    """Calls not carried, by cause: ``calls under way``, ``bytes under way``, ``calls a second``, ``paused``,
    ``disarmed``, ``provider gone``, ``too large``, ``not sent``, ``other``."""
    lost: int = 0  # pending calls given up because the link or the provider went away
    in_flight: int = 0
    waiting: int = 0  # pending calls that wait on the providing side until their node has read earlier ones
    late: int = 0  # replies that came after their call was given up. Not a part of `asked`
    node_p50: float | None = None
    """Median time in seconds that the far node took to reply, or None if there is no figure."""
    node_p99: float | None = None  # 99th percentile of that time
    way_p50: float | None = None
    """Median time in seconds there and back through both bridges and the link, or None if there is no figure."""
    way_p99: float | None = None  # 99th percentile of that time
    last_failure: str = ""  # the last call without a reply and the reason, or an empty string


@dataclass(frozen=True, slots=True)
class GoalSnapshot:
    """A goal of an action."""

    id: str  # 32 hexadecimal digits
    state: str
    """A state of action_msgs/msg/GoalStatus: ``accepted``, ``executing``, ``canceling``, ``succeeded``, ``canceled`` or
    ``aborted``; or ``asked``, ``rejected``, or ``unknown`` if no report of its end came."""
    since: float  # s since the epoch when it reached that state
    feedbacks: int = 0  # number of feedback messages that crossed
    result_awaited: bool = False  # whether a caller waits for its result


FIELDS_LENGTH = 32 << 10  # bytes of the longest YAML text of fields

Fields: TypeAlias = str | list["Fields"] | dict[str, "Fields"] | None
"""Fields as written in YAML; a field's type decides whether ``1.10`` is a number or a text. None means no value."""


class FieldError(ValueError):
    """A value does not fit into its field; the text names the field and what it accepts."""


class Refused(StrEnum):
    """Reasons for a refused call, or one given up on the other side. They name counts, so they must not change."""

    CALLS_UNDER_WAY = "calls under way"
    """The link already has as many pending calls as it may have."""
    BYTES_UNDER_WAY = "bytes under way"
    """The link's pending calls and replies already hold as many bytes as they may."""
    TOO_FAST = "calls a second"
    """More calls or messages come than the link, the topic's entry or the rights allow. Messages count as throttled."""
    PAUSED = "paused"
    DISARMED = "disarmed"
    UNHEARD = "link silent"
    """It is armed, but the two sides have not heard each other for a second."""
    PROVIDER_GONE = "provider gone"
    """No node provides the service any more; the call reached no node."""
    TOO_LARGE = "too large"
    """The request or the response is longer than a message may be."""
    MALFORMED = "malformed"
    """The request or the response does not match its type; ROS did not get it."""
    TOO_COMPLEX = "too complex"
    """The request or the response, or the link's calls together, have too many strings and sequences to check."""
    NOT_SENT = "not sent"
    """The middleware refused the request."""
    TOO_OLD = "too old"
    """The request was older than `max_age` before delivery; the call reached no node."""
    LOST = "lost"
    """The provider went away while the call was pending. Counted as lost, not as refused."""
    OTHER = "other"
    """A reason that only a newer peer knows."""

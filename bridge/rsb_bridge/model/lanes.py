"""What routes of calls consist of: the services and topics behind a service, an action or a node's parameters.

The names and types of an action's: the ROS 2 design article on actions, and rcl_action/names.h.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

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

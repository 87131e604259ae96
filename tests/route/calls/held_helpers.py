"""Helpers of `test_held` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from tests.support.goals import goal, goal_request
from tests.support.offline import half_of

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.route.calls.provider import Provider

if TYPE_CHECKING:
    from rsb_bridge.context import Context


GOAL = goal_request(goal(1))


class Dock(NoRos):
    """The ROS side of an action's server.

    Attributes:
        clients: the services that were to be called.
    """

    _TYPES: ClassVar = {
        "send_goal": "a/action/B_SendGoal",
        "cancel_goal": "action_msgs/srv/CancelGoal",
        "get_result": "a/action/B_GetResult",
    }

    def __init__(self, client: Any = None) -> None:
        self.clients: list[str] = []
        self._client = client

    def servers(self, service: str) -> list[Endpoint]:
        return [Endpoint("/dock", self._TYPES[service.rpartition("/")[2]], "h", Qos(), service.encode())]

    def call_service(self, service: str, *_: Any, **__: Any) -> Any:
        self.clients.append(service)
        return self._client


def providing(context: Context, **fields: Any) -> Provider:
    """An action's half where its server is, in an opening of its own."""
    spec = Topic("/dock", "transmit", kind="action", **fields)
    half = half_of(Provider, context, spec, here=False)
    half.route.arming.opened(required=spec.arm, deadman=0.0)
    return half

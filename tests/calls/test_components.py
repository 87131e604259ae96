"""Nodes that others manage: a lifecycle driven from the far side, and a component that lives in simulated time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lifecycle_msgs.msg import State as Lifecycle
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger
from tests.calls.ledgers import counts
from tests.support.bridge import route
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.spun import Spun


class Arm(LifecycleNode):  # type: ignore[misc]
    """A lifecycle node that fails to activate the first time."""

    def __init__(self, *args: Any, **how: Any) -> None:
        self.did: list[str] = []
        super().__init__(*args, **how)

    def on_configure(self, state: Any) -> TransitionCallbackReturn:
        self.did.append("configure")
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        self.did.append("activate")
        first = self.did.count("activate") == 1
        return TransitionCallbackReturn.FAILURE if first else TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        self.did.append("deactivate")
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: Any) -> TransitionCallbackReturn:
        self.did.append("cleanup")
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: Any) -> TransitionCallbackReturn:
        self.did.append("shutdown")
        return TransitionCallbackReturn.SUCCESS


def test_a_lifecycle_node_is_driven_through_its_transitions_from_the_far_side(
    bridge: Bridge, start: Callable[..., Spun], robot: Domain, pc: Domain
) -> None:
    arm = start(robot, "arm", kind=Arm)
    services = (
        "change_state",
        "get_state",
        "get_available_states",
        "get_available_transitions",
        "get_transition_graph",
    )
    bridge.both(
        *(Topic(f"/arm/{each}", "receive", kind="service") for each in services),
        Topic("/arm/transition_event", "transmit"),
        use_name=True,
    )
    manager = start(pc, "manager")
    listener = pc.listener("/robot1/arm/transition_event", TransitionEvent, QoSProfile(depth=100))
    states = manager.call(GetAvailableStates, "/robot1/arm/get_available_states", GetAvailableStates.Request())
    assert {each.label for each in states.available_states} >= {"unconfigured", "inactive", "active", "finalized"}
    graph = manager.call(
        GetAvailableTransitions, "/robot1/arm/get_transition_graph", GetAvailableTransitions.Request()
    ).available_transitions
    assert ("unconfigured", "inactive") not in {(each.start_state.label, each.goal_state.label) for each in graph}
    assert ("unconfigured", "configuring") in {(each.start_state.label, each.goal_state.label) for each in graph}
    eventually(lambda: listener.matched >= 1)

    def state() -> int:
        return int(manager.call(GetState, "/robot1/arm/get_state", GetState.Request()).current_state.id)

    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(manager.call(ChangeState, "/robot1/arm/change_state", request).success)

    def possible() -> set[str]:
        request = GetAvailableTransitions.Request()
        answer = manager.call(GetAvailableTransitions, "/robot1/arm/get_available_transitions", request)
        return {each.transition.label for each in answer.available_transitions}

    assert state() == Lifecycle.PRIMARY_STATE_UNCONFIGURED
    assert possible() == {"configure", "shutdown"}
    for transition, succeeds, becomes in (
        (Transition.TRANSITION_CONFIGURE, True, Lifecycle.PRIMARY_STATE_INACTIVE),
        (Transition.TRANSITION_ACTIVATE, False, Lifecycle.PRIMARY_STATE_INACTIVE),
        (Transition.TRANSITION_ACTIVATE, True, Lifecycle.PRIMARY_STATE_ACTIVE),
        (Transition.TRANSITION_DEACTIVATE, True, Lifecycle.PRIMARY_STATE_INACTIVE),
        (Transition.TRANSITION_CLEANUP, True, Lifecycle.PRIMARY_STATE_UNCONFIGURED),
        (Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, True, Lifecycle.PRIMARY_STATE_FINALIZED),
    ):
        assert change(transition) is succeeds
        assert state() == becomes
    assert arm.node.did == ["configure", "activate", "activate", "deactivate", "cleanup", "shutdown"]
    eventually(lambda: _goals(listener)[-1:] == ["finalized"], what="events of the transitions")


def _goals(listener: Any) -> list[str]:
    return [deserialize_message(each, TransitionEvent).goal_state.label for each in listener.payloads]


def test_a_component_is_put_into_simulated_time_and_calls_expire_by_the_bridges_own(
    bridge: Bridge, start: Callable[..., Spun], robot: Domain, pc: Domain
) -> None:
    """Its clock stands still until the simulator on the other side goes on; the bridge's does not."""
    component = start(robot, "component")
    clock = component.node.get_clock()
    begun: list[object] = []

    def after_five_seconds(_: Any, response: Trigger.Response) -> Trigger.Response:
        until = clock.now() + Duration(seconds=5)
        begun.append(until)  # time may go on from here
        clock.sleep_until(until, component.node.context)
        response.message = f"{clock.now().nanoseconds // 10**9}"
        return response

    component.node.create_service(Trigger, "/slow", after_five_seconds, callback_group=ReentrantCallbackGroup())
    server, client = bridge.both(
        Topic("/component", "receive", kind="parameters"),
        Topic("/clock", "receive"),
        Topic("/slow", "receive", kind="service", timeout=5.0),
    )
    simulator = start(pc, "simulator")
    far = AsyncParameterClient(simulator.node, "/component")
    eventually(far.services_are_ready)
    (done,) = simulator.result(far.set_parameters([Parameter("use_sim_time", value=True)])).results
    assert done.successful
    ticks = pc.publisher("/clock", Clock, QoSProfile(depth=10))

    def seconds(time: int) -> bool:
        message = Clock()
        message.clock.sec = time
        ticks.publish(message)
        return bool(clock.now().nanoseconds == time * 10**9)

    eventually(lambda: seconds(1000), what="the simulator's time in the component")
    slow = simulator.node.create_client(Trigger, "/slow")
    eventually(slow.service_is_ready)
    waiting = slow.call_async(Trigger.Request())
    eventually(lambda: counts(server, "/slow").expired == 1 and counts(client, "/slow").expired == 1)
    assert not waiting.done()
    assert clock.now().nanoseconds == 1000 * 10**9
    assert route(server, "/slow").calls.last_failure  # type: ignore[union-attr]
    eventually(lambda: seconds(1010))  # the node answers now, and too late
    eventually(lambda: counts(client, "/slow").late == 1)
    waiting = slow.call_async(Trigger.Request())
    eventually(lambda: len(begun) == 2)
    eventually(lambda: seconds(1020) and waiting.done())
    assert waiting.result().message == "1020"
    (simulated,) = simulator.result(far.get_parameters(["use_sim_time"])).values
    assert simulated.bool_value

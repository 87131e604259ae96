"""A node that another one manages: a component that lives in simulated time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
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

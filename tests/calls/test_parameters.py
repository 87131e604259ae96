"""A node's parameters over a bridge, as rclpy's own client of parameters uses them, and that node's events alone."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import pytest
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.msg import ParameterType as Type
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.parameter_event_handler import ParameterEventHandler
from rclpy.qos import qos_profile_parameter_events
from rclpy.serialization import deserialize_message, serialize_message
from tests.calls.parameters_helpers import client_of, parameters
from tests.support.bridge import happened, route
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.calls.node_parameters import NoParameters

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Listener
    from tests.support.spun import Spun

VALUES = {
    "rate": 5,
    "gain": 0.25,
    "frame": "größer",
    "on": True,
    "limits": [1.0, -1.5],
    "ids": [1, 2**62],
    "names": ["a", ""],
    "flags": [True, False],
}


@pytest.fixture
def camera(start: Callable[..., Spun], robot: Domain) -> Spun:
    spun = start(robot, "camera")
    for name, value in VALUES.items():
        spun.node.declare_parameter(name, value)
    return spun


def heard(listener: Listener) -> list[ParameterEvent]:
    return [deserialize_message(each, ParameterEvent) for each in listener.payloads]


def crosses(spun: Spun, listener: Listener, node: str) -> None:
    """Wait until a node's events reach a listener: a listener that is not discovered yet misses some."""
    numbers = itertools.count(1000)

    def set_one() -> bool:
        spun.node.set_parameters([Parameter("rate", value=next(numbers))])
        return any(event.node == node for event in heard(listener))

    eventually(set_one, what=f"events of {node}")


def events_of(domain: Domain) -> Listener:
    return domain.listener("/parameter_events", ParameterEvent, qos_profile_parameter_events)


def subscriptions(domain: Domain) -> int:
    """Return the bridges' subscriptions to events, without the subscriptions of rclpy's nodes."""
    found = domain.node.get_subscriptions_info_by_topic("/parameter_events")
    return sum(each.node_name.startswith("_rsb_robot1") for each in found)


def test_remote_client_of_parameters_does_everything(
    bridge: Bridge, start: Callable[..., Spun], camera: Spun, pc: Domain
) -> None:
    server, client = bridge.both(parameters("/camera"), use_name=True)
    program = start(pc, "program")
    far = client_of(program, "/robot1/camera")

    listed = program.result(far.list_parameters()).result.names
    assert set(VALUES) <= set(listed)
    values = program.result(far.get_parameters(list(VALUES))).values
    assert dict(zip(VALUES, map(parameter_value_to_python, values), strict=True)) == VALUES
    types = program.result(far.get_parameter_types(["rate", "names"])).types
    assert list(types) == [Type.PARAMETER_INTEGER, Type.PARAMETER_STRING_ARRAY]
    (described,) = program.result(far.describe_parameters(["gain"])).descriptors
    assert (described.name, described.type) == ("gain", Type.PARAMETER_DOUBLE)

    (set_one,) = program.result(far.set_parameters([Parameter("rate", value=7)])).results
    assert set_one.successful
    (refused,) = program.result(far.set_parameters([Parameter("rate", value="fast")])).results
    assert not refused.successful
    assert "type" in refused.reason
    both = [Parameter("gain", value=2.5), Parameter("frame", value="map")]
    assert program.result(far.set_parameters_atomically(both)).result.successful
    assert [camera.node.get_parameter(name).value for name in ("rate", "gain", "frame")] == [7, 2.5, "map"]

    for engine, name in ((server, "/robot1/camera"), (client, "/camera")):
        eventually(lambda engine=engine, name=name: route(engine, name).calls.in_flight == 0)  # type: ignore[union-attr]
        calls = route(engine, name).calls
        assert calls is not None
        assert calls.asked == calls.answered == 7


def test_events_of_node_come_under_its_name(
    bridge: Bridge, start: Callable[..., Spun], camera: Spun, robot: Domain, pc: Domain
) -> None:
    """Two nodes are bridged, and one is not; one subscription brings the events of all of them."""
    lidar, other = start(robot, "lidar"), start(robot, "other")
    for each in (lidar, other):
        each.node.declare_parameter("rate", 1)
    server, client = bridge.both(
        parameters("/camera"), parameters("/lidar", remote_topic="/robot1/front/lidar"), use_name=True
    )
    program = start(pc, "program")
    listener = events_of(pc)
    handler = ParameterEventHandler(program.node)
    told: list[int] = []
    handler.add_parameter_callback(
        "rate", "/robot1/camera", lambda parameter: told.append(parameter.value.integer_value)
    )
    for node in ("/robot1/camera", "/robot1/front/lidar"):
        client_of(program, node)
    crosses(camera, listener, "/robot1/camera")
    crosses(lidar, listener, "/robot1/front/lidar")

    def is_told() -> bool:
        camera.node.set_parameters([Parameter("rate", value=1000)])
        return bool(told)

    eventually(is_told, what="the handler, which is discovered on its own, hears it, too")
    for number in range(10, 20):
        for each in (other, camera, lidar):
            each.node.set_parameters([Parameter("rate", value=number)])

    def numbers() -> dict[str, list[int]]:
        found: dict[str, list[int]] = {}
        for event in heard(listener):
            for changed in event.changed_parameters:
                found.setdefault(event.node, []).append(changed.value.integer_value)
        return {node: each[each.index(10) :] for node, each in found.items() if 10 in each}

    wanted = list(range(10, 20))
    eventually(
        lambda: numbers().get("/robot1/front/lidar", [])[-1:] == [19] == numbers().get("/robot1/camera", [])[-1:]
    )
    assert numbers() == {"/robot1/camera": wanted, "/robot1/front/lidar": wanted}
    eventually(lambda: [each for each in told if each < 1000] == wanted)
    assert happened(server, EventCode.ROUTE_EVENT_LEFT_OUT) is None

    assert subscriptions(robot) == 1
    client.remove_topic(route(client, "/lidar").key).result(60)
    camera.node.set_parameters([Parameter("rate", value=20)])
    eventually(lambda: numbers()["/robot1/camera"][-1] == 20)
    assert subscriptions(robot) == 1
    client.remove_topic(route(client, "/camera").key).result(60)
    eventually(lambda: subscriptions(robot) == 0)


def test_what_is_no_event_is_left_out(
    bridge: Bridge, start: Callable[..., Spun], camera: Spun, robot: Domain, pc: Domain
) -> None:
    """A node of the domain publishes what it likes on /parameter_events; the others' events go on."""
    _, client = bridge.both(parameters("/camera"), use_name=True)
    program = start(pc, "program")
    client_of(program, "/robot1/camera")
    listener = events_of(pc)
    rogue = robot.publisher("/parameter_events", ParameterEvent, qos_profile_parameter_events)

    def left_out() -> bool:
        for payload in (serialize_message(ParameterEvent(node="/camera"))[:20], b"\x00\x09\x00\x00nonsense"):
            rogue.publish(payload)
        return happened(client, EventCode.ROUTE_EVENT_LEFT_OUT) is not None

    eventually(left_out)
    crosses(camera, listener, "/robot1/camera")
    assert {event.node for event in heard(listener)} == {"/robot1/camera"}


def test_node_that_lacks_services_is_not_offered(
    bridge: Bridge, start: Callable[..., Spun], robot: Domain, pc: Domain
) -> None:
    start(robot, "plain", start_parameter_services=False)
    half = start(robot, "half", start_parameter_services=False)
    for kind, name in ((ListParameters, "list_parameters"), (GetParameters, "get_parameters")):
        half.node.create_service(kind, f"/half/{name}", lambda _, response: response)
    server, client = bridge.both(parameters("/plain"), parameters("/half"), parameters("/nobody"))
    eventually(lambda: says(route(client, "/plain").reason, NoParameters.NO_SERVICES, node="/plain"))
    assert route(client, "/plain").state == State.DOWN
    eventually(lambda: says(route(server, "/plain").reason, NoParameters.NO_SERVICES, node="/plain"))
    for engine in (client, server):
        eventually(lambda engine=engine: says(route(engine, "/half").reason, NoParameters.SOME_SERVICES, node="/half"))
    assert "/half/get_parameter_types" in route(client, "/half").reason
    eventually(lambda: route(server, "/nobody").cause == Cause.NO_SERVER)
    program = start(pc, "program")
    assert not AsyncParameterClient(program.node, "/plain").services_are_ready()
    assert program.node.count_services("/plain/list_parameters") == 0


def test_parameters_leave_and_return_with_node(
    bridge: Bridge, start: Callable[..., Spun], camera: Spun, robot: Domain, pc: Domain
) -> None:
    bridge.both(parameters("/camera"))
    program = start(pc, "program")
    far = client_of(program, "/camera")
    services = ("/camera/set_parameters", "/camera/list_parameters")
    camera.node.destroy_node()
    eventually(lambda: not any(program.node.count_services(each) for each in services))
    assert not far.services_are_ready()
    again = start(robot, "camera")
    again.node.declare_parameter("gain", 3.5)
    eventually(far.services_are_ready)
    (value,) = program.result(far.get_parameters(["gain"])).values
    assert value.double_value == 3.5

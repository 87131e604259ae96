"""Actions over a bridge: an rclpy action server in the robot's domain, an rclpy action client in the PC's."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

pytest.importorskip("test_msgs", reason="no package with an action is installed (ros-jazzy-test-msgs)")

from action_msgs.msg import GoalStatus, GoalStatusArray
from rclpy.qos import qos_profile_action_status_default
from rclpy.serialization import deserialize_message
from tests.engine.actions_helpers import FIBONACCI
from tests.support.bridge import feedback_listeners, route
from tests.support.fibonacci import ACTION, FibonacciClient, FibonacciProcess, FibonacciServer, fibonacci, id_of
from tests.support.inside import inside
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Listener

    from rsb_bridge.engine import Engine


def test_goals_of_many_clients_at_once(
    bridge: Bridge, server: FibonacciServer, client: FibonacciClient, pc: Domain
) -> None:
    engines = bridge.both(FIBONACCI)
    other = FibonacciClient(pc.id)
    goals = [who.send(number) for number in range(4) for who in (client, other)]
    assert all(goal.handle().accepted for goal in goals)
    for goal in goals:
        goal.ask()
    by_id = {id_of(goal.handle()): goal for goal in goals}
    eventually(lambda: server.is_heard and feedback_listeners(engines[0]) == 2)
    for number in reversed(range(8)):
        handle = server.goal(number)
        server.feedback(number, number=number)
        eventually(lambda handle=handle: by_id[id_of(handle)].feedbacks)
        server.finish(number, number, number=number)
    assert [by_id[id_of(server.goal(number))].result() for number in range(8)] == [
        ("succeeded", [number, number]) for number in range(8)
    ]
    assert all(by_id[id_of(server.goal(number))].feedbacks == [[number]] for number in range(8))
    other.close()


def test_a_goal_that_is_not_accepted_harms_nobody(bridge: Bridge, client: FibonacciClient, robot: Domain) -> None:
    """zenoh-plugin-ros2dds #326: the caller's node died of it."""
    unwilling = FibonacciServer(robot.id, accepts=False)
    pc_engine, robot_engine = bridge.both(FIBONACCI)
    goals = [client.send(number) for number in range(3)]
    assert [goal.handle().accepted for goal in goals] == [False] * 3
    assert sorted(unwilling.orders) == [0, 1, 2]  # several threads take them
    for engine in (pc_engine, robot_engine):
        eventually(lambda engine=engine: states(engine) == ["rejected"] * 3)
    unwilling.close()
    eventually(lambda: not client.ready)
    willing = FibonacciServer(robot.id)
    assert client.send(3).handle().accepted
    willing.close()


def test_a_result_may_take_longer_than_any_call(
    bridge: Bridge, server: FibonacciServer, client: FibonacciClient
) -> None:
    """zenoh-plugin-ros2dds #210: the result was lost, though feedback had come."""
    pc_engine, robot_engine = bridge.both(msgspec.structs.replace(FIBONACCI, timeout=4.0))
    goal = client.send(5).ask()
    began = time.monotonic()
    while time.monotonic() < began + 5.0:
        server.feedback(len(goal.feedbacks))
        time.sleep(0.1)
    server.finish(1, 2, 3)
    assert goal.result() == ("succeeded", [1, 2, 3])
    for engine in (pc_engine, robot_engine):
        calls = route(engine, ACTION).calls
        assert calls is not None
        assert calls.expired == 0


def test_both_consoles_show_goals_and_their_states(
    bridge: Bridge, server: FibonacciServer, client: FibonacciClient
) -> None:
    engines = bridge.both(FIBONACCI)
    goal, other = client.send(1).ask(), client.send(2)
    for engine in engines:
        eventually(lambda engine=engine: states(engine) == ["executing", "executing"])
        eventually(lambda engine=engine: [each.result_awaited for each in route(engine, ACTION).goals] == [False, True])
    eventually(lambda: server.is_heard)
    server.feedback(1)
    server.feedback(2)
    other.cancel()
    for engine in engines:
        eventually(lambda engine=engine: states(engine) == ["canceling", "executing"])
        second, first = route(engine, ACTION).goals
        assert (first.id, second.id) == (id_of(goal.handle()), id_of(other.handle()))
        assert (first.result_awaited, second.result_awaited) == (True, False)
        eventually(lambda engine=engine: [each.feedbacks for each in route(engine, ACTION).goals] == [0, 2])
    server.finish(1)
    server.finish(1, number=1, state="canceled")
    assert goal.result() == ("succeeded", [1])
    for engine in engines:
        eventually(lambda engine=engine: states(engine) == ["canceled", "succeeded"])


def test_who_comes_late_gets_the_status(
    bridge: Bridge, server: FibonacciServer, client: FibonacciClient, pc: Domain
) -> None:
    bridge.both(FIBONACCI)
    client.send(1)
    server.goal()
    late = pc.listener(f"{ACTION}/_action/status", GoalStatusArray, qos_profile_action_status_default)
    eventually(lambda: [each.status for each in newest_status(late)] == [GoalStatus.STATUS_EXECUTING])


def test_a_server_that_is_started_again_serves_again(bridge: Bridge, client: FibonacciClient, robot: Domain) -> None:
    """Goals of the one that is gone are unknown: that is what the new one answers to clients that ask again."""
    engines = bridge.both(FIBONACCI)
    with FibonacciProcess(robot.id):
        goal = client.send(10_000).ask()
        eventually(lambda: states(engines[0]) == ["executing"])
    eventually(lambda: not client.ready)
    for engine in engines:
        eventually(lambda engine=engine: states(engine) == ["unknown"])
    with FibonacciProcess(robot.id):
        eventually(lambda: client.ready)
        assert goal.ask().result() == ("unknown", [])
        assert client.send(2).ask().result() == ("succeeded", fibonacci(2))


def test_server_killed_and_restarted_serves_at_once(bridge: Bridge, client: FibonacciClient, robot: Domain) -> None:
    """zenoh-plugin-ros2dds #367, #413: it was dead for good. DDS still sees the old one."""
    _, robot_engine = bridge.both(FIBONACCI)
    with FibonacciProcess(robot.id) as server:
        assert client.send(10_000).handle().accepted
        dead = eventually(lambda: found if len(found := servers(robot_engine)) == 3 else None)
        server.kill()
    with FibonacciProcess(robot.id):
        eventually(lambda: len(servers(robot_engine) - dead) == 3, what="the new server is seen, too")
        for order in range(3):
            assert client.send(order).ask().result() == ("succeeded", fibonacci(order))


def states(engine: Engine) -> list[str]:
    """Return the states of an engine's goals, in the order of its snapshot."""
    return [goal.state for goal in route(engine, ACTION).goals]


def servers(engine: Engine) -> set[bytes]:
    """The services of nodes that serve the action in an engine's domain, three of each, as its route knows."""
    (found,) = (each for link in inside(engine).role.links() for each in tuple(link.routes.values()))
    return {each.gid for each in found.half.carried.endpoints}


def newest_status(listener: Listener) -> Any:
    """The goals of the last status message."""
    payloads = listener.payloads
    return deserialize_message(payloads[-1], GoalStatusArray).status_list if payloads else ()

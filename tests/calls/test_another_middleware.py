"""rclpy carries calls of installed types where they cannot be carried raw, as with another middleware.

No other middleware is available as a wheel, so the test makes the bridge take this one for another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support import replaced

pytest.importorskip("test_msgs", reason="no package with an action is installed (ros-jazzy-test-msgs)")

from rclpy.parameter import Parameter
from tests.calls.ledgers import balanced, called, nothing_left, settled
from tests.calls.parameters_helpers import client_of, parameters
from tests.engine.actions_helpers import FIBONACCI
from tests.support.bridge import feedback_listeners
from tests.support.fibonacci import FibonacciClient, FibonacciServer
from tests.support.waiting import eventually

from rsb_bridge.ros.native.named_types import named_services
from rsb_bridge.ros.self_test import findings

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode
    from tests.support.domain import Domain
    from tests.support.spun import Spun


@pytest.fixture(autouse=True)
def _another(monkeypatch: pytest.MonkeyPatch) -> None:
    found = findings()._replace(no_calls="this is another middleware")
    replaced.FINDINGS.set(monkeypatch, lambda: found)


def test_calls_are_answered_in_any_order(bridge: Bridge, near: CallNode, far: CallNode, service: str) -> None:
    far.serve(service, delay=(0.0, 0.1), gather=10)
    engines = bridge.both(called(service))
    with balanced(*engines):
        near.waits_for(service)
        outcome = near.call(service, 100, at_once=50, size=1000, response=100_000)
        assert outcome.right, outcome
        assert not named_services.used
        for engine in engines:
            settled(engine, service, asked=100, answered=100)
    nothing_left(*engines)


def test_parameters_and_actions_cross(bridge: Bridge, start: Callable[..., Spun], robot: Domain, pc: Domain) -> None:
    camera, program = start(robot, "camera"), start(pc, "program")
    camera.node.declare_parameter("rate", 5)
    server, client = FibonacciServer(robot.id), FibonacciClient(pc.id)
    engine, _ = bridge.both(parameters("/camera"), FIBONACCI)
    far = client_of(program, "/camera")
    (done,) = program.result(far.set_parameters([Parameter("rate", value=7)])).results
    assert done.successful
    assert program.result(far.get_parameters(["rate"])).values[0].integer_value == 7

    goals = [client.send(5), client.send(6)]
    assert all(goal.handle().accepted for goal in goals)
    eventually(lambda: server.is_heard and feedback_listeners(engine))
    first, second = (server.number_of(goal) for goal in goals)  # it takes them on several threads
    for number, goal in zip((first, second), goals, strict=True):
        goal.ask()
        server.feedback(number, number=number)
        eventually(lambda goal=goal: goal.feedbacks)
    cancelled = goals[1].cancel()
    eventually(cancelled.done)
    assert len(cancelled.result().goals_canceling) == 1
    server.finish(1, state="canceled", number=second)
    server.finish(0, 1, 1, number=first)
    assert [goal.result() for goal in goals] == [("succeeded", [0, 1, 1]), ("canceled", [1])]
    server.close()
    client.close()

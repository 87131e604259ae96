"""Kills (-9) the bridge at either end of an action with running goals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

pytest.importorskip("test_msgs", reason="no package with an action is installed (ros-jazzy-test-msgs)")

from tests.support.bridge import linked, route
from tests.support.fibonacci import ACTION, FibonacciClient, FibonacciServer, id_of
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.program import Programs

FIBONACCI = Topic(ACTION, "receive", kind="action")
"""The robot provides it."""


@pytest.fixture
def client(pc: Domain) -> Iterator[FibonacciClient]:
    made = FibonacciClient(pc.id)
    yield made
    made.close()


@pytest.fixture
def forgetful(robot: Domain) -> Iterator[FibonacciServer]:
    """It forgets a result in no time."""
    made = FibonacciServer(robot.id, result_timeout=0.2)
    yield made
    made.close()


@pytest.fixture
def server(robot: Domain) -> Iterator[FibonacciServer]:
    made = FibonacciServer(robot.id, result_timeout=60.0)
    yield made
    made.close()


def test_results_outlive_the_providing_bridge_as_long_as_the_server_has_them(
    bridge: Bridge, programs: Programs, client: FibonacciClient, server: FibonacciServer
) -> None:
    engine = bridge.server()
    victim = programs.start(bridge.client_session(FIBONACCI))
    over, runs, unwanted = goals = [client.send(number).ask() for number in range(3)]
    numbers = [server.number_of(goal) for goal in goals]
    eventually(lambda: [goal.result_awaited for goal in route(engine, ACTION).goals] == [True] * 3)
    victim.kill()
    eventually(lambda: not linked(engine))
    server.finish(0, number=numbers[0])
    cancelled = unwanted.cancel()
    programs.start(bridge.client_session(FIBONACCI))
    assert over.result() == ("succeeded", [0])
    server.finish(1, number=numbers[1])
    assert runs.result() == ("succeeded", [1])
    eventually(cancelled.done)
    server.finish(2, number=numbers[2], state="canceled")
    assert unwanted.result() == ("canceled", [2])


def test_what_became_of_a_goal_is_unknown_once_its_server_and_the_bridge_beside_it_have_forgotten_it(
    bridge: Bridge, programs: Programs, client: FibonacciClient, forgetful: FibonacciServer
) -> None:
    engine = bridge.server()
    victim = programs.start(bridge.client_session(FIBONACCI))
    goal = client.send(5).ask()
    goal.handle()
    victim.kill()
    eventually(lambda: not linked(engine))
    forgetful.finish(0)
    eventually(lambda: forgetful.forgot)
    programs.start(bridge.client_session(FIBONACCI))
    assert goal.result() == ("unknown", [])


def test_goals_outlive_the_callers_bridge_and_who_asks_again_gets_their_results(
    bridge: Bridge, programs: Programs, client: FibonacciClient, forgetful: FibonacciServer
) -> None:
    """Requests to the dead bridge are lost, as with any ROS service whose server dies."""
    engine = bridge.client(FIBONACCI)
    victim = programs.start(bridge.server_session())
    over, runs = goals = [client.send(number).ask() for number in range(2)]
    numbers = [forgetful.number_of(goal) for goal in goals]
    eventually(lambda: [goal.result_awaited for goal in route(engine, ACTION).goals] == [True] * 2)
    victim.kill()
    eventually(lambda: not linked(engine))
    forgetful.finish(0, number=numbers[0])
    eventually(lambda: id_of(over.handle()) not in forgetful.remembers)
    programs.start(bridge.server_session())

    def hears() -> bool:
        forgetful.feedback(1, number=numbers[1])
        return bool(runs.feedbacks)

    eventually(hears, what="feedback comes again")
    assert over.ask().result() == ("succeeded", [0])
    cancelled = runs.cancel()
    eventually(cancelled.done)
    forgetful.finish(1, number=numbers[1], state="canceled")
    assert runs.ask().result() == ("canceled", [1])

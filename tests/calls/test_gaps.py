"""Calls and an action after a gap of their link: what waited comes at once, to nodes that keep ten of each."""

from __future__ import annotations

import threading
import time
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("test_msgs", reason="no package with an action is installed (ros-jazzy-test-msgs)")

from tests.calls.cutting import FIBONACCI
from tests.calls.ledgers import balanced, called, settled
from tests.support import constants
from tests.support.bridge import route
from tests.support.fibonacci import ACTION, FibonacciClient, FibonacciServer, Goal, id_of
from tests.support.relay import same_port
from tests.support.waiting import eventually

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode
    from tests.support.domain import Domain
    from tests.support.relay import Relay


@pytest.fixture
def relay(bridge: Bridge) -> Iterator[Relay]:
    """The network between the two sides."""
    with same_port(bridge.port) as made:
        bridge.through(made)
        yield made


@pytest.fixture
def server(robot: Domain) -> Iterator[FibonacciServer]:
    with closing(FibonacciServer(robot.id)) as made:
        yield made


@pytest.fixture
def client(pc: Domain) -> Iterator[FibonacciClient]:
    with closing(FibonacciClient(pc.id)) as made:
        yield made


def test_feedback_of_a_gap_comes_whole(
    relay: Relay,
    bridge: Bridge,
    server: FibonacciServer,
    client: FibonacciClient,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    constants.DEAD_AFTER.set(monkeypatch, 60.0)
    _, robot = bridge.both(FIBONACCI)
    goal = client.send(1).ask()
    server.goal()
    eventually(lambda: route(robot, ACTION).goals[0].result_awaited)
    server.feedback(0)
    eventually(lambda: goal.feedbacks)
    relay.stall(new=True)
    for count in range(2, 52):
        time.sleep(0.1)  # as a server at 10 Hz
        server.feedback(*(count,) * 200)
        eventually(lambda count=count: route(robot, ACTION).goals[0].feedbacks == count)
    time.sleep(0.1)
    server.finish(1)
    eventually(lambda: route(robot, ACTION).goals[0].state == "succeeded")
    relay.stall(False)
    assert goal.result() == ("succeeded", [1])
    assert goal.feedbacks == [[0], *([count] * 200 for count in range(2, 52))]


def test_goal_waits_for_a_silent_link(
    relay: Relay,
    bridge: Bridge,
    server: FibonacciServer,
    client: FibonacciClient,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    constants.DEAD_AFTER.set(monkeypatch, 60.0)
    sides = bridge.both(FIBONACCI)

    def both_say(*verdict: object) -> bool:
        return all((route(each, ACTION).state, route(each, ACTION).cause) == verdict for each in sides)

    goal = client.send(1).ask()
    server.goal()
    eventually(lambda: both_say(State.OK, Cause.NONE))
    relay.stall(new=True)
    eventually(lambda: both_say(State.WAITING, Cause.AWAITS_LINK))
    relay.stall(False)
    eventually(lambda: both_say(State.OK, Cause.NONE))
    server.finish(1)
    assert goal.result() == ("succeeded", [1])


def test_answers_of_a_gap_come_whole(
    relay: Relay, bridge: Bridge, near: CallNode, far: CallNode, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To a client that keeps ten, and calls all the time."""
    constants.DEAD_AFTER.set(monkeypatch, 60.0)
    far.serve(service)
    engines = bridge.both(called(service))
    near.client(service, depth=10, busy=0.01)
    with balanced(*engines):
        near.waits_for(service)
        near.begin(service, 80, at_once=80, rate=20)
        eventually(lambda: near.outcome(service).answered > 5)
        relay.stall(new=True)
        eventually(lambda: near.outcome(service).asked > 65)
        relay.stall(False)
        assert near.settled(service).right
        for engine in engines:
            settled(engine, service, asked=80, answered=80)


class _Hesitant(FibonacciServer):
    """An action server that runs a goal when the test calls `run`."""

    def _accepted(self, handle: Any) -> None:
        self._ends[id_of(handle)] = threading.Event()
        self.goals.append(handle)

    def run(self, number: int) -> None:
        self.finish(number, number=number)
        self.goals[number].execute()


def test_results_are_asked_for_in_turn(bridge: Bridge, robot: Domain, client: FibonacciClient) -> None:
    """The providing side's bridge is a new one, and has all of them to ask for at once.

    The client keeps ten requests and ten answers: on a busy machine, more at once overwrite each other, bridge or not.
    """
    with closing(_Hesitant(robot.id, result_timeout=180.0)) as server:
        _, provider = bridge.both(FIBONACCI)
        goals = list[Goal]()
        for number in range(30):
            goals.append(client.send(number))
            assert goals[-1].handle().accepted
        provider.stop()
        eventually(lambda: not client.ready)
        successor = bridge.client(FIBONACCI)
        eventually(lambda: client.ready)
        for count, goal in enumerate(goals, 1):
            goal.ask()
            eventually(lambda n=count: sum(each.result_awaited for each in route(successor, ACTION).goals) == n)
        for number in range(len(goals)):
            server.run(number)
            eventually(lambda number=number: sum(goal.has_result for goal in goals) == number + 1)

"""An action that is paused or has to be armed: no goal may begin, and nobody is kept from stopping one that runs."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.support import replaced
from tests.support.long import long_cases

pytest.importorskip("test_msgs", reason="no package with an action is installed (ros-jazzy-test-msgs)")

from tests.support.bridge import feedback_listeners, linked, route
from tests.support.fibonacci import ACTION, FibonacciClient, FibonacciServer, id_of
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine

FIBONACCI = Topic(ACTION, "receive", kind="action")
ARMED = msgspec.structs.replace(FIBONACCI, arm=True, deadman=0.0)


@pytest.mark.usefixtures("long_lease")
@pytest.mark.parametrize(("how", "who"), [("paused", 0), ("disarmed", 1), *long_cases(("paused", 1), ("disarmed", 0))])
def test_goals_end_while_no_new_one_begins(
    who: int, how: str, bridge: Bridge, server: FibonacciServer, client: FibonacciClient, consoles: Consoles
) -> None:
    engines = bridge.both(ARMED if how == "disarmed" else FIBONACCI)
    if how == "disarmed":
        eventually(lambda: states(*engines) == {"disarmed"})
        consoles.arm(engines[1 - who], ACTION)
    first, second = client.send(1).ask(), client.send(2).ask()
    number, other = server.number_of(first), server.number_of(second)
    eventually(lambda: server.is_heard and feedback_listeners(engines[0]))
    hold(engines[who], how)
    eventually(lambda: states(*engines) == {how})
    for engine in engines:
        eventually(lambda engine=engine: [goal.state for goal in route(engine, ACTION).goals] == ["executing"] * 2)
    eventually(lambda: not client.ready, what="no goal can be sent")
    eventually(lambda: server.is_heard and feedback_listeners(engines[0]))  # a disarmed route is opened again
    server.feedback(7, number=other)
    eventually(lambda: second.feedbacks == [[7]])
    answer = first.cancel()
    eventually(answer.done, what="the cancel passes")
    assert server.cancels == [id_of(first.handle())]
    server.finish(1, number=number, state="canceled")
    server.finish(2, number=other)
    assert first.result() == ("canceled", [1])
    assert second.result() == ("succeeded", [2])
    for engine in engines:
        eventually(
            lambda engine=engine: [goal.state for goal in route(engine, ACTION).goals] == ["succeeded", "canceled"]
        )
    assert states(*engines) == {how}
    assert server.orders == [1, 2]
    if how == "disarmed":
        consoles.arm(engines[who], ACTION)
    else:
        engines[who].pause(route(engines[who], ACTION).key, False).result(30)
    assert client.send(3).handle().accepted


@pytest.mark.parametrize(
    ("how", "shared"), [("paused", False), ("disarmed", True), *long_cases(("paused", True), ("disarmed", False))]
)
def test_running_goal_is_cancelled_by_hand_without_rights(
    how: str, shared: bool, bridge: Bridge, server: FibonacciServer, robot: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The goal is another client's, in the robot's domain; the operator sits at the other end.

    Where routes share the link's own stream, as on Bluetooth, the status is sent as soon as the other side can take it.
    """
    replaced.TCP_MULTIPLEXED.set(monkeypatch, shared)
    local = FibonacciClient(robot.id)
    goal = local.send(5)
    goal.handle()
    changes = {"paused": True} if how == "paused" else {"arm": True}
    engines = bridge.both(msgspec.structs.replace(FIBONACCI, **changes))
    eventually(lambda: states(*engines) == {how})
    pc = engines[0]
    if how == "disarmed":
        for engine in engines:
            with pytest.raises(EngineError):
                engine.call(route(engine, ACTION).key, "{}", "send_goal").result(30)
    assert server.orders == [5]
    eventually(lambda: [each.state for each in route(pc, ACTION).goals] == ["executing"])

    def cancel() -> bool:
        with contextlib.suppress(EngineError):  # its own service is found after the goal's status, by a busy machine
            pc.call(route(pc, ACTION).key, "{}", "cancel_goal").result(30)
        return bool(server.cancels)

    eventually(cancel)
    assert set(server.cancels) == {id_of(goal.handle())}
    server.finish(state="canceled")
    local.close()


def test_goal_that_waits_for_its_server_is_accepted(bridge: Bridge, client: FibonacciClient, robot: Domain) -> None:
    server = FibonacciServer(robot.id, hesitates=True)
    engines = bridge.both(FIBONACCI)
    goal = client.send(5)
    eventually(lambda: server.orders == [5])
    hold(engines[0], "paused")
    eventually(lambda: states(*engines) == {"paused"})
    assert not client.send(6).handle().accepted
    server.hesitates.clear()
    assert goal.handle().accepted
    eventually(lambda: states(*engines) == {"paused"} and not client.ready, what="no goal can be sent")
    eventually(goal.cancel().done)
    assert server.orders == [5]
    server.finish(state="canceled")
    server.close()


def test_cancel_during_outage_is_delivered_despite_pause(
    bridge: Bridge, relay: Relay, server: FibonacciServer, client: FibonacciClient
) -> None:
    engines = bridge.both(FIBONACCI)
    goal = client.send(5).ask()
    goal.handle()
    hold(engines[1], "paused")
    eventually(lambda: states(*engines) == {"paused"})
    relay.stall(new=True)
    relay.cut()
    eventually(lambda: not any(linked(engine) for engine in engines))
    answer = goal.cancel()
    relay.stall(False)
    eventually(answer.done)
    server.finish(1, state="canceled")
    assert goal.result() == ("canceled", [1])
    eventually(lambda: states(*engines) == {"paused"})


def hold(engine: Engine, how: str) -> None:
    """Pause or disarm the action."""
    key = route(engine, ACTION).key
    (engine.pause(key, True) if how == "paused" else engine.disarm(key)).result(30)


def states(*engines: Engine) -> set[str]:
    """Return the states of the action, on all of them."""
    return {route(engine, ACTION).state for engine in engines}

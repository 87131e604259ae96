"""Verdicts of both sides that depend on time, or on the way of single datagrams.

`tests.console.test_both_screens` has the causes that nodes make, with both sides' words.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.console.live import running
from tests.console.nodes import Spec, encoded
from tests.support.bridge import carries, happened, route
from tests.support.domain import BEST_EFFORT, text
from tests.support.relay import message_number
from tests.support.steady import Steady
from tests.support.waiting import eventually, holds

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.sending import USE_TCP

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.relay import Relay


def test_occasional_topic_is_not_stale(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Nobody knows when the next message is due, and all that were sent have arrived."""
    listener, goal = pc.listener("/goal_pose"), robot.publisher("/goal_pose")
    server, client = bridge.both(Topic("/goal_pose", "transmit"), stale_after=0.5)
    carries([goal], server, ["/goal_pose"])

    def said() -> set[tuple[State, str]]:
        found = [route(engine, "/goal_pose") for engine in (client, server)]
        return {(each.state, each.cause) for each in found}

    for number in range(1, 3):
        goal.publish(text("a goal"))
        eventually(lambda number=number: len(listener.payloads) == number)
        eventually(lambda: said() == {(State.OK, "")})
        holds(lambda: said() == {(State.OK, "")}, 1.5)
    robot.node.destroy_publisher(goal)
    eventually(lambda: said() == {(State.OK, Cause.PUBLISHER_GONE)})
    holds(lambda: said() == {(State.OK, Cause.PUBLISHER_GONE)}, 1.5)
    assert [happened(engine, EventCode.ROUTE_STALE) for engine in (client, server)] == [None, None]


def test_half_of_the_messages_lost_on_the_way(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Each takes several datagrams, and every other message loses one."""
    listener, out = pc.listener("/scan", qos=BEST_EFFORT), robot.publisher("/scan", qos=BEST_EFFORT)
    server, client = bridge.both(Topic("/scan", "transmit", protocol="udp"))
    carries([out], server, ["/scan"])
    seen: set[int] = set()

    def lose_one_of_every_other(datagram: bytes) -> list[bytes]:
        number = message_number(datagram)
        if number is None or number % 2 or number in seen:
            return [datagram]
        seen.add(number)
        return []

    def both_show(state: State, cause: str, *words: str) -> bool:
        found = [route(engine, "/scan") for engine in (client, server)]
        shown = all((each.state, each.cause) == (state, cause) for each in found)
        return shown and all(word in each.reason for each in found for word in words)

    with Steady(out, 20.0, lambda _: text("x" * 200_000)):
        eventually(lambda: len(listener.payloads) > 20)
        eventually(lambda: both_show(State.OK, ""))
        relay.to_server = lose_one_of_every_other
        # a remedy is named once it is clear that the link is not full
        eventually(
            lambda: (
                both_show(State.SLOW, Cause.LOSSY, "datagrams", USE_TCP)
                and route(server, "/scan").reason.startswith("robot1: ")
            )
        )
        eventually(lambda: (event := happened(server, EventCode.ROUTE_FAULT)) and event.cause == Cause.LOSSY)
        relay.to_server = lambda datagram: [datagram]
        eventually(lambda: {route(engine, "/scan").state for engine in (client, server)} == {State.OK})


def test_type_that_publisher_changes_is_its_fault(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """The subscriber is as it was; a restarted publisher has another type."""
    listener = pc.listener("/scan")
    server, client = bridge.both(Topic("/scan", "transmit"))

    def publishes(spec: Spec) -> Any:
        return running("tests.console.nodes", str(robot.id), encoded([spec]))

    with publishes(Spec("lidar", "/scan", 20)):
        eventually(lambda: listener.payloads)
    eventually(lambda: not route(server, "/scan").publishers)
    with publishes(Spec("lidar", "/scan", 20, type="Int32")):
        words = (
            "/lidar publishes std_msgs/msg/Int32 now, /stock has std_msgs/msg/String as before: correct the publisher"
        )
        for engine in (client, server):
            eventually(lambda engine=engine: words in route(engine, "/scan").reason)
            assert route(engine, "/scan").cause == Cause.TYPE_CONFLICT

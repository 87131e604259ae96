"""No hand asks more of a robot than the sessions of both sides allow, with any tool."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.serialization import deserialize_message
from tests.support.bridge import route
from tests.support.waiting import eventually, holds
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.session import ArmedName, Topic
from rsb_extras.driving.publish_requests import Publish
from rsb_extras.driving.publishing import PublishProblem
from rsb_extras.driving.tests.publishing_helpers import can_be_armed, driven, publish

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
    from tests.support.domain import Domain, Listener

    from rsb_bridge.engine import Engine

pytestmark = pytest.mark.usefixtures("patient")

LIMITS = VelocityLimits(0.5, 1.0)
LIMITED = Topic("/cmd", "receive", arm=True, deadman=0.0, limits=LIMITS)
DRIVEN = Topic("/cmd", "receive", arm=True, deadman=0.0)


def twists(listener: Listener) -> list[tuple[float, float]]:
    found = [deserialize_message(each, Twist) for each in listener.payloads]
    return [(each.linear.x, each.angular.z) for each in found]


def drive(engine: Engine, fields: str) -> None:
    publish(engine, fields, rest="{}", rest_after=2.0, reduce=True)


@pytest.mark.usefixtures("long_lease")
@pytest.mark.parametrize("whose", ["robot", "pc"])
def test_hand_is_held_to_limits_of_either_side(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles, whose: str
) -> None:
    """A message beyond them is refused; keys drive at the limit."""
    motors = robot.listener("/cmd", Twist)
    pc.publisher("/cmd", Twist)
    server = bridge.server(armed=(ArmedName("/cmd", deadman=0.0, limits=LIMITS if whose == "pc" else None),))
    client = bridge.client(LIMITED if whose == "robot" else DRIVEN)
    eventually(lambda: can_be_armed(server, client))
    consoles.arm(server)
    for beyond in ("linear: {x: 0.51}", "angular: {z: -1.1}", "linear: {x: 0.4, y: -0.4}", "linear: {x: .nan}"):
        with pytest.raises(EngineError, match=pattern(PublishProblem.BEYOND_LIMITS)):
            publish(server, beyond)
    publish(server, "{linear: {x: 0.5}, angular: {z: -1}}")
    eventually(lambda: twists(motors) == [(0.5, -1.0)])
    drive(server, "{linear: {x: -0.8}, angular: {z: 0.7}}")
    eventually(lambda: twists(motors)[1:2] == [(-0.5, 0.7)])
    with pytest.raises(EngineError, match=pattern(PublishProblem.BEYOND_LIMITS)):
        drive(server, "linear: {x: .inf}")
    holds(lambda: all(abs(forward) <= 0.5 and abs(turn) <= 1.0 for forward, turn in twists(motors)), 0.3)


def test_hand_on_robots_side_is_limited_too(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Without arming, and by a message that is to follow."""
    motors = robot.listener("/cmd", Twist)
    pc.publisher("/cmd", Twist)
    server = bridge.server(armed=())
    client = bridge.client(Topic("/cmd", "receive", limits=LIMITS))
    eventually(lambda: route(server, "/cmd").limits == LIMITS and route(client, "/cmd").limits == LIMITS)
    with pytest.raises(EngineError, match=pattern(PublishProblem.BEYOND_LIMITS)):
        publish(client, "linear: {x: 0.6}")
    publish(client, "linear: {x: 0.3}")
    eventually(lambda: twists(motors) == [(0.3, 0.0)])


@pytest.mark.usefixtures("long_lease")
def test_what_follows_message_is_held_to_them_too(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles
) -> None:
    motors = robot.listener("/cmd", Twist)
    server, _ = driven(bridge, pc, consoles, LIMITED)
    with pytest.raises(EngineError, match=pattern(PublishProblem.BEYOND_LIMITS)):
        publish(server, "linear: {x: 0.1}", rest="linear: {x: 9}")
    publish(server, "linear: {x: 0.1}", rest="linear: {x: 9}", rest_after=0.2, reduce=True)
    eventually(lambda: twists(motors)[-1:] == [(0.5, 0.0)])


@pytest.mark.usefixtures("long_lease")
def test_refusals_come_in_order_of_arming_to_ticket(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles
) -> None:
    """The first command has none of them, and each of the next ones one more."""
    motors = robot.listener("/cmd", Twist)
    pc.publisher("/cmd", Twist)
    server, client = bridge.both(msgspec.structs.replace(LIMITED, max_age=0.0))
    eventually(lambda: can_be_armed(server, client))

    def refuses(engine: Engine, speed: float, rest: str, problem: PublishProblem) -> None:
        with pytest.raises(EngineError, match=pattern(problem)):
            engine.do(Publish("/cmd", f"linear: {{x: {speed}}}", rest=rest)).result(30)  # without a ticket

    refuses(server, 9.0, "{}", PublishProblem.NOT_ARMED)
    consoles.arm(server)
    refuses(client, 9.0, "{}", PublishProblem.ANOTHER_DRIVES)
    refuses(server, 9.0, "{}", PublishProblem.NO_DEADMAN)
    refuses(server, 9.0, "", PublishProblem.BEYOND_LIMITS)
    assert not server.do(Publish("/cmd", "linear: {x: 0.1}")).result(30).is_done
    assert not motors.payloads


def test_a_stamped_velocity_has_limits_too(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """A topic that needs no arming has them, too."""
    motors = robot.listener("/cmd", TwistStamped)
    pc.publisher("/cmd", TwistStamped)
    server = bridge.server(armed=())
    client = bridge.client(Topic("/cmd", "receive", limits=LIMITS), armed=())
    eventually(lambda: route(server, "/cmd").limits == LIMITS and route(client, "/cmd").state == "waiting")
    with pytest.raises(EngineError, match=pattern(PublishProblem.BEYOND_LIMITS)):
        publish(server, "twist: {linear: {x: 0.6}}")
    publish(server, "{header: auto, twist: {linear: {x: 0.4}}}")
    eventually(lambda: [deserialize_message(each, TwistStamped).twist.linear.x for each in motors.payloads] == [0.4])


def test_limits_without_velocity_let_no_hand_pass(bridge: Bridge, robot: Domain) -> None:
    """Its type was not known when the session was checked."""
    listener = robot.listener("/cmd")
    client = bridge.client(Topic("/cmd", "receive", limits=LIMITS))
    with pytest.raises(EngineError, match=pattern(PublishProblem.LIMITS_OF_OTHER_TYPE)):
        publish(client, "data: x")
    assert not listener.matched

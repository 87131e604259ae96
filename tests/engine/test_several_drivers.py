"""Several nodes that drive one robot are named on both sides, each with the rate that the sender counts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry_msgs.msg import Twist
from rclpy.serialization import serialize_message
from tests.support.bridge import linked, route
from tests.support.steady import Steady
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine

CMD_VEL = Topic("/cmd_vel", "receive")
FINE, SEVERAL = (State.OK, ""), (State.OK, Cause.SEVERAL_PUBLISHERS)


def says(engine: Engine) -> tuple[State, str]:
    found = route(engine, "/cmd_vel")
    return found.state, found.cause


def drivers(engine: Engine) -> dict[str, tuple[bool, bool]]:
    """Whether each driver is on this side, and sends at a known rate."""
    return {each.name: (each.here, bool(each.rate)) for each in route(engine, "/cmd_vel").drivers}


def test_node_beside_link_is_named(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    publisher = pc.publisher("/cmd_vel", Twist)
    robot.listener("/cmd_vel", Twist)
    server, client = bridge.both(CMD_VEL)
    with Steady(publisher, 20.0, lambda _: serialize_message(Twist())):
        for engine, here in ((server, True), (client, False)):
            eventually(lambda engine=engine, here=here: drivers(engine) == {"/stock": (here, True)})
            eventually(lambda engine=engine: says(engine) == FINE)
        beside = robot.publisher("/cmd_vel", Twist)
        for engine in (server, client):
            eventually(lambda engine=engine: says(engine) == SEVERAL)
            assert len(route(engine, "/cmd_vel").drivers) == 2
            eventually(lambda engine=engine: any(e.code == EventCode.ROUTE_SEVERAL_PUBLISHERS for e in engine.events()))
        robot.node.destroy_publisher(beside)
        for engine in (server, client):
            eventually(lambda engine=engine: says(engine) == FINE)


def test_two_links_to_one_robot_are_named(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    publisher = robot.publisher("/cmd_vel", Twist)
    pc.listener("/cmd_vel", Twist)
    bridge.make_key("robot2")
    server = bridge.server(clients=(Client("robot1"), Client("robot2", "robot2.key")))
    sends = Topic("/cmd_vel", "transmit")
    first = bridge.client(sends)
    second = bridge.client(sends, name="robot2", key_file="robot2.key")
    eventually(lambda: linked(server) and linked(server, "robot2"))
    with Steady(publisher, 20.0, lambda _: serialize_message(Twist())):
        for client, other in ((first, "link robot2"), (second, "link robot1")):
            eventually(lambda client=client: says(client) == SEVERAL)
            assert drivers(client)[other] == (False, False)
        server.remove_client("robot2").result(60)
        eventually(lambda: says(first) == FINE)

"""A clock that comes from several sources on one side, so that its time jumps, has a verdict that names them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from tests.support.bridge import linked, route
from tests.support.steady import Steady
from tests.support.waiting import eventually

from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine

CLOCK = Topic("/clock", "transmit")
FINE, SEVERAL = (State.OK, ""), (State.UNHEARD, Cause.SEVERAL_CLOCKS)


def says(engine: Engine) -> tuple[State, str]:
    found = route(engine, "/clock")
    return found.state, found.cause


def test_two_clients_of_one_clock_are_named(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    publisher = robot.publisher("/clock", Clock)
    pc.listener("/clock", Clock)
    bridge.make_key("robot2")
    clients = (Client("robot1"), Client("robot2", "robot2.key"))
    server, first = bridge.server(clients=clients), bridge.client(CLOCK)
    second = bridge.client(CLOCK, name="robot2", key_file="robot2.key")
    eventually(lambda: linked(server) and linked(server, "robot2"))
    with Steady(publisher, 20.0, lambda _: serialize_message(Clock())):
        for client, other in ((first, "robot2"), (second, "robot1")):
            eventually(lambda client=client: says(client) == SEVERAL)
            assert f"link {other}" in route(client, "/clock").reason
        server.remove_client("robot2").result(60)
        eventually(lambda: says(first) == FINE)


def test_clock_beside_a_node_is_named(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    publisher = robot.publisher("/clock", Clock)
    pc.listener("/clock", Clock)
    local = pc.publisher("/clock", Clock)
    server, client = bridge.both(CLOCK)
    with Steady(publisher, 20.0, lambda _: serialize_message(Clock())):
        for engine in (server, client):
            eventually(lambda engine=engine: says(engine) == SEVERAL)
            assert "/stock" in route(engine, "/clock").reason
        pc.node.destroy_publisher(local)
        eventually(lambda: says(server) == FINE)

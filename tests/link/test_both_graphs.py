"""The entries that can be bridged, as either side sees them in both graphs.

These are topics, services, actions and nodes with parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger
from tests.support.bridge import linked
from tests.support.waiting import eventually

from rsb_bridge.model.session import Client, Grant

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.snapshot import TopicInfo


@pytest.fixture
def controller(pc: Domain) -> Iterator[Node]:
    """A node with parameters, in the server's domain."""
    node = Node(
        "controller", namespace="/arm", context=pc.node.context, enable_rosout=False, use_global_arguments=False
    )
    yield node
    node.destroy_node()


def entries(engine: Engine, side: str | None = None) -> dict[tuple[str, str], TopicInfo]:
    return {(each.kind, each.topic): each for each in engine.topics(side).result(60)}


def test_client_sees_what_server_s_nodes_provide(bridge: Bridge, robot: Domain, pc: Domain, controller: Node) -> None:
    pc.publisher("/status")
    pc.serve("/reset", Trigger)
    pc.node.create_client(Trigger, "/reset")
    pc.node.create_client(SetBool, "/awaited")
    robot.serve("/dock", Trigger)
    server, client = bridge.both()
    wanted = {("topic", "/status"), ("service", "/reset"), ("service", "/awaited"), ("parameters", "/arm/controller")}
    there = eventually(lambda: found if (found := entries(client, "robot1")).keys() >= wanted else None)
    # Server and callers of one service are discovered one after the other, on either side.
    whole = ("service", "/reset")
    there = eventually(
        lambda: found if (found := entries(client, "robot1"))[whole].publishers and found[whole].subscriptions else None
    )
    assert wanted <= entries(server).keys()
    eventually(lambda: ("service", "/dock") in entries(client))
    assert not [name for _, name in there if name.endswith(("parameters", "_parameter_types", "get_type_description"))]
    reset, awaited = there["service", "/reset"], there["service", "/awaited"]
    assert (reset.type_name, reset.publishers, reset.subscriptions) == ("std_srvs/srv/Trigger", 1, 1)
    assert (awaited.type_name, awaited.publishers, awaited.subscriptions) == ("std_srvs/srv/SetBool", 0, 1)
    assert reset.type_hash.startswith("RIHS01_")
    arm = there["parameters", "/arm/controller"]
    assert (arm.type_name, arm.publishers, arm.subscriptions) == ("", 1, 0)


def test_each_side_shows_what_peer_may_use(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """A server lets a client do all that it does not deny; a client lets its server do what it allows or lists."""
    for name in ("/reset", "/secret"):
        pc.serve(name, Trigger)
        robot.serve(name, Trigger)
    server = bridge.server(key_file=None, clients=(Client("robot1", key_file=bridge.key_file, deny=("/secret",)),))
    client = bridge.client(allow=(Grant(services="/reset", may="call"),))
    eventually(lambda: linked(server) and linked(client))
    both = {("service", "/reset"), ("service", "/secret")}
    for engine in (server, client):
        eventually(lambda engine=engine: entries(engine).keys() >= both)
    assert entries(client, "robot1").keys() & both == {("service", "/reset")}
    assert entries(server, "robot1").keys() & both == {("service", "/reset")}


def test_client_with_use_name_sees_its_names(bridge: Bridge, pc: Domain) -> None:
    for name in ("/robot1/reset", "/robot2/reset", "/reset"):
        pc.serve(name, Trigger)
    server, client = bridge.both(use_name=True)
    eventually(lambda: {name for _, name in entries(server)} >= {"/robot1/reset", "/robot2/reset", "/reset"})
    assert {name for kind, name in entries(client, "robot1") if kind == "service"} == {"/robot1/reset"}

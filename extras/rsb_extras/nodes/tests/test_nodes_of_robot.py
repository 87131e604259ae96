"""The nodes of a robot, seen from the other side of a link: real nodes in two domains, one in a process of its own."""

from __future__ import annotations

import os
from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import is_accepted, linked, route
from tests.support.waiting import eventually

from rsb_bridge.model.session import Grant, Topic
from rsb_extras.nodes.node_data import FoundBy, NameAndType, OneNode
from rsb_extras.nodes.tests.lidar_helpers import LIDAR, Lidar, Looker

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.support.bridge import Bridge
    from tests.support.commands import Ran
    from tests.support.control import Machine
    from tests.support.domain import Domain

STRING = "std_msgs/msg/String"


@pytest.fixture
def lidar(robot: Domain) -> Iterator[Lidar]:
    with closing(Lidar(robot.id)) as made:
        yield made


def test_node_is_shown_with_its_process_and_last_line(bridge: Bridge, lidar: Lidar) -> None:
    server, _ = bridge.both()
    looker = Looker(server)

    def counts() -> tuple[int, ...]:
        return (0,) if (now := looker.lidar()) is None else (now.count, now.publishes, now.hears, now.serves)

    eventually(lambda: counts() == (1, 1, 1, 1), what="the node with its names")
    eventually(lambda: (now := looker.lidar()) is not None and now.pid == lidar.pid, what="its process")
    eventually(lambda: looker.look().processes.get(lidar.pid), what="its figures")
    process = looker.book.processes[lidar.pid]
    assert process.memory > 5
    assert process.threads > 1
    node = looker.book.nodes[LIDAR]
    assert (node.machine, node.found_by) == (os.uname().nodename, FoundBy.GUID)

    def line() -> str:
        lidar.log()  # the subscription may not be matched yet
        return "" if (now := looker.lidar()) is None or now.line is None else now.line.text

    eventually(lambda: line() == "motor stalled \N{REPLACEMENT CHARACTER}[31mat once", what="its last line")
    assert looker.book.nodes[LIDAR].line.level == 40  # type: ignore[union-attr]  # it has one


def test_details_and_the_publisher_of_a_topic(bridge: Bridge, lidar: Lidar) -> None:
    server, _ = bridge.both()
    looker = Looker(server)
    eventually(lambda: (now := looker.lidar()) is not None and now.serves, what="the node with its names")
    for asked in (OneNode("robot1", node=LIDAR), OneNode("robot1", topic="/scan")):
        found = server.do(asked).result(60)
        assert found.state is not None
        assert found.state.name == LIDAR
        assert found.publishes == (NameAndType("/scan", STRING),)
        assert found.hears == (NameAndType("/speed", STRING),)
        assert found.serves == (NameAndType("/front/reset", "std_srvs/srv/Trigger"),)
    assert server.do(OneNode("robot1", node="/nobody")).result(60).state is None


def test_node_that_ends_is_why_its_topic_stops(bridge: Bridge, lidar: Lidar) -> None:
    server, client = bridge.both(Topic("/scan", "transmit", type=STRING), features={"hear_rosout": True})
    eventually(lambda: is_accepted(client, "/scan"), what="open")
    looker = Looker(server)

    def has_line() -> bool:
        lidar.log()
        return (now := looker.lidar()) is not None and now.line is not None

    eventually(has_line, what="its line")
    lidar.kill()  # DDS lists it for 20 s, and /proc does not
    eventually(lambda: (now := looker.lidar()) is not None and now.ended is not None, what="its end")
    assert looker.book.nodes[LIDAR].count == 0
    assert looker.book.nodes[LIDAR].ends == 1
    for engine in (client, server):
        eventually(
            lambda engine=engine: f": {LIDAR} ended" in route(engine, "/scan").reason, what="why it does not flow"
        )
        assert "motor stalled" in route(engine, "/scan").reason
    with closing(Lidar(bridge.robot.id)):
        eventually(lambda: (now := looker.lidar()) is not None and now.ended is None, what="it came back")
        assert looker.book.nodes[LIDAR].ends == 1
        eventually(lambda: LIDAR not in route(client, "/scan").reason or "ended" not in route(client, "/scan").reason)


def test_own_side_is_shown_without_a_link(bridge: Bridge, lidar: Lidar) -> None:
    client = bridge.client()
    looker = Looker(client, None)
    eventually(looker.lidar, what="the node")
    assert not [name for name in looker.book.nodes if name.startswith("/_rsb_")]


def test_command_lists_nodes(bridge: Bridge, lidar: Lidar, machine: Machine, ran: Callable[..., Ran]) -> None:
    server, _ = bridge.both()
    machine.serve(server)
    looker = Looker(server)
    eventually(lambda: (now := looker.lidar()) is not None and now.serves, what="the node with its names")
    found = ran("nodes", "--json").json["nodes"]
    (shown,) = (each for each in found if each["name"] == LIDAR)
    assert (shown["running"], shown["health"], shown["pid"], shown["publishes"]) == (1, "well", lidar.pid, 1)
    assert shown["process"]["memory_mb"] > 5
    lidar.kill()
    eventually(lambda: (now := looker.lidar()) is not None and now.ended is not None, what="its end")
    lines = ran("nodes", "robot1").out.splitlines()
    assert "1 ended" in lines[0]
    assert lines[1:3] == [os.uname().nodename, "  /front"]
    assert lines[3].startswith("    lidar_driver  ended ")
    assert ran("nodes", "robot2").code == 2
    assert ran("nodes", "--here").code == 0


def test_side_that_hides_its_nodes_says_so(
    bridge: Bridge, lidar: Lidar, machine: Machine, ran: Callable[..., Ran]
) -> None:
    server = bridge.server()
    bridge.client(features={"show_nodes": False})
    eventually(lambda: linked(server), what="linked")
    machine.serve(server)
    refused = ran("nodes")
    assert refused.code == 1
    assert (
        "robot1 does not show its nodes to the server: leave show_nodes out in the session file of robot1"
        in refused.err
    )
    assert server.do(OneNode("robot1", node=LIDAR)).result(60).state is None


def test_lines_and_names_are_shown_by_right(bridge: Bridge, lidar: Lidar) -> None:
    server = bridge.server()
    client = bridge.client(deny=(Grant(topics="/rosout"), Grant(topics="/scan")), features={"hear_rosout": True})
    looker = Looker(server)
    eventually(lambda: linked(server), what="linked")
    eventually(lambda: (now := looker.lidar()) is not None and now.serves, what="the node with its names")
    own = Looker(client, None)

    def line() -> bool:
        lidar.log()
        return (now := own.lidar()) is not None and now.line is not None

    eventually(line, what="its line on its own side")
    details = server.do(OneNode("robot1", node=LIDAR)).result(60)
    assert details.state is not None
    assert (details.state.line, details.lines) == (None, ())
    assert looker.book.nodes[LIDAR].line is None
    assert details.publishes == ()
    assert details.left_out == 1

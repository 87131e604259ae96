"""Two bridges over a socket, and a stand-in of a container whose components the other side lists and changes."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.bridge import connections, happened
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic
from rsb_console.command.shell import FAILURE, OK, USAGE
from rsb_extras.node_control.cdr_fields import FieldWriter, MalformedAnswerError
from rsb_extras.node_control.change_records import Component, Container
from rsb_extras.node_control.change_requests import ChangeNodes, ListManaged
from rsb_extras.node_control.component_messages import read_components
from rsb_extras.node_control.node_changer import ChangeCode
from rsb_extras.node_control.tests.container_types import type_hash
from rsb_extras.node_control.tests.managed_nodes import has, linked_sides
from rsb_extras.node_control.tests.standin_container import NAME, Asked, StandInContainer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.support.bridge import Bridge
    from tests.support.commands import Ran
    from tests.support.consoles import Consoles
    from tests.support.control import Machine
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_extras.node_control.change_records import ChangeOutcome

SMOOTHER = Component("nav2_smoother", "nav2_smoother::SmootherServer", "smoother", "/nav")
PUBLISHED = {
    "ListNodes": "57c879a1825b3fa15fd58e70d2e73223af6b9c45c7ae104cc107e73464d3a724",
    "LoadNode": "7d3496175f54f92d652547e144c9b2a3b22afd604f84ed70adfcd1cfe35801b5",
    "UnloadNode": "95d5cfc357956740190c7685ac868d9c7c98dcb8c1416aae8eaa351422074e12",
}
"""Hashes of the requests in Jazzy, as another implementation of ROS 2 publishes them."""


@pytest.fixture
def container(robot: Domain) -> Iterator[StandInContainer]:
    with closing(StandInContainer(robot.id)) as made:
        yield made


def two_sides(bridge: Bridge, *may: str, **others: Any) -> tuple[Engine, Engine]:
    pc, robot = linked_sides(bridge, has(*may) | others.pop("features", {}), **others)
    eventually(lambda: containers(robot, here=True) == ["/planner_server"], what="the container's services")
    return pc, robot


def listed(engine: Engine, **where: Any) -> tuple[Container, ...]:
    return tuple(
        each for side in engine.do(ListManaged(**where)).result(60) for each in side.managed.containers
    )  # fmt: skip


def containers(engine: Engine, **where: Any) -> list[str]:
    return [node for each in listed(engine, **where) for node in each.nodes]


def change(engine: Engine, action: Any, component: Component, link: str = "robot1", **more: Any) -> ChangeOutcome:
    return engine.do(ChangeNodes(NAME, action, link, component=component, **more)).result(120)


@pytest.mark.parametrize("service", PUBLISHED)
def test_described_types_have_the_published_hashes(service: str) -> None:
    assert type_hash(f"composition_interfaces/srv/{service}_Request") == f"RIHS01_{PUBLISHED[service]}"


def test_components_are_listed_loaded_and_unloaded(bridge: Bridge, container: StandInContainer) -> None:
    pc, robot = two_sides(bridge, NAME)
    eventually(lambda: listed(pc, link="robot1") == (Container(NAME, ("/planner_server",), allowed=True),), what="it")
    loaded = change(pc, "load", SMOOTHER)
    assert (loaded.done, [(step.node, step.what) for step in loaded.steps]) == (True, [("/nav/smoother", "load")])
    texts = SMOOTHER.package, SMOOTHER.plugin, SMOOTHER.name, SMOOTHER.namespace
    assert container.asked == [Asked(texts, [], {}, {})]
    assert happened(robot, ChangeCode.BEGAN, f"{NAME}: load nav2_smoother nav2_smoother::SmootherServer")
    eventually(lambda: containers(pc, link="robot1") == ["/nav/smoother", "/planner_server"], what="the second one")
    unloaded = change(pc, "unload", Component(name="/planner_server"))
    assert (unloaded.done, unloaded.steps[0].node) == (True, "/planner_server")
    assert [*container.loaded.values()] == ["/nav/smoother"]
    gone = change(pc, "unload", Component(name="/planner_server"))
    assert gone.reason == f"{NAME} has no component /planner_server: it has /nav/smoother"


def test_change_of_container_is_shown_to_whom_it_was_allowed(bridge: Bridge, container: StandInContainer) -> None:
    """Also where nodes are not shown: it has those of its components."""
    pc, _ = two_sides(bridge, NAME, features={"show_nodes": False})
    assert change(pc, "load", SMOOTHER).done
    (side,) = pc.do(ListManaged("robot1")).result(60)
    assert [(each.target, each.action) for each in side.managed.changes] == [(NAME, "load")]


def test_a_containers_reason_is_shown(bridge: Bridge, container: StandInContainer) -> None:
    pc, robot = two_sides(bridge, NAME)
    container.refused = "no such plugin"
    assert change(pc, "load", SMOOTHER).reason == (
        f"{NAME} does not load nav2_smoother nav2_smoother::SmootherServer: no such plugin"
    )
    assert change(robot, "unload", Component(name="/planner_server"), link="").reason == (
        f"{NAME} does not unload /planner_server: no such plugin"
    )


def test_without_the_right_nothing_is_loaded(bridge: Bridge, container: StandInContainer) -> None:
    pc, robot = two_sides(bridge, "/planner_server")
    for action, component in (("load", SMOOTHER), ("unload", Component(name="/planner_server"))):
        refused = change(pc, action, component)
        assert refused.refused
        assert refused.reason.startswith(f"robot1 does not let the server change {NAME}: add may: {{nodes: [{NAME}]}}")
    assert (container.asked, [*container.loaded]) == ([], [1])
    assert change(robot, "load", SMOOTHER, link="").done


def test_containers_with_driven_components_are_left_alone(
    bridge: Bridge, container: StandInContainer, robot: Domain, pc: Domain, consoles: Consoles, long_lease: None
) -> None:
    from std_msgs.msg import String
    from tests.support.spun import Spun

    with closing(Spun(robot.id, "planner_server")) as node:
        node.node.create_subscription(String, "/cmd", print, 10)
        pc.publisher("/cmd")
        there, here = two_sides(bridge, NAME, topics=(Topic("/cmd", "receive", arm=True),))
        consoles.arm(there)
        for action, component in (("load", SMOOTHER), ("unload", Component(name="/planner_server"))):
            assert change(there, action, component).reason.startswith("/cmd is armed")
        assert (container.asked, [*container.loaded]) == ([], [1])
        assert change(here, "unload", Component(name="/planner_server"), link="").done


def test_a_load_goes_on_over_a_cut(bridge: Bridge, relay: Relay, container: StandInContainer) -> None:
    bridge.through(relay)
    pc, _ = two_sides(bridge, NAME, outlive=0.0)
    container.holds = True
    first = pc.do(ChangeNodes(NAME, "load", "robot1", component=SMOOTHER))
    eventually(lambda: container.asked, what="the request")
    before = connections(pc)
    relay.cut()
    eventually(lambda: connections(pc) > before, what="another connection")
    container.go()
    assert first.result(120).done
    assert len(container.asked) == 1


@pytest.mark.parametrize(
    ("target", "action", "component"),
    [("nav", "load", SMOOTHER), (NAME, "load", Component()), ("/nobody", "unload", Component(name="/a"))],
)
def test_what_is_no_container_is_refused(
    bridge: Bridge, container: StandInContainer, target: str, action: Any, component: Component
) -> None:
    _, robot = two_sides(bridge)
    assert robot.do(ChangeNodes(target, action, component=component)).result(60).refused


def test_answers_that_do_not_fit_are_malformed() -> None:
    with pytest.raises(MalformedAnswerError):
        read_components(FieldWriter().number("I", 1).text("/a").number("I", 0).message)


def test_command_lists_loads_and_unloads(
    bridge: Bridge, container: StandInContainer, machine: Machine, ran: Callable[..., Ran]
) -> None:
    pc, _ = two_sides(bridge, NAME)
    machine.have(pc)
    eventually(lambda: NAME in ran("component", "list").out, what="the container")
    assert ran("component", "list").out.splitlines() == [
        "CONTAINER        SIDE    COMPONENT",
        f"{NAME}  robot1  /planner_server",
    ]
    words = "component", "load", NAME, "nav2_smoother", "nav2_smoother::SmootherServer"
    assert ran(*words).code == USAGE, "nobody can answer"
    how = "--remap", "cmd:=/speed", "--param", "use_sim_time:=true", "--param", "rate:=2.5", "--intra-process"
    loaded = ran(*words, "--namespace", "/nav", *how, "--yes")
    assert (loaded.code, loaded.out.splitlines()[0].split()[:2]) == (OK, ["/nav/smootherserver", "load"])
    assert container.asked[0].remaps == ["cmd:=/speed"]
    assert container.asked[0].parameters == {"use_sim_time": True, "rate": 2.5}
    assert container.asked[0].extra == {"use_intra_process_comms": True}
    unloaded = ran("component", "unload", NAME, "/nav/smootherserver", "--yes", "--json")
    assert (unloaded.code, unloaded.json["node"]) == (OK, "/nav/smootherserver")
    failed = ran("component", "unload", NAME, "/nav/smootherserver", "--yes")
    assert failed.code == FAILURE
    assert "has no component /nav/smootherserver: it has /planner_server" in failed.err
    found = ran("component", "list", NAME, "--json").json["containers"]
    assert (found[0]["name"], found[0]["nodes"], found[0]["allowed"]) == (NAME, ["/planner_server"], True)
    assert "is no rule: write name:=value" in ran(*words, "--param", "rate", "--yes").err
    assert "there is no container /base; there are: /nav2_container" in ran("component", "list", "/base").err

"""Two bridges over a socket: a robot with managed nodes, and the other side that sees them and has them changed."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.bridge import connections, happened, linked, reloaded
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.config.session_file import save
from rsb_bridge.model.commands import acting
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Level
from rsb_extras.node_control.change_records import ChangeOutcome, Managed
from rsb_extras.node_control.change_requests import ChangeNodes, ListManaged
from rsb_extras.node_control.node_changer import STARTS, ChangeCode
from rsb_extras.node_control.tests.managed_nodes import ManagedNodes, has, linked_sides

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine

NAV = ("/planner", "/controller", "/navigator")
UP = [(name[1:], each) for each in ("configure", "activate") for name in NAV]


@pytest.fixture
def nodes(robot: Domain) -> Iterator[ManagedNodes]:
    with closing(ManagedNodes(robot.id, *(name[1:] for name in NAV))) as made:
        yield made


def two_sides(bridge: Bridge, *may: str, **others: Any) -> tuple[Engine, Engine]:
    """Return the control PC, and the robot that lets it have some nodes changed."""
    return linked_sides(bridge, has(*may, nav=NAV), **others)


def managed(engine: Engine, link: str = "robot1") -> Managed:
    sides = engine.do(ListManaged()).result(60)
    return next((side.managed for side in sides if side.link == link), Managed())


def states(engine: Engine, link: str = "robot1") -> dict[str, str]:
    return {node.name: node.state for node in managed(engine, link).nodes}


def change(engine: Engine, action: Any = "up", target: str = "nav", link: str = "robot1") -> ChangeOutcome:
    return engine.do(ChangeNodes(target, action, link)).result(120)


def test_group_comes_up_in_order_and_goes_down_in_reverse(bridge: Bridge, nodes: ManagedNodes) -> None:
    pc, robot = two_sides(bridge, "nav")
    eventually(lambda: states(pc) == dict.fromkeys(sorted(NAV), "unconfigured"), what="the nodes' states")
    with acting("anna on pts/3"):
        up = change(pc)
    assert (up.done, up.reason) == (True, "")
    assert [(step.node[1:], step.what) for step in up.steps] == nodes.taken == UP
    assert [step.state for step in up.steps] == ["inactive"] * 3 + ["active"] * 3
    eventually(lambda: {*states(pc).values()} == {"active"}, what="active")
    nodes.taken.clear()
    assert change(pc, "down").done
    assert nodes.taken == [(name[1:], each) for each in ("deactivate", "cleanup") for name in NAV[::-1]]
    event = happened(robot, ChangeCode.ENDED, "nav: up: done in ")
    assert event is not None
    assert (event.from_peer, event.link) == (True, "robot1")
    assert event.who == "the server, which says: anna on pts/3"
    assert happened(pc, ChangeCode.BEGAN, "nav of robot1: up asked for by anna on pts/3")
    assert happened(pc, ChangeCode.ENDED, "nav of robot1: up: done in ")


def test_group_stops_at_first_refusal_and_goes_on_later(bridge: Bridge, nodes: ManagedNodes) -> None:
    pc, robot = two_sides(bridge, "nav")
    nodes["controller"].refused.add("configure")
    failed = change(pc)
    assert not failed.done
    assert failed.reason == "/controller refused to configure, and is unconfigured now: see its log"
    assert [(step.node, bool(step.reason)) for step in failed.steps] == [("/planner", False), ("/controller", True)]
    assert nodes.taken == UP[:2]
    assert happened(robot, ChangeCode.FAILED, "nav: up: /controller refused to configure")
    asked = happened(pc, ChangeCode.FAILED, "see its log, asked for by ")
    assert asked is not None
    assert asked.level is Level.WARNING
    nodes["controller"].refused.clear()
    again = change(pc)
    assert again.done
    assert [(step.node[1:], step.what) for step in again.steps] == UP[1:], "what it needs no more is left out"
    assert change(pc).steps == ()


def test_node_offers_and_takes_transitions(bridge: Bridge, nodes: ManagedNodes) -> None:
    pc, robot = two_sides(bridge, "/planner")

    def planner() -> tuple[str, tuple[str, ...], bool]:
        found = next((each for each in managed(pc).nodes if each.name == "/planner"), None)
        return ("", (), False) if found is None else (found.state, found.offers, found.allowed)

    eventually(lambda: planner() == ("unconfigured", ("configure", "shutdown"), True), what="what it offers")
    assert not next(each for each in managed(pc).nodes if each.name == "/controller").allowed
    refused = change(pc, "activate", "/planner")
    assert refused.reason == "/planner is unconfigured: it offers configure, shutdown now"
    assert change(pc, "configure", "/planner").done
    assert change(pc, "activate", "/planner").steps[0].state == "active"
    assert change(pc, "deactivate", "/planner").done
    assert change(pc, "cleanup", "/planner").done
    assert change(pc, "shutdown", "/planner").steps[0].state == "finalized"
    gone = change(robot, "configure", "/nobody", link="")
    assert gone.reason == "/nobody does not run, or has no service /get_state"


def test_without_the_right_the_other_side_only_looks(bridge: Bridge, nodes: ManagedNodes) -> None:
    pc, robot = two_sides(bridge, "/planner")
    eventually(lambda: len(states(pc)) == 3, what="the nodes")
    assert [group.allowed for group in managed(pc).groups] == [False]
    for target, lacking in (("nav", "/controller"), ("/controller", "/controller"), ("none", "none")):
        refused = change(pc, "up", target)
        assert refused.refused
        assert refused.reason.startswith(
            f"robot1 does not let the server change {lacking}: add may: {{nodes: [{target}]}}"
        ), refused.reason
    assert happened(robot, ChangeCode.REFUSED, "nav: up refused: robot1 does not let the server")
    assert happened(pc, ChangeCode.REFUSED, "robot1 does not let the server")
    assert nodes.taken == []
    assert change(robot, link="").done, "an operator of the robot needs no right"


def test_hidden_nodes_are_listed_if_they_may_be_changed(bridge: Bridge, nodes: ManagedNodes, tmp_path: Path) -> None:
    robot = bridge.client(features={**has("/planner", nav=NAV), "show_nodes": False})
    pc = bridge.server()
    eventually(lambda: linked(pc) and linked(robot), what="linked")
    eventually(lambda: [*states(pc)] == ["/planner"], what="the one node")
    assert managed(pc).groups == ()
    assert change(robot, link="").done
    assert managed(pc).changes == (), "of nodes that are hidden"
    path = tmp_path / "robot1.yaml"
    save(robot.session, path)
    reloaded(robot, path, features={**has("/planner"), "show_nodes": False})
    assert managed(pc).changes == (), "nor of a group that is no more"


def test_a_reload_gives_and_takes_right_and_groups(bridge: Bridge, nodes: ManagedNodes, tmp_path: Path) -> None:
    robot = bridge.client(features={})
    pc = bridge.server()
    eventually(lambda: linked(pc) and linked(robot), what="linked")
    path = tmp_path / "robot1.yaml"
    save(robot.session, path)
    assert change(pc).refused
    reloaded(robot, path, features=has("nav", nav=NAV))
    assert change(pc).done
    reloaded(robot, path, features=has(nav=NAV))
    assert change(pc, "down").refused
    assert nodes.taken == UP


def test_server_has_managed_nodes_too(bridge: Bridge, pc: Domain) -> None:
    server = bridge.server(features=has("/planner"))
    client = bridge.client()
    eventually(lambda: linked(client) and linked(server), what="linked")
    with closing(ManagedNodes(pc.id, "planner")) as nodes:
        eventually(lambda: change(client, "up", "/planner").done, what="a node that is found")
        assert [each for _, each in nodes.taken] == ["configure", "activate"]


def test_one_change_of_a_node_at_a_time(bridge: Bridge, nodes: ManagedNodes) -> None:
    pc, _ = two_sides(bridge, "nav")
    nodes["controller"].holds.add("configure")
    first = pc.do(ChangeNodes("nav", "up", "robot1"))
    eventually(lambda: nodes.taken == UP[:2], what="a transition that lasts")
    assert change(pc, "down", "/navigator").reason == "/navigator is being changed already: wait until that is over"
    running = [each for each in managed(pc).changes if not each.outcome.is_over]
    assert [(each.target, [step.node for step in each.outcome.steps]) for each in running] == [("nav", ["/planner"])]
    nodes["controller"].go.set()
    assert first.result(120).done
    assert nodes.taken == UP


def test_an_own_operator_ends_a_peers_change(bridge: Bridge, nodes: ManagedNodes) -> None:
    pc, robot = two_sides(bridge, "nav")
    nodes["controller"].holds.add("configure")
    first = pc.do(ChangeNodes("nav", "up", "robot1"))
    eventually(lambda: nodes.taken == UP[:2], what="a transition that lasts")
    down = robot.do(ChangeNodes("/planner", "down"))
    ended = first.result(120)
    assert ended.reason == "an operator of its side ended it, for another change: look at the nodes' states"
    assert down.result(120).done
    assert nodes.taken == [*UP[:2], ("planner", "cleanup")]
    nodes["controller"].go.set()


def test_changes_are_counted_for_each_side(bridge: Bridge, nodes: ManagedNodes) -> None:
    pc, robot = two_sides(bridge, "nav")
    assert [change(pc, "down").refused for _ in range(STARTS + 2)] == [False] * STARTS + [True] * 2
    assert "one more is taken each 5 s" in change(pc).reason
    assert change(robot, link="").done


def test_driven_nodes_are_left_alone(
    bridge: Bridge, nodes: ManagedNodes, pc: Domain, consoles: Consoles, long_lease: None
) -> None:
    from std_msgs.msg import String

    nodes["controller"].create_subscription(String, "/cmd", print, 10)
    pc.publisher("/cmd")
    there, here = two_sides(bridge, "nav", "/planner", topics=(Topic("/cmd", "receive", arm=True),))
    consoles.arm(there)
    refused = change(there)
    assert refused.reason == (
        "/cmd is armed, and one of the nodes takes it: disarm it first, or ask an operator of that side"
    )
    assert nodes.taken == []
    assert change(there, "configure", "/planner").done, "it takes something else"
    assert change(here, link="").done, "the robot's own operator may"


def test_a_change_goes_on_over_a_cut(bridge: Bridge, nodes: ManagedNodes, relay: Relay) -> None:
    """Its end comes over the next connection, within the association; each node is asked once."""
    bridge.through(relay)
    pc, _ = two_sides(bridge, "nav", outlive=60.0)
    nodes["controller"].holds.add("configure")
    first = pc.do(ChangeNodes("nav", "up", "robot1"))
    eventually(lambda: nodes.taken == UP[:2], what="a transition that lasts")
    before = connections(pc)
    relay.cut()
    eventually(lambda: connections(pc) > before, what="another connection")
    nodes["controller"].go.set()
    assert first.result(120).done
    assert nodes.taken == UP


@pytest.mark.parametrize("ends", ["before", "after"])
def test_a_change_goes_on_over_a_lost_link(bridge: Bridge, nodes: ManagedNodes, relay: Relay, ends: str) -> None:
    """The other side asks again by its ticket, and hears of the same change, over or not."""
    bridge.through(relay)
    pc, robot = two_sides(bridge, "nav", outlive=0.0)
    nodes["controller"].holds.add("configure")
    first = pc.do(ChangeNodes("nav", "up", "robot1"))
    eventually(lambda: nodes.taken == UP[:2], what="a transition that lasts")
    relay.refuse()
    eventually(lambda: not linked(pc) and not linked(robot), what="a lost link")
    with pytest.raises(EngineError, match="robot1 is not linked"):
        change(pc, "down")
    if ends == "before":
        nodes["controller"].go.set()
        eventually(lambda: happened(robot, ChangeCode.ENDED, "nav: up"), what="its end")
    relay.refuse(refuses=False)
    eventually(lambda: linked(pc), what="linked again")
    nodes["controller"].go.set()
    outcome = first.result(120)
    assert outcome.done
    assert len(outcome.steps) == 6
    assert nodes.taken == UP


def test_a_restarted_bridge_knows_nothing_of_a_change(bridge: Bridge, nodes: ManagedNodes, relay: Relay) -> None:
    bridge.through(relay)
    pc, robot = two_sides(bridge, "nav", outlive=0.0)
    nodes["controller"].holds.add("configure")
    first = pc.do(ChangeNodes("nav", "up", "robot1"))
    eventually(lambda: nodes.taken == UP[:2], what="a transition that lasts")
    robot.stop()
    bridge.client(features=has("nav", nav=NAV))
    outcome = first.result(120)
    assert outcome.reason == (
        "the bridge there knows nothing of it any more: look at the state there before you ask again"
    )
    assert not outcome.refused, "a node was asked"
    nodes["controller"].go.set()
    assert nodes.taken == UP[:2]


def test_a_side_that_is_not_linked_is_named(bridge: Bridge) -> None:
    (side,) = bridge.server().do(ListManaged()).result(60)
    assert side.problem.startswith("not linked: "), "those who show it name the side"


def test_two_nodes_of_one_name_are_not_changed(bridge: Bridge, nodes: ManagedNodes, robot: Domain) -> None:
    _, there = two_sides(bridge)
    with closing(ManagedNodes(robot.id, "planner")) as others:
        reason = "2 nodes are named /planner, or DDS lists one that has ended"
        eventually(lambda: change(there, "configure", "/planner", link="").reason.startswith(reason), what="both")
        assert nodes.taken + others.taken == []


def test_a_node_that_hangs_has_no_state(bridge: Bridge, robot: Domain) -> None:
    from lifecycle_msgs.srv import ChangeState, GetState

    robot.serve("/hangs/get_state", GetState)
    robot.serve("/hangs/change_state", ChangeState)
    pc, _ = two_sides(bridge, "/hangs")
    eventually(lambda: states(pc) == {"/hangs": ""}, what="a node that does not answer")
    assert change(pc, "up", "/hangs").reason.startswith("/hangs d")
